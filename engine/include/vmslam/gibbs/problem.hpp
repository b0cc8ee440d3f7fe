// What a sampler of trajectories and maps is given: the motions and sightings of a log.
#pragma once

#include <vector>

#include "vmslam/gibbs/gaussian.hpp"

namespace vmslam::gibbs {

using Number = std::size_t;
using Trajectory = std::vector<Vector>;
using Map = std::vector<Vector>;

/// d_t = x_t seen from x_{t-1}, d_t ~ N(mean, information^-1).
struct Motion {
    Vector mean;
    Symmetric information;
};

struct Sighting {
    Number step, mark;
    Vector y;          ///< the relative place of the landmark
    Symmetric C;       ///< and its covariance
    Symmetric weight;  ///< its information; without psi nothing of the headings
    Vector z, q;       ///< range, bearing and psi as measured, and their variances
};

struct Problem {
    std::vector<Motion> motions;  ///< (T)
    std::vector<Sighting> sightings;
    std::vector<Number> first;  ///< (T + 2) those of step t are first[t] to first[t + 1] - 1
    Number marks;               ///< the number of landmarks
    bool oriented;              ///< whether psi is measured
    bool exact;                 ///< whether sightings have the density of range and bearing, or the linearised one
    double degrees;             ///< of freedom of Student's t distribution of the sightings; 0: Gaussian

    Number steps() const { return motions.size(); }
    double coordinates() const { return oriented ? 3.0 : 2.0; }
};

/// The sightings of some steps.
inline std::span<const Sighting> seen_at(const Problem& problem, std::span<const Sighting> sightings, Number from,
                                         Number to) {
    return sightings.subspan(problem.first[from], problem.first[to + 1] - problem.first[from]);
}

}  // namespace vmslam::gibbs
