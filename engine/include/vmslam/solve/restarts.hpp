// Restarts which look for a lower minimum near a local one: with one stretch of the trajectory turned by 2 pi, or from where a random
// half of the measurements leads.
//
// Sightings hold headings up to full turns. Where they are few or noisy, mainly the motion edges say how far the robot turns over
// a stretch of poses, and one full turn more or less, spread over the stretch, leads to another minimum. If the headings of an end
// deviate from those of the odometry by E over a stretch whose odometry has the variance V, the motion edges cost about E² / V
// there, and (2 pi - abs(E))² / V after the other turn.
//
// With a robust kernel some sightings may agree on a wrong place while others count little there. Which these are differs from
// minimum to minimum: without a random half of the sightings the steps often leave a wrong one.
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "vmslam/solve/objective.hpp"

namespace vmslam::solve {

/// The measured motions between the poses, the first nodes of a graph.
struct Odometry {
    std::span<const double> motions;  ///< (P, 3) to each pose from the one before it, in the axes of that; 0 for the first
    std::span<const double> variances;  ///< (P) of the turn of each motion; infinite or NaN where it is unknown

    std::size_t poses() const { return variances.size(); }
};

/// A stretch from one pose to a later one.
struct Stretch {
    double rise;  ///< by how much its other turn raises the cost of the motion edges
    std::size_t first, last;
    bool left;  ///< whether the headings turn further to the left over it than in the odometry
};

/// The stretches whose other turn raises the cost of the motion edges little, with the least first. Those of about the same length
/// do not overlap.
std::vector<Stretch> stretches(std::span<const double> state, const Odometry& odometry);
/// The state with the other turn of a stretch, spread over it by the variances. What the position of its last pose is then wrong
/// by is shared evenly.
std::vector<double> other_turn(std::vector<double> state, const Odometry& odometry, const Stretch& stretch);

/// The state that other turns lead to, one after the other, each kept where it lowers J; none where none does.
struct Lowered {
    std::optional<std::vector<double>> state;
    int steps = 0;  ///< that were taken; after `limit` of them no further restart is tried
};
Lowered lowered_by_turns(Objective& objective, std::span<const double> state, const Odometry& odometry, double limit);
/// Alternate two searches from the state until neither lowers J: steps without a random half of the measurements of the families
/// `doubted`, and other turns. The halves are the same in each call.
Lowered lowered_by_halves(GraphObjective& graph, std::span<const std::size_t> doubted, std::span<const double> state,
                          const Odometry& odometry, double limit);

}  // namespace vmslam::solve
