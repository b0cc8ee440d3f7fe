// Renew a stretch of poses between two fixed ends: conditional SMC with ancestor sampling, landmarks integrated out.
//
// The poses x_s to x_e are renewed; those before and after stay where they are in the world, with what their sightings say of
// the landmarks. N particles start at x_{s-1}; each has its own Gaussians of the landmarks that the stretch sees. Particle 0
// is the present stretch. Each pose is drawn from the Gaussian of motion times guide, and weighed exactly:
//
//     p(x_t | x_{t-1}) p(z_t | x_t, map) psi_t(x_t) / (psi_{t-1}(x_{t-1}) q(x_t)),
//
// where psi_t, a Gaussian, looks ahead: roughly the likelihood of the sightings after t and of the fixed end x_{e+1}. At e it
// is replaced by p(x_{e+1} | x_e) itself, so psi only makes the particles better. Particles are resampled where the effective
// sample size falls below half; particle 0 then draws its ancestor with the weights
//
//     w_i p(x'_{t+1} | x_t^i) / psi_t(x_t^i) * prod p(z | x^i, m) / p(z | x^i)
//
// over the sightings of the stretch so far, where m is a draw of the map given the present trajectory. m is a last,
// unweighted step of the SMC, which is what makes these weights those of the whole future without looking at it.
//
// Sources: Andrieu, Doucet and Holenstein, Particle Markov chain Monte Carlo methods, JRSS B 2010; Lindsten, Jordan and
// Schön, Particle Gibbs with ancestor sampling, JMLR 2014; Kok, Solin and Schön, Rao-Blackwellized particle smoothing for
// simultaneous localization and mapping, Data-Centric Engineering 2024; Guarniero, Johansen and Lee, The iterated auxiliary
// particle filter, JASA 2017, for psi.
#pragma once

#include "vmslam/gibbs/problem.hpp"

namespace vmslam::gibbs {

/// The landmarks that a stretch sees, by numbers of their own, and what the rest of the log says of them.
struct LocalMap {
    std::vector<Number> number;  ///< (J) the local number of each landmark that the stretch sees
    std::vector<Gaussian> before;

    LocalMap(const Problem& problem, std::span<const Sighting> sightings, const Trajectory& x, Number begin, Number end);
};

/// psi: the information on displacements of the poses `middle` from what comes after each of them.
///
/// A landmark counts with what the rest of the log says of it; those that only the stretch sees are left out.
struct Guide {
    std::vector<Frame> middle;  ///< (n) the path about which sightings and motions are linearised
    std::vector<Information> ahead;  ///< (n) without the sightings of the pose itself
    std::vector<Information> full;  ///< (n) with them

    /// Look back from the end: `following` is the first pose after the stretch, if there is one.
    void compute(const Problem& problem, std::span<const Sighting> sightings, const LocalMap& map, Number begin,
                 const Vector* following);
};

/// A Gaussian of the displacement of a pose from a place: N(mean, P).
struct Proposal {
    Vector mean;
    Symmetric P;
};
/// Motion times guide.
Proposal proposal(const Frame& start, const Frame& middle, const Motion& motion, const Information& guide);

struct StretchRules {
    Number particles;
    bool ancestors;  ///< whether particle 0 draws its ancestors
};

/// Renew the poses `begin` to `end` (1 to T) of x in place. `guess` (T) has motions from which the path of the guide is made.
void renew_stretch(Random& random, const Problem& problem, std::span<const Sighting> sightings, std::span<const Vector> guess,
                   const StretchRules& rules, Number begin, Number end, Trajectory& x);

}  // namespace vmslam::gibbs
