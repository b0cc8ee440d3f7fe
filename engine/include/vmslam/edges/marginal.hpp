// Marginal edges: each landmark as a variable, eliminated. Every sighting counts exactly once.
//
// With y_a = h^-1(x_a, z_a) and W_a = (R_a Q_a R_a')^-1 a landmark m costs
//
//     min over m of sum over a of (m - y_a)' W_a (m - y_a),   at  m̂ = S^-1 sum W_a y_a,   S = sum W_a,
//
// and connects all poses that saw it by one clique. With e_a = m̂ - y_a and its Jacobian B_a = de_a/dx_a = -[I, t_a; 0, 1]
// it adds
//
//     B_a' W_a B_a  to the diagonal,   -U_a S^-1 U_b'  to every pair of poses, U_a = B_a' W_a,   -B_a' W_a e_a  to xi:
//
// the Schur complement of the landmark. In the body frame W_a rotates with its own pose, and the derivative of the rotation,
// (-e_y, e_x), is added to t_a. A robust kernel acts on each sighting, and m̂ is then the robust mean.
#pragma once

#include "vmslam/edges/sightings.hpp"

namespace vmslam::edges {

/// A sighting about the mean of its landmark: e = m̂ - y, W, and the factor that trust and kernel put on it.
struct AroundMean {
    Vector e;
    Symmetric W;
    double factor;
    Lever lever;
};

/// All sightings, m̂ of each landmark, and the cost.
struct AroundMeans {
    std::vector<AroundMean> sightings;
    std::vector<Vector> means;
    double cost = 0.0;
};

class MarginalEdges : public LandmarkSightings {
   public:
    MarginalEdges(ByLandmark seen, bool body) : LandmarkSightings(std::move(seen)), body_(body) {}

    double accumulate(const State& state, System* system, std::span<const Index> pairs) const override;
    std::unique_ptr<const Family> trusting(std::span<const double> trust) const override {
        auto out = std::make_unique<MarginalEdges>(*this);
        out->seen_.trust.assign(trust.begin(), trust.end());
        return out;
    }
    std::unique_ptr<const Family> among(std::span<const Index> number) const override {
        return std::make_unique<MarginalEdges>(from_nodes(number), body_);
    }
    bool constant(const double* state, Index nodes, ConstantEdges& out) const override;
    /// With the trust of the sightings, or another one.
    AroundMeans around_means(const State& state) const { return around_means(state, seen_.trust); }
    AroundMeans around_means(const State& state, std::span<const double> trust) const;
    std::vector<double> squares(const double* state, std::span<const double> trust) const override;

   private:
    bool body_;
};

}  // namespace vmslam::edges
