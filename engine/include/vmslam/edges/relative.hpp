// Relative edges: a pose or a landmark measured from a pose. Odometry, loop closures, motion edges, g2o's points.
//
// With a measured relative pose z = (t, theta_z) of node j in the frame of pose i the residual is, in that frame,
//
//     e = (R(theta_i)' (p_j - p_i) - t,  theta_j - theta_i - theta_z),  the angle wrapped,
//
// and its information does not depend on the state. In the world frame it is R(theta_i) e, and the information is turned by
// the heading that pose i has in the reference state. A relative point has the first two rows only.
#pragma once

#include <vector>

#include "vmslam/edges/family.hpp"

namespace vmslam::edges {

/// The node `j` measured in the frame of pose `i`, with information there.
struct RelativeEdge {
    Place i, j;
    Vector z;
    Symmetric omega;
};

/// `poses` have three rows, points two.
class RelativeEdges : public Family {
   public:
    RelativeEdges(std::vector<RelativeEdge> edges, bool poses, bool world, Kernel kernel)
        : edges_(std::move(edges)), poses_(poses), world_(world), kernel_(kernel) {}

    double accumulate(const State& state, System* system, std::span<const Place> pairs) const override;

   private:
    template <bool poses, bool world>
    double add(const State& state, System* system, std::span<const Place> pairs) const;

    std::vector<RelativeEdge> edges_;
    bool poses_, world_;
    Kernel kernel_;
};

/// Anchors: priors on nodes, (x - x̂)' Omega_0 (x - x̂), the heading wrapped.
class AnchorEdges : public Family {
   public:
    /// The node i, its value z and the information.
    explicit AnchorEdges(std::vector<RelativeEdge> anchors) : anchors_(std::move(anchors)) {}
    double accumulate(const State& state, System* system, std::span<const Place> pairs) const override;

   private:
    std::vector<RelativeEdge> anchors_;
};

}  // namespace vmslam::edges
