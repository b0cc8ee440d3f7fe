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
    Index i, j;
    Vector z;
    Symmetric omega;
};

/// `poses` have three rows, points two.
class RelativeEdges : public EdgeList<RelativeEdges, RelativeEdge> {
   public:
    RelativeEdges(std::vector<RelativeEdge> edges, bool poses, bool world, Kernel kernel)
        : EdgeList(std::move(edges), kernel), poses_(poses), world_(world) {}

    double accumulate(const State& state, System* system, std::span<const Index> pairs) const override;
    bool curves() const override { return !world_; }
    std::vector<HeadingRelation> headings() const override;
    std::vector<PositionRelation> positions(const double* state) const override;
    bool constant(const double* state, Index nodes, ConstantEdges& out) const override {
        return !world_ && EdgeList::constant(state, nodes, out);
    }

   private:
    template <bool poses, bool world>
    double add(const State& state, System* system, std::span<const Index> pairs) const;
    bool list(std::vector<ConstantEdge>& to) const override;

    bool poses_, world_;
};

/// A point of pose `i`, `lever` in its axes, measured in the world at z, with information in world axes:
///
///     e = (p + R(theta) lever - (z_x, z_y), theta - z_t),  the angle wrapped.
struct Position {
    Index i;
    Vector z;
    Symmetric omega;
    Lever lever{0.0, 0.0};
};

/// Absolute positions, and anchors, which are positions with a heading and no lever. The others have no heading information.
class PositionEdges : public EdgeList<PositionEdges, Position> {
   public:
    explicit PositionEdges(std::vector<Position> positions, Kernel kernel = {}) : EdgeList(std::move(positions), kernel) {}
    double accumulate(const State& state, System* system, std::span<const Index> pairs) const override;
    bool curves() const override { return true; }

   private:
    bool list(std::vector<ConstantEdge>& to) const override;
};

}  // namespace vmslam::edges
