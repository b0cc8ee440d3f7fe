// Virtual-motion edges: two sightings of one landmark connect the two poses from which they were made.
//
// Every sighting places the landmark at y_a = h^-1(x_a, z_a), with covariance C_a = R_a Q_a R_a'. All pairs of sightings of
// a landmark from different steps give an edge
//
//     e = y_b - y_a  (heading wrapped),   Omega^-1 = C_a + C_b,   B_a = -[I, t_a; 0, 1],  B_b = [I, t_b; 0, 1].
//
// In the world frame C is evaluated at the reference. In the body frame Omega rotates with pose a by gamma_a, and the
// derivative of the rotation, (-e_y, e_x), is added to t_a.
#pragma once

#include "vmslam/edges/sightings.hpp"

namespace vmslam::edges {

class VirtualMotionEdges : public LandmarkSightings {
   public:
    /// `weights` are factors on the information of all edges of a landmark.
    VirtualMotionEdges(std::vector<Index> starts, std::vector<Index> nodes, Sightings sightings, std::vector<double> weights,
                       bool body)
        : LandmarkSightings(std::move(starts), std::move(nodes), std::move(sightings)),
          weights_(std::move(weights)),
          body_(body) {}

    double accumulate(const State& state, System* system, std::span<const Index> pairs) const override;
    /// The weights of landmarks stay.
    std::unique_ptr<const Family> trusting(std::span<const double> trust) const override {
        auto out = std::make_unique<VirtualMotionEdges>(*this);
        out->seen_.trust.assign(trust.begin(), trust.end());
        return out;
    }
    bool constant(const double* state, Index nodes, ConstantEdges& out) const override;

   private:
    std::vector<double> weights_;
    bool body_;
};

}  // namespace vmslam::edges
