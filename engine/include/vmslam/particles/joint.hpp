// Landmarks beyond linearisation: a landmark from all of its sightings at once.
//
// Updates of a Gaussian, however good, add an error with every sighting, because the posterior of a landmark is no Gaussian.
// Here nothing is carried over but the poses from which the landmark was seen. At its K-th sighting
//
//     Z_K = integral of prod over k <= K of N(z_k; h(x_k, m), Q_k) dm
//
// is computed anew, and the weight is multiplied by Z_K / Z_{K-1}. The product of all weights is the last Z, so errors do not
// add up, and the mean and covariance of the landmark are those of the integrand. Z_1 is the range, in closed form.
//
// The integral is taken by Gauss-Hermite points about the mode, found by Gauss-Newton, with the curvature there. The heading
// of a landmark is linear given its position, and is integrated exactly. An update costs O(K), so that after
// `most_sightings`, when the posterior is nearly Gaussian, the following ones are integrated alone.
//
// Sources: Naylor and Smith, Applications of a method for the efficient computation of posterior distributions, Applied
// Statistics 1982, for the points about the mode; Ito and Xiong, Gaussian filters for nonlinear filtering problems, IEEE
// Transactions on Automatic Control 2000.
#pragma once

#include <span>

#include "vmslam/particles/gaussian.hpp"

namespace vmslam::particles {

/// The most sightings of a landmark that can be integrated together.
inline constexpr std::size_t most_sightings = 16;

/// A sighting whose range has the variance (rate r)² + variances.range.
struct RatedSighting {
    Sighting sighting;
    double rate;
};

/// The first sighting: the moments of r (cos, sin)(theta + phi'), r of density r N(r; l, q_l), phi' ~ N(phi, q_phi).
Gaussian initial_moments(const Pose& pose, const Sighting& sighting);

/// log Z and the Gaussian of a landmark.
struct Evidence {
    Lanes value;
    Gaussian landmark;
    /// the lanes in which the points found the posterior
    numbers::Integers found;
};

/// A landmark that was sighted from some poses. `about`: where the search for the mode begins.
Evidence joint_evidence(std::span<const Pose> poses, std::span<const RatedSighting> sightings, const Gaussian& about,
                        bool oriented);

/// The prior times the likelihood of one sighting.
Evidence single_evidence(const Gaussian& prior, const Gaussian& about, const Pose& pose, const RatedSighting& sighting,
                         bool oriented);

}  // namespace vmslam::particles
