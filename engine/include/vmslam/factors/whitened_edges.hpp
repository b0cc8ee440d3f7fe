// Many relative poses and points in one factor of GTSAM: whitened residuals, and Jacobians by the own axes of each node.
#pragma once

#include <array>
#include <span>
#include <vector>

#include "vmslam/edges/family.hpp"

namespace vmslam::factors {

using edges::Index;

/// Node `j` measured in the frame of pose `i`; R' R = Omega, `rows` of R upper triangular. In the world frame the axes of e
/// stand at `frozen`.
struct WhitenedEdge {
    Index i, j;
    int rows;
    edges::Vector z;
    std::array<double, 9> root;
    double frozen;
    edges::Kernel kernel;
};

/// The first `poses` nodes are poses, the others points.
class WhitenedEdges {
   public:
    WhitenedEdges(std::vector<WhitenedEdge> edges, Index poses, bool world);

    /// The whitened residuals, those of an edge with a kernel scaled so that their squares sum to its loss.
    std::vector<double> residuals(std::span<const double> x) const;
    /// The whitened residuals with a kernel as a weight, and Jacobians (nodes, 3, rows).
    struct Linearized {
        std::vector<double> residuals, jacobians;
    };
    Linearized linearized(std::span<const double> x) const;

   private:
    std::vector<WhitenedEdge> edges_;
    Index poses_, rows_ = 0;
    bool world_;
};

}  // namespace vmslam::factors
