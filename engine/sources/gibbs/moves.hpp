// The three kinds of moves of a chain, each of which leaves the posterior unchanged; their sources describe them.
#pragma once

#include "vmslam/gibbs/chain.hpp"

namespace vmslam::gibbs {

/// Renew x in place, from the first motion to the last. The sightings have their present covariances, `guess` has the motions
/// (T) at which the fits begin. Without a correction the density is the linearised one.
void renew_motions(Random& random, const Problem& problem, std::span<const Sighting> sightings, std::span<const Vector> guess,
                   Number candidates, Correction* correction, Trajectory& x);

/// Renew the poses `begin` to `end` (1 to T) of x in place. `guess` (T) has motions from which the path of the guide is made;
/// `ancestors`: whether particle 0 draws its ancestors.
void renew_block(Random& random, const Problem& problem, std::span<const Sighting> sightings, std::span<const Vector> guess,
                 Number particles, bool ancestors, Number begin, Number end, Trajectory& x);

/// A number of moves of a state along the directions, with the step b; returns how many were accepted.
int move_along(Random& random, const Problem& problem, const Directions& directions, double step, int moves, Trajectory& x,
               Map& m);

}  // namespace vmslam::gibbs
