// The linear systems of rotation-first starts: headings by unit vectors, then positions with the headings known.
//
// Source: Carlone, Tron, Daniilidis and Dellaert, Initialization techniques for 3D SLAM, ICRA 2015.
#pragma once

#include <memory>
#include <span>
#include <vector>

#include "vmslam/sparse/factor.hpp"

namespace vmslam::solve {

using sparse::Index;

/// Linear relations between two nodes each, u_second - u_first = value, and the block that each pair shares.
struct Relations {
    std::span<const Index> first, second, pairs;
    std::span<const double> value, information;
};

/// Write the headings along edges between a known node and another one, which is known then; false at any other edge.
bool follow_headings(const Relations& edges, std::span<double> headings, std::span<bool> known);

/// Omega and xi of two coordinates of each node, on the pattern of a graph.
class StartSystem {
   public:
    /// `start` are the first blocks (n + 1) of the columns, and `symbolic` is for blocks of 2 x 2.
    StartSystem(std::span<const Index> start, std::shared_ptr<const sparse::Symbolic> symbolic);

    /// Add edges with the residual R(value) r_first - r_second, where r = (cos theta, sin theta) is `unit` (2) of nodes.
    void add_headings(const Relations& edges, std::span<const double> unit);
    /// Add edges with the residual p_second - p_first - value, where p is `position` (2) of nodes; the information is 2 x 2.
    void add_positions(const Relations& edges, std::span<const double> position);
    /// Let `solve` leave some nodes where they are: `nodes`, whose rows and columns have the given blocks, and `untied`, which no
    /// edge ties.
    void hold(std::span<const Index> blocks, std::span<const Index> nodes, std::span<const Index> untied);
    /// Omega^-1 xi; then Omega and xi are zero again. Returns a node that the edges do not determine, or -1.
    Index solve(std::span<double> correction);

   private:
    double* block(Index k) { return values_.data() + 4 * k; }
    double* diagonal(Index node) { return block(start_[node + 1] - 1); }

    std::vector<Index> start_;
    std::vector<double> values_, xi_;
    sparse::Factor<sparse::Real2> factor_;
};

/// Measured positions (2) and their information (2 x 2), turned from the frame of the first node to the world's.
/// `rows` are those of the measurements.
void turn_to_world(std::span<const double> state, std::span<const Index> first, std::span<const double> measured,
                   std::span<const double> information, int rows, std::span<double> offset, std::span<double> omega);

}  // namespace vmslam::solve
