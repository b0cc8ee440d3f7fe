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
// trajectory and map as a whole, which blocks move slowly.
//
// Source: Lindsten, Jordan and Schön, Particle Gibbs with ancestor sampling, JMLR 2014, section 6, for models whose
// future depends on the whole past.
#include "moves.hpp"

namespace vmslam::gibbs {
namespace {

/// The information on a displacement of the end of a motion, in the axes there, from the motion's prior.
Information prior_at(const Vector& middle, const Motion& motion) {
    const Rotation back = rotation(-middle.t);
    const Symmetric W = edges::turned(back, motion.information);
    const Vector d = deviation(middle, motion.mean);
    return {W, W * turned(back, d)};
}

/// One pass over all motions of a trajectory.
class MotionMoves : Setting {
   public:
    MotionMoves(const Setting& given, Correction* correction)
        : Setting(given), candidates_(particles), log_weights_(particles), correction_(correction) {}

    void renew(Trajectory& x) {
        look_ahead(x);
        for (const Sighting& s : seen_at(problem, sightings, 0, 0))
            fuse(before_[s.mark], composed(Frame(x[0]), s.seen), problem.oriented);
        for (Number t = 1; t < x.size(); ++t) {
            const Frame start(x[t - 1]);
            find_shared(t);
            const Motion& motion = problem.motions[t - 1];
            // without shared landmarks nothing but the prior
            const Vector d =
                shared_.empty() ? drawn(random, motion.mean, inverse(motion.information).matrix) : choose(t, start);
            move(x, t, start, d);
            const Frame pose(x[t]);
            for (const Sighting& s : seen_at(problem, sightings, t, t))
                fuse(before_[s.mark], composed(pose, s.seen), problem.oriented);
        }
    }

   private:
    /// A Gaussian of candidates: N(mean, P) of the displacement from `middle`, in the axes there.
    struct Fit {
        Vector middle, mean;
        Symmetric P;
    };

    Gaussian* after(Number t) { return after_.data() + t * problem.marks; }

    /// What the sightings from each step on say of the landmarks, in the axes of that pose.
    void look_ahead(const Trajectory& x) {
        const Number T = problem.steps(), J = problem.marks;
        before_.assign(J, {});
        after_.assign((T + 1) * J, {});
        motions_.resize(T);
        for (Number t = T; t > 0; --t) {
            motions_[t - 1] = relative(Frame(x[t - 1]), x[t]);
            if (t < T) {
                const Frame d(motions_[t]);
                for (Number j = 0; j < J; ++j) {
                    const Gaussian& next = after(t + 1)[j];
                    if (next.seen()) after(t)[j] = composed(d, next);
                }
            }
            for (const Sighting& s : seen_at(problem, sightings, t, t)) fuse(after(t)[s.mark], s.seen, problem.oriented);
        }
    }

    void find_shared(Number t) {
        shared_.clear();
        for (Number j = 0; j < problem.marks; ++j)
            if (before_[j].seen() && after(t)[j].seen()) shared_.push_back({&before_[j], after(t) + j});
    }

    Fit fit(Number t, const Frame& start) const {
        constexpr int fits = 3;  // Gauss-Newton steps to the Gaussian of the candidates
        Fit fit{guess[t - 1], {}, {}};
        for (int k = 0; k < fits; ++k) {
            if (k > 0) fit.middle = composed(Frame(fit.middle), fit.mean);
            Information sum = prior_at(fit.middle, problem.motions[t - 1]);
            const Frame pose(composed(start, fit.middle));
            for (const auto& [before, after] : shared_) sum.add_sighting(pose, *before, *after, problem.oriented);
            fit.P = inverse(sum.L).matrix;
            fit.mean = fit.P * sum.eta;
        }
        return fit;
    }

    /// The sum of log N(mean_after; q(x_t, mean_before), S_after + S_before), in world axes.
    double log_likelihood(const Frame& pose) const {
        LogDensities densities;
        for (const auto& [before, after] : shared_) densities.add(*before, composed(pose, *after), problem.oriented);
        return densities.sum();
    }

    Vector choose(Number t, const Frame& start) {
        const Fit proposal = fit(t, start);
        const Motion& motion = problem.motions[t - 1];
        const LowerRoot root(proposal.P);
        const Frame middle(proposal.middle);
        for (Number n = 0; n < candidates_.size(); ++n) {
            Vector d = motions_[t - 1], e;
            if (n == 0) {
                e = root.whitened(deviation(proposal.mean, relative(middle, d)));
            } else {
                e = normals(random);
                d = composed(middle, proposal.mean + root * e);
            }
            candidates_[n] = d;
            // log of prior and likelihood over the density of the proposal
            const double over_proposal = 0.5 * (dot(e, e) - squared(motion.information, deviation(motion.mean, d)));
            log_weights_[n] = over_proposal + log_likelihood(Frame(composed(start, d)));
        }
        return candidates_[random.choose(log_weights_)];
    }

    /// Set d_t; with a correction, all later poses move along, and the whole trajectory is accepted or not.
    void move(Trajectory& x, Number t, const Frame& start, const Vector& d) const {
        if (!correction_) {
            x[t] = composed(start, d);
            return;
        }
        Trajectory trial = x;
        trial[t] = composed(start, d);
        for (Number later = t; later + 1 < x.size(); ++later)
            trial[later + 1] = composed(Frame(trial[later]), motions_[later]);
        if (correction_->accepts(random, trial, sightings, problem.oriented)) x = std::move(trial);
    }

    struct Shared {
        const Gaussian *before, *after;
    };

    std::vector<Vector> candidates_;
    std::vector<double> log_weights_;
    Correction* correction_;
    std::vector<Vector> motions_;           ///< (T) the present d_t
    std::vector<Gaussian> before_, after_;  ///< (J); (T + 1, J), in the axes of each pose
    std::vector<Shared> shared_;
};

}  // namespace

void renew_motions(const Setting& given, Correction* correction, Trajectory& x) { MotionMoves(given, correction).renew(x); }

}  // namespace vmslam::gibbs
