// One Markov chain of particle Gibbs: samples of whole trajectories and maps.
#pragma once

#include "vmslam/gibbs/problem.hpp"

namespace vmslam::gibbs {

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

/// A Gaussian's mode and its widest directions.
///
/// A state is a vector of 3 T + n J numbers: the poses after the first, and the n numbers of each landmark. Without psi n is
/// 2: nothing depends on the headings of landmarks, so that they must not be among the directions.
struct Directions {
    Trajectory poses;
    Map marks;
    std::span<const double> rows;  ///< (r, 3 T + n J), V'
    std::span<const double> deviations;  ///< (r) d
};

struct ChainRules {
    Number particles, block;  ///< N; the steps of a block
    Number sweeps;
    int moves;             ///< of the low-rank moves, after each sweep
    bool warm_up = false;  ///< whether the step of the low-rank moves is adapted
};

/// After each sweep.
struct ChainSamples {
    std::vector<Trajectory> trajectories;
    std::vector<Map> maps;
};

struct Setting;

/// What goes on from one stage of a run to the next.
class Chain {
   public:
    Trajectory poses;           ///< the present trajectory of the sensor
    std::vector<Vector> guess;  ///< motions at which the fits of the motion moves begin
    double accepted = 1.0;      ///< the share of renewed blocks that the last run accepted

    ChainSamples run(Random& random, const Problem& problem, const Directions& directions, const ChainRules& rules);

   private:
    void weigh_sightings(const Problem& problem);
    void renew_blocks(const Setting& given, Number block);
    void move_low_rank(Random& random, const Problem& problem, const Directions& directions, const ChainRules& rules,
                       Number sweep);
    void renew_precisions(Random& random, const Problem& problem);

    Correction state_;  ///< the present map, and the weight of the correction where there is one
    /// Student's t as a mixture: the covariance of sighting k is C_k / precision_k. Ones without it.
    std::vector<double> precision_;
    std::vector<Sighting> sightings_;  ///< with these covariances
    double step_ = 0.3;                ///< of the low-rank moves
    Number tried_ = 0, kept_ = 0;      ///< blocks
};

}  // namespace vmslam::gibbs
