// One sighting of one landmark: its likelihood, and the Kalman updates of the landmark or of the pose, for eight particles.
//
// The updates factor the covariance of the residual as V = L D L', L with a unit diagonal, and never form the gain. With the
// columns w_k of P H' L'^-1, the residual y = L^-1 e and the entries d_k of D,
//
//     mean += sum of w_k y_k / d_k,     P -= sum of w_k w_k' / d_k,
//     log N(e; 0, V) = -(sum of y_k² / d_k + sum of log d_k) / 2 - constant.
//
// A sighting that cannot be weighed, because the particle stands on the landmark or a number overflows, has the log
// likelihood -inf and changes nothing.
#pragma once

#include "vmslam/particles/gaussian.hpp"

namespace vmslam::particles {

/// From which pose the sightings of known landmarks that correct the poses are weighed.
///
/// `Filter::weigh` takes a scan, the sightings that a map gets at once, eight particles at a time. For these the scan has a
/// `Group`, whose functions are called in this order; each returns log likelihoods, which add up to those of the scan:
///
/// 1. `begin(first, belief)`: the particles from `first` on, and where they are predicted to be. Sightings without ids choose
///    their landmarks.
/// 2. `correct(belief, weighed)`, only where poses are drawn from the corrected motion, as in FastSLAM 2.0: corrects `belief`
///    by sightings of known landmarks, and weighs these if they are `weighed` at the prediction.
/// 3. `update(pose, weighed)`: updates and creates landmarks from the pose that was drawn, and weighs all sightings of known
///    ones, except for those that `correct` has weighed.
enum class Weighed { at_prediction, at_pose };

inline constexpr double log_2pi = 1.8378770664093453;

/// log N(z; h(x, m), Q) of a landmark at a known place; `oriented`: psi is used.
Lanes known_likelihood(const Pose& pose, const Vector& landmark, const Sighting& sighting, bool oriented);

/// A landmark `ahead` of a pose in the direction of a sighting, with variances along and across it; `bearing` is
/// Cov(position across, bearing).
Gaussian landmark_from(const Pose& pose, const Sighting& sighting, double ahead, double along, double across, double bearing);

/// A landmark after its first sighting: mean h^-1(x, z), covariance (H' Q^-1 H)^-1 = R Q R'.
Gaussian initial_landmark(const Pose& pose, const Sighting& sighting);

/// Returns log N(z; h(x, m), V = H S H' + Q) and updates the landmark. `range_variance` replaces that of the sighting.
Lanes update_landmark(Gaussian& landmark, const Pose& pose, const Sighting& sighting, const Lanes& range_variance,
                      bool oriented);

/// Returns log N(z; h(x, m), V = H_x P H_x' + H_m S H_m' + Q) and updates the pose.
Lanes update_pose(Gaussian& pose, const Gaussian& landmark, const Sighting& sighting, bool oriented);

/// The same likelihood, without the update.
Lanes predicted_likelihood(const Gaussian& pose, const Gaussian& landmark, const Sighting& sighting, bool oriented);

/// The squared Mahalanobis distance of two landmarks under S_a + S_b + diag(blur).
Lanes squared_distance(const Gaussian& a, const Gaussian& b, double blur_position, double blur_heading, bool oriented);

/// The product of two Gaussians of one landmark.
Gaussian fused(const Gaussian& a, const Gaussian& b, bool oriented);

/// mean + L n with L L' = P. Where P is degenerate (no noise in some direction) that column of L is zero.
Pose drawn(const Gaussian& pose, const Lanes& n0, const Lanes& n1, const Lanes& n2);

}  // namespace vmslam::particles
