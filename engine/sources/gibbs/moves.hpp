// The three kinds of moves of a chain, each of which leaves the posterior unchanged; their sources describe them.
#pragma once

#include "vmslam/gibbs/chain.hpp"

namespace vmslam::gibbs {

/// What motion moves and block moves are given.
struct Setting {
    Random& random;
    const Problem& problem;
    std::span<const Sighting> sightings;  ///< with their present covariances
    std::span<const Vector> guess;        ///< (T) motions at which fits begin, and from which the path of a guide is made
    Number particles;                     ///< N
};

/// Renew x in place, from the first motion to the last. Without a correction the density is the linearised one.
void renew_motions(const Setting& given, Correction* correction, Trajectory& x);

/// Renew the poses `begin` to `end` (1 to T) of x in place; `ancestors`: whether particle 0 draws its ancestors.
void renew_block(const Setting& given, bool ancestors, Number begin, Number end, Trajectory& x);

/// A number of moves of a state along the directions, with the step b; returns how many were accepted.
int move_along(Random& random, const Problem& problem, const Directions& directions, double step, int moves, Trajectory& x,
               Map& m);

}  // namespace vmslam::gibbs
