// The convex quadratic function below J that touches it at a candidate: its matrix S, its gradient, rounding errors.
//
// Pose i is a unit complex number z_i = exp(i theta_i) and a complex position t_i. With w = t_b + z_b d_b - t_a - z_a d_a an
// edge with constant information has e_xy = conj(z_a) w and e_theta = theta_b - theta_a - turn. Its cost e' Omega e is at
// least
//
//     J_e(v) + 2 Re(conj(p) (e_xy - v_xy)) + beta |e_xy - v_xy|² + 2 A (1 - cos f) + 2 g sin f,   f = e_theta - v_theta,
//
// for all e, with equality at the residual v of the candidate, where p = (Omega v)_xy, g = (Omega v)_theta,
// Omega - diag(beta, beta, kappa) is positive semidefinite, A = kappa u / tan u and u = g / kappa, if abs(u) < pi. For
// abs(z_i) = 1 this is a Hermitian form of (z, t). See docs/beyond/certificate.md for the derivation.
#pragma once

#include <span>
#include <vector>

#include "vmslam/certificate/exact.hpp"
#include "vmslam/edges/constant.hpp"

namespace vmslam::certificate {

using edges::Index;

/// A node as a unit complex number z and a complex position t.
struct Node {
    Complex z{1.0, 0.0}, t;
    double heading = 0.0;
};

/// The values of all nodes; node -1 is the origin of the world.
class State {
   public:
    /// Positions are kept relative to an `origin`.
    void set(std::span<const double> values, Complex origin);
    const Node& operator[](Index node) const { return nodes_[node + 1]; }
    Index size() const { return static_cast<Index>(nodes_.size()) - 1; }

   private:
    std::vector<Node> nodes_{1};
};

using Edge = edges::ConstantEdge;

/// An edge at a candidate state.
struct Force {
    Complex p;             ///< (Omega v)_xy of the computed residual v
    double p_error, g;     ///< a bound on the rounding error of p; (Omega v)_theta
    Complex reached;       ///< where the end lies in the axes of the first node
    double place_error, heading_error;  ///< how far v may be from the residual of the state
    double cost;
    double slack;  ///< a bound on the rounding errors of the function that touches J, whatever its split
    bool zero;     ///< whether the residual of the state may be zero, so far as its rounding tells
};

/// The split of the information of an edge.
struct Curvature {
    double beta, A;  ///< beta = -1 leaves the edge out
    double error;    ///< a bound on the rounding error of A, in units
    double slack;    ///< what the parts of beta and kappa leave of the rounding errors that they absorb
};

/// The function below J at a candidate state of N nodes, in the variables (z, t) of the nodes that are free.
struct QuadraticBound {
    std::vector<Complex> values;    ///< the 2 x 2 blocks of S on the pattern of the graph
    std::vector<Complex> gradient;  ///< (N, 2) half the gradient at the candidate
    std::vector<double> scale;  ///< (N, 2) the sums of what was added to each diagonal entry of S, or more
    std::vector<double> error;  ///< (N, 2) a bound on the rounding error of the gradient, in units
    double touched = 0.0, slack = 0.0;  ///< the cost at the candidate, and a bound on its rounding errors
};

/// beta and kappa with Omega - diag(beta, beta, kappa) positive semidefinite, also after rounding; beta = -1 for none.
struct Split {
    double beta, kappa;
};
Split split(const edges::Symmetric& information, double share);

Force force(const Node& first, const Node& second, const Edge& edge);

/// The split of an edge. `share` chooses it: beta = (1 - share) times the smallest eigenvalue of the position block of
/// Omega, and kappa the largest number that this beta allows. Where Omega does not correlate position and heading, share
/// counts as 0.
Curvature curvature(const Edge& edge, const Force& force, double share);

/// Write the function below J on the pattern of the graph. The cost is constant in nodes that are not `free`.
void write_quadratic_bound(const State& state, std::span<const Edge> edges, std::span<const char> free,
                           const sparse::Pattern& pattern, std::span<const Force> forces,
                           std::span<const Curvature> curvatures, QuadraticBound& out);

}  // namespace vmslam::certificate
