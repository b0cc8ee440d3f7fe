// Backward simulation: trajectories drawn from all that one run of a particle filter has computed.
//
// The steps are drawn one after the other, from the last to the first, among all particles that the filter ever had. Given
// the motions d after step t, particle i of step t continues them with the probability
//
//     w_i p(d_{t+1:T}, z_{t+1:T} | history i)
//         = w_i p(d_{t+1:T}) prod over landmarks of N(mean_after; q(x_i, mean_i), S_after + S_i).
//
// The motions d are relative to the pose before, and independent a priori, so their density is the same for all particles and
// cancels: what is drawn is where the rigid rest of the trajectory is attached, by the landmarks that both sides have seen.
// Landmarks are integrated out: `after` is what the later sightings say of them in the axes of the pose.
//
// Of more particles than `candidates`, that many are considered at each step: the ancestor in the filter, and draws by
// weight. This is a step of a conditional SMC, which leaves the distribution unchanged.
//
// Sources: Godsill, Doucet and West, Monte Carlo smoothing for nonlinear time series, JASA 2004; Lindsten and Schön, Backward
// simulation methods for Monte Carlo statistical inference, 2013, chapter 4, for models that are not Markov; Bunch and
// Godsill, Improved particle approximations to the joint smoothing distribution using Markov chain Monte Carlo, 2013.
#pragma once

#include "vmslam/gibbs/problem.hpp"
#include "vmslam/particles/record.hpp"

namespace vmslam::gibbs {

class BackwardSampler {
   public:
    /// The poses of the record are those of the sensor; the motions of the problem are not used.
    BackwardSampler(particles::Record record, Problem problem, Number candidates);

    /// A trajectory of the sensor with a map given the trajectory; several threads may draw at the same time.
    std::pair<Trajectory, Map> draw(Random& random) const;

   private:
    /// A landmark that was seen before and after a step: its Gaussians of the particles, and what later sightings say of it.
    struct Shared {
        const std::vector<Gaussian>* particles;
        const std::int32_t* slots;
        const Gaussian* after;
    };

    Vector pose(Number t, Number i) const {
        const particles::Rows& poses = *record_.steps()[t].poses;
        return {poses.row(0)[i], poses.row(1)[i], poses.row(2)[i]};
    }
    std::span<const double> log_weights(Number t) const { return {record_.steps()[t].log_weights->row(0), count_}; }
    Number parent(Number t, Number i) const { return static_cast<Number>(record_.steps()[t].parents[i]); }
    void compute_maps();
    void observe(Number t);
    Number attach(Random& random, Number t, Number ancestor, std::span<const Shared> shared) const;
    void add_log_likelihoods(Number t, std::span<const Number> particles, std::span<const Shared> shared,
                             std::span<double> log_weights) const;

    particles::Record record_;
    Problem problem_;
    Number count_, candidates_;  ///< N
    std::vector<std::vector<Gaussian>> events_;  ///< of each step at which a landmark was seen: its Gaussians (N)
    std::vector<std::int32_t> last_event_;  ///< (T + 1, J) the last event of each landmark, or -1
    std::vector<std::int32_t> slots_;  ///< (T + 1, J, N) where in that event particle i has its Gaussian
    std::vector<double> cumulative_;  ///< (T + 1, N) sums of the weights
};

}  // namespace vmslam::gibbs
