// The exact range-bearing density against its linearisation, for a Metropolis correction.
#pragma once

#include "vmslam/gibbs/problem.hpp"

namespace vmslam::gibbs {

/// The errors of range, bearing and psi of a sighting whose landmark is at a relative place, squared, over their variances.
double exact_squares(const Vector& z, const Vector& q, const Vector& place, bool oriented);

/// A draw of the landmarks given a trajectory.
Map draw_map(Random& random, const Trajectory& x, std::span<const Sighting> sightings, Number marks, bool oriented);

/// The sum of log N(z; h(x, m), diag(q)) - log N(y; relative place, C), without constants.
double log_ratio(const Trajectory& x, const Map& m, std::span<const Sighting> sightings, bool oriented);

/// Accepts or rejects trajectories drawn by a kernel that is reversible for the linearised density, each with a new map.
///
/// The map is drawn from the linearised density given the trajectory. So (trajectory, map) together are the proposal of a
/// kernel that is reversible, too, and the probability of acceptance is the ratio of w = exact / linearised density.
class Correction {
   public:
    Map map;                  ///< the present one
    double log_weight = 0.0;  ///< log w of the present trajectory and map

    bool accepts(Random& random, const Trajectory& trial, std::span<const Sighting> sightings, bool oriented);
};

}  // namespace vmslam::gibbs
