// Renew one motion after the other, while everything after it moves along as one rigid body.
//
// The state is the trajectory in relative coordinates, d_t = x_t seen from x_{t-1}. The motions are independent a priori, so
// the conditional of d_t given all others is its prior times the likelihood of the sightings, in which only landmarks seen
// both before and from t on play a part:
//
//     N(d_t; motion, Sigma) prod over landmarks of N(mean_after; q(x_t, mean_before), S_after + S_before),
//
// with what was seen from t on, fused in the axes of x_t, as one sighting. All of it is exact once the landmarks are
// integrated out, and costs O(landmarks) for a candidate. N candidates, of which one is the present d_t, are drawn from a
// Gaussian fitted to this product and weighed exactly: a conditional SMC of one step. This mixes what moves the later
// trajectory and map as a whole, which stretches.hpp moves slowly.
//
// Source: Lindsten, Jordan and Schön, Particle Gibbs with ancestor sampling, JMLR 2014, section 6, for models whose
// future depends on the whole past.
#pragma once

#include "vmslam/gibbs/exact.hpp"

namespace vmslam::gibbs {

/// One pass over all motions of a trajectory.
class Pivots {
   public:
    /// The sightings have their present covariances, `guess` has the motions (T) at which the fits begin. Without a
    /// correction the density is the linearised one.
    Pivots(const Problem& problem, std::span<const Sighting> sightings, std::span<const Vector> guess, Number candidates,
           Correction* correction)
        : problem_(problem),
          sightings_(sightings),
          guess_(guess),
          candidates_(candidates),
          log_weights_(candidates),
          correction_(correction) {}

    /// Renew x in place, from the first motion to the last.
    void renew(Random& random, Trajectory& x);

   private:
    /// A Gaussian of candidates: N(mean, P) of the displacement from `middle`, in the axes there.
    struct Fit {
        Vector middle, mean;
        Symmetric P;
    };

    void look_ahead(const Trajectory& x);
    Gaussian* after(Number t) { return after_.data() + t * problem_.marks; }
    void find_shared(Number t);
    Fit fit(Number t, const Frame& start) const;
    double log_likelihood(const Frame& pose) const;
    Vector choose(Random& random, Number t, const Frame& start);
    void move(Random& random, Trajectory& x, Number t, const Frame& start, const Vector& d) const;

    struct Shared {
        const Gaussian *before, *after;
    };

    const Problem& problem_;
    std::span<const Sighting> sightings_;
    std::span<const Vector> guess_;
    std::vector<Vector> candidates_;
    std::vector<double> log_weights_;
    Correction* correction_;
    std::vector<Vector> motions_;           ///< (T) the present d_t
    std::vector<Gaussian> before_, after_;  ///< (J); (T + 1, J), in the axes of each pose
    std::vector<Shared> shared_;
};

}  // namespace vmslam::gibbs
