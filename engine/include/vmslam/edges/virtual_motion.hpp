// Virtual-motion edges: two sightings of one landmark connect the two poses from which they were made.
//
// Every sighting places the landmark at y_a = h^-1(x_a, z_a), with covariance C_a = R_a Q_a R_a' and lever t_a, the
// derivative of its position by the heading of pose a. Each pair of sightings of a landmark from different steps gives an
// edge
//
//     e = y_b - y_a  (heading wrapped),   Omega^-1 = C_a + C_b,   B_a = -[I, t_a; 0, 1],  B_b = [I, t_b; 0, 1].
//
// In the world frame C_a is evaluated at the reference state. In the body frame Omega rotates with pose a, by the angle
// gamma_a of `Placed`, and the derivative of the rotation, (-e_y, e_x), is added to t_a.
#pragma once

#include "vmslam/edges/sightings.hpp"

namespace vmslam::edges {

class VirtualMotionEdges : public LandmarkSightings {
   public:
    /// Where they are `tempered`, edges of a landmark have 2/K of their information, K the sum of the trust in its sightings.
    VirtualMotionEdges(ByLandmark seen, bool tempered, bool body);

    double accumulate(const State& state, System* system, std::span<const Index> pairs) const override;
    /// The weights of landmarks stay those of the trust with which the edges were made.
    std::unique_ptr<const Family> trusting(std::span<const double> trust) const override {
        auto out = std::make_unique<VirtualMotionEdges>(*this);
        out->seen_.trust.assign(trust.begin(), trust.end());
        return out;
    }
    std::unique_ptr<const Family> among(std::span<const Index> number) const override {
        return std::make_unique<VirtualMotionEdges>(from_nodes(number), tempered_, body_);
    }
    bool constant(const double* state, Index nodes, ConstantEdges& out) const override;

   private:
    bool tempered_, body_;
    std::vector<double> weights_;  ///< the factor on the information of all edges of a landmark
};

}  // namespace vmslam::edges
