// One Markov chain of particle Gibbs: samples of whole trajectories and maps.
#pragma once

#include "vmslam/gibbs/bends.hpp"
#include "vmslam/gibbs/exact.hpp"

namespace vmslam::gibbs {

struct ChainRules {
    Number particles, block;  ///< N; the steps of a stretch
    Number sweeps;
    int moves;             ///< of the bends, after each sweep
    bool warm_up = false;  ///< whether the step of the bends is adapted
};

/// After each sweep.
struct ChainSamples {
    std::vector<Trajectory> trajectories;
    std::vector<Map> maps;
};

/// What goes on from one stage of a run to the next.
class Chain {
   public:
    Trajectory poses;           ///< the present trajectory of the sensor
    std::vector<Vector> guess;  ///< motions at which the fits of the pivots begin
    double accepted = 1.0;      ///< the share of renewed stretches that the last run accepted

    ChainSamples run(Random& random, const Problem& problem, const Directions& directions, const ChainRules& rules);

   private:
    void weigh_sightings(const Problem& problem);
    void renew_stretches(Random& random, const Problem& problem, const ChainRules& rules);
    void bend(Random& random, const Problem& problem, const Directions& directions, const ChainRules& rules, Number sweep);
    void renew_precisions(Random& random, const Problem& problem);

    Correction state_;  ///< the present map, and the weight of the correction where there is one
    /// Student's t as a mixture: the covariance of sighting k is C_k / precision_k. Ones without it.
    std::vector<double> precision_;
    std::vector<Sighting> sightings_;  ///< with these covariances
    double step_ = 0.3;                ///< of the bends
    Number tried_ = 0, kept_ = 0;      ///< stretches
};

}  // namespace vmslam::gibbs
