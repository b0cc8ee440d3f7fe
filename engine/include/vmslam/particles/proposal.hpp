// The proposal of FastSLAM 2.0: poses drawn from a corrected prediction, with the exact importance weight of the draw.
//
// A motion is predicted as the Gaussian N(m, P), P = A A' + epsilon I, where A = df/du diag(std) belongs to the noise
// c ~ N(0, I) of the control. The sightings correct it, with h linearised, to the proposal q(x) = N(x; m+, P+). A pose x*
// drawn from q instead of from the motion multiplies the weight by
//
//     p(x*) / q(x*) = N(x*; m, P) / N(x*; m+, P+),
//
// and each sighting multiplies it by its likelihood at the drawn pose, as in FastSLAM 1.0. What the linearisation neglects
// then makes the weights less equal, but not wrong.
//
// The motion is not Gaussian: x = f(x_{t-1}, u + diag(std) c) + e with e ~ N(0, epsilon I). In the linear model the noise of
// a motion that ends at x* is c | x* ~ N(A' P^-1 d, I - A' P^-1 A) and e = d - A c, with d = x* - m. This noise is drawn and
// put into f. Proposal and motion have the same density of the noise given x*, so the factor above is exact for f as well.
//
// The original FastSLAM 2.0 weighs by N(z; h(m), V) under the prediction, which is the same only where f and h are linear.
//
// Sources: Montemerlo, Thrun, Koller and Wegbreit, FastSLAM 2.0, IJCAI 2003; Liu, Monte Carlo Strategies in Scientific
// Computing, 2001, section 2.5, for the weight.
#pragma once

#include "vmslam/particles/motion.hpp"

namespace vmslam::particles {

/// The epsilon of the proposal, for a motion whose control gives the `variance` (the trace of A A').
double widened(double epsilon, double variance);

/// The epsilon of the proposal for a whole motion: 0 where its covariance P has an inverse.
double lacking(const Symmetric& P);

/// f(x, u + diag(std) c), the heading not wrapped.
Pose driven(const Pose& x, const ControlMotion& u, const Lanes& c0, const Lanes& c1);

/// A drawn pose, and log p(x*) - log q(x*).
struct Drawn {
    Pose pose;
    Lanes log_ratio;
};

/// Draws poses from their corrected Gaussians, with the weight of the draw.
class WeightedDraw {
   public:
    explicit WeightedDraw(const Motion& motion);

    /// `start`: the pose before the motion; `belief`: N(m+, P+) after the motion and its sightings.
    Drawn operator()(const Pose& start, const Gaussian& belief, const numbers::Bits& particles) const;

   private:
    void whiten(const Symmetric& P);
    Pose with_control(const Pose& start, const Pose& deviation, const Pose& a, const Lanes& n3, const Lanes& n4) const;

    Motion motion_;
    double angle_;
    Vector mean_;
    /// L^-1 of P = L L', row by row, and log det L
    double w00_, w10_, w11_, w20_, w21_, w22_, log_scale_;
    /// the largest conditional variances that count as rounding
    double least_position_, least_heading_;
    /// B = A' L'^-1 (2 x 3), row by row, and the lower triangle of C, C C' = I - B B': c = B a + C w
    Vector b0_{}, b1_{};
    double c00_ = 0.0, c10_ = 0.0, c11_ = 0.0;
    /// the nonzero entries of A, and sqrt(epsilon / the epsilon of the proposal)
    double along_nu_ = 0.0, along_ = 0.0, across_ = 0.0, turn_ = 0.0, scale_ = 0.0;
};

}  // namespace vmslam::particles
