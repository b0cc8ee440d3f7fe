// Renew a block of poses between two fixed ends: conditional SMC with ancestor sampling, landmarks integrated out.
//
// The poses x_s to x_e are renewed; those before and after stay where they are in the world, with what their sightings say of
// the landmarks. N particles start at x_{s-1}; each has its own Gaussians of the landmarks that the block sees. Particle 0
// is the present block. Each pose is drawn from the Gaussian of motion times guide, and weighed exactly:
//
//     p(x_t | x_{t-1}) p(z_t | x_t, map) psi_t(x_t) / (psi_{t-1}(x_{t-1}) q(x_t)),
//
// where psi_t, a Gaussian, looks ahead: roughly the likelihood of the sightings after t and of the fixed end x_{e+1}. At e it
// is replaced by p(x_{e+1} | x_e) itself, so psi only makes the particles better. Particles are resampled where the effective
// sample size falls below half; particle 0 then draws its ancestor with the weights
//
//     w_i p(x'_{t+1} | x_t^i) / psi_t(x_t^i) * prod p(z | x^i, m) / p(z | x^i)
//
// over the sightings of the block so far, where m is a draw of the map given the present trajectory. m is a last,
// unweighted step of the SMC, which is what makes these weights those of the whole future without looking at it.
//
// Sources: Andrieu, Doucet and Holenstein, Particle Markov chain Monte Carlo methods, JRSS B 2010; Lindsten, Jordan and
// Schön, Particle Gibbs with ancestor sampling, JMLR 2014; Kok, Solin and Schön, Rao-Blackwellized particle smoothing for
// simultaneous localization and mapping, Data-Centric Engineering 2024; Guarniero, Johansen and Lee, The iterated auxiliary
// particle filter, JASA 2017, for psi.
#include <algorithm>
#include <numeric>

#include "moves.hpp"

namespace vmslam::gibbs {
namespace {

/// The landmarks that a block sees, by numbers of their own, and what the rest of the log says of them.
struct LocalMap {
    std::vector<Number> number;  ///< (J) the local number of each landmark that the block sees
    std::vector<Gaussian> before;

    LocalMap(const Problem& problem, std::span<const Sighting> sightings, const Trajectory& x, Number begin, Number end)
        : number(problem.marks, problem.marks) {
        const Number none = problem.marks;
        Number count = 0;
        for (const Sighting& s : seen_at(problem, sightings, begin, end))
            if (number[s.mark] == none) number[s.mark] = count++;
        before.resize(count);
        const auto absorb = [&](const Frame& pose, const Sighting& s) {
            if (number[s.mark] != none) fuse(before[number[s.mark]], composed(pose, s.seen), problem.oriented);
        };
        each_with_pose(x, seen_at(problem, sightings, 0, begin - 1), absorb);
        if (end < problem.steps()) each_with_pose(x, seen_at(problem, sightings, end + 1, problem.steps()), absorb);
    }
};

/// psi: the information on displacements of the poses `middle` from what comes after each of them.
///
/// A landmark counts with what the rest of the log says of it; those that only the block sees are left out.
struct Guide {
    std::vector<Frame> middle;  ///< (n) the path about which sightings and motions are linearised
    std::vector<Information> ahead;  ///< (n) without the sightings of the pose itself
    std::vector<Information> full;  ///< (n) with them

    /// Look back from the end: `following` is the first pose after the block, if there is one.
    void compute(const Problem& problem, std::span<const Sighting> sightings, const LocalMap& map, Number begin,
                 const Vector* following);
};

/// A Gaussian of the displacement of a pose from a place: N(mean, P).
struct Proposal {
    Vector mean;
    Symmetric P;
};

/// Of the next pose, with the information `next` at its place in the path, as a landmark whose sighting is the motion.
void add_next(Information& ahead, const Frame& middle, const Frame& next_middle, const Motion& motion,
              const Information& next) {
    const Vector d = relative(middle, next_middle.at);
    const Rotation axes = rotation(d.t);
    const Symmetric &W = motion.information, M = edges::turned(axes, next.L);
    const Vector pull = W * (inverse(W + M).matrix * turned(axes, next.eta));
    const Symmetric reduced = passed(W, M);
    ahead.add_at(d, reduced, pull + reduced * deviation(motion.mean, d));
}

void Guide::compute(const Problem& problem, std::span<const Sighting> sightings, const LocalMap& map, Number begin,
                    const Vector* following) {
    const Number n = middle.size();
    ahead.assign(n, {});
    full.resize(n);
    for (Number i = n; i-- > 0;) {
        const Number t = begin + i;
        if (i + 1 < n) {
            add_next(ahead[i], middle[i], middle[i + 1], problem.motions[t], full[i + 1]);
        } else if (following) {
            // a known pose, whose sighting is the motion
            const Motion& motion = problem.motions[t];
            ahead[i].add_sighting(middle[i], {*following, {}}, {motion.mean, inverse(motion.information).matrix}, true);
        }
        full[i] = ahead[i];
        for (const Sighting& s : seen_at(problem, sightings, t, t)) {
            const Gaussian& mark = map.before[map.number[s.mark]];
            if (mark.seen()) full[i].add_sighting(middle[i], mark, s.seen, problem.oriented);
        }
    }
}

/// Motion times guide.
Proposal proposal(const Frame& start, const Frame& middle, const Motion& motion, const Information& guide) {
    const Vector predicted = relative(middle, composed(start, motion.mean));
    // the prior's axes are those of the start
    const Symmetric prior = edges::turned(rotation(start.at.t - middle.at.t), motion.information);
    const Symmetric P = inverse(prior + guide.L).matrix;
    return {P * (prior * predicted + guide.eta), P};
}

/// Particles are resampled below this share of N.
constexpr double least_share = 0.5;

/// The particles of a block. The weights of particle p and what belongs to it are those of its whole path so far.
class BlockMove : Setting {
   public:
    BlockMove(const Setting& given, bool ancestors, Number begin, Number end, Trajectory& x)
        : Setting(given),
          draws_ancestors_(ancestors),
          begin_(begin),
          end_(end),
          x_(x),
          map_(problem, sightings, x, begin, end),
          count_(map_.before.size()) {}

    void renew() {
        if (draws_ancestors_) draw_map();
        linearise();
        start();
        for (Number i = 0; i < size(); ++i) {
            move(i);
            if (i + 1 < size()) resample(i);
        }
        Number chosen = random.choose(log_weights_);
        for (Number i = size(); i-- > 0;) {
            x_[begin_ + i] = at(i, chosen);
            chosen = parents_[i * particles + chosen];
        }
    }

   private:
    Number size() const { return end_ - begin_ + 1; }
    const Vector* following() const { return end_ < problem.steps() ? &x_[end_ + 1] : nullptr; }
    Vector& at(Number i, Number p) { return poses_[i * particles + p]; }
    const Motion& motion_to(Number i) const { return problem.motions[begin_ + i - 1]; }

    /// m, a map for the ancestors, drawn given the present trajectory.
    void draw_map() {
        std::vector<Gaussian> all = map_.before;
        each_with_pose(x_, seen_at(problem, sightings, begin_, end_), [&](const Frame& pose, const Sighting& s) {
            fuse(all[map_.number[s.mark]], composed(pose, s.seen), problem.oriented);
        });
        for (const Gaussian& mark : all) drawn_.push_back(drawn(random, mark.mean, mark.S));
    }

    /// The path of the guide: first that of the guessed motions, then that of the means of the proposals.
    void linearise() {
        constexpr int fits = 2;  // Gauss-Newton steps to the path about which the guide is linearised
        guide_.middle.resize(size());
        Frame pose(x_[begin_ - 1]);
        for (Number i = 0; i < size(); ++i) guide_.middle[i] = pose = Frame(composed(pose, guess[begin_ - 1 + i]));
        guide_.compute(problem, sightings, map_, begin_, following());
        for (int k = 1; k < fits; ++k) {
            pose = Frame(x_[begin_ - 1]);
            for (Number i = 0; i < size(); ++i) {
                Frame& middle = guide_.middle[i];
                middle = pose = Frame(composed(middle, proposal(pose, middle, motion_to(i), guide_.full[i]).mean));
            }
            guide_.compute(problem, sightings, map_, begin_, following());
        }
    }

    void start() {
        const Number N = particles;
        poses_.resize(size() * N);
        parents_.resize(size() * N);
        maps_.reserve(N * count_);
        for (Number p = 0; p < N; ++p) maps_.insert(maps_.end(), map_.before.begin(), map_.before.end());
        log_weights_.assign(N, 0.0), surplus_.assign(N, 0.0), psi_.assign(N, 0.0);
        ancestors_.resize(N);
        std::iota(ancestors_.begin(), ancestors_.end(), Number{0});
    }

    /// Draw pose i of all particles, and weigh them.
    void move(Number i) {
        const Frame& middle = guide_.middle[i];
        const Motion& motion = motion_to(i);
        for (Number p = 0; p < particles; ++p) {
            const Frame from(i == 0 ? x_[begin_ - 1] : at(i - 1, ancestors_[p]));
            const Proposal q = proposal(from, middle, motion, guide_.full[i]);
            const LowerRoot root(q.P);
            Vector pose = x_[begin_ + i], d, n;
            if (p == 0) {
                d = relative(middle, pose);
                n = root.whitened(deviation(q.mean, d));
            } else {
                n = normals(random);
                d = q.mean + root * n;
                d.t = wrap_angle(d.t);
                pose = composed(middle, d);
            }
            at(i, p) = pose;
            parents_[i * particles + p] = ancestors_[p];
            // log p(x_t | x_{t-1}) / q(x_t)
            double value = 0.5 * dot(n, n) + logarithm(root.determinant());
            value -= 0.5 * squared(motion.information, deviation(motion.mean, relative(from, pose)));
            const Frame there(pose);
            value += observe(i, p, there);
            log_weights_[p] += value + look_ahead(i, p, there, d);
        }
    }

    /// log p(z_t | x_t, map) of a particle, whose map absorbs the sightings.
    double observe(Number i, Number p, const Frame& pose) {
        double sum = 0.0;
        for (const Sighting& s : seen_at(problem, sightings, begin_ + i, begin_ + i)) {
            const Number j = map_.number[s.mark];
            const Gaussian seen = composed(pose, s.seen);
            const double increment = fuse(maps_[p * count_ + j], seen, problem.oriented);
            sum += increment;
            // log p(z | x, m) / p(z | x)
            if (draws_ancestors_) surplus_[p] += density({drawn_[j], {}}, seen, problem.oriented) - increment;
        }
        return sum;
    }

    /// log psi_t(x_t) / psi_{t-1}(x_{t-1}); at the end p(x_{e+1} | x_e) in place of psi_e.
    double look_ahead(Number i, Number p, const Frame& pose, const Vector& d) {
        const double before = psi_[p];
        if (i + 1 < size()) {
            psi_[p] = guide_.ahead[i].quadratic(d);
            return psi_[p] - before;
        }
        return (following() ? log_motion(end_, pose, *following()) : 0.0) - before;
    }

    /// log p(x_{t+1} | x_t) without constants.
    double log_motion(Number t, const Frame& pose, const Vector& next) const {
        const Motion& motion = problem.motions[t];
        return -0.5 * squared(motion.information, deviation(motion.mean, relative(pose, next)));
    }

    /// Draw the ancestors of the particles of the next pose, where the effective sample size has become small.
    void resample(Number i) {
        const Number N = particles;
        std::vector<double> weights(N);
        const Sums sums = exponentials(log_weights_, weights);
        if (sums.weights * sums.weights >= least_share * static_cast<double>(N) * sums.squares) {
            std::iota(ancestors_.begin(), ancestors_.end(), Number{0});
            return;
        }
        ancestors_[0] = draws_ancestors_ ? ancestor_of_first(i) : 0;
        for (Number p = 1; p < N; ++p) ancestors_[p] = random.pick(weights);
        const std::vector<double> surplus = surplus_, psi = psi_;
        spare_.resize(maps_.size());
        for (Number p = 0; p < N; ++p) {
            const Number a = ancestors_[p];
            std::copy_n(maps_.begin() + a * count_, count_, spare_.begin() + p * count_);
            surplus_[p] = surplus[a], psi_[p] = psi[a];
        }
        std::swap(maps_, spare_);
        log_weights_.assign(N, 0.0);
    }

    Number ancestor_of_first(Number i) {
        std::vector<double> rho(particles);
        for (Number p = 0; p < rho.size(); ++p)
            rho[p] = log_weights_[p] - psi_[p] + log_motion(begin_ + i, Frame(at(i, p)), x_[begin_ + i + 1]) + surplus_[p];
        return random.choose(rho);
    }

    bool draws_ancestors_;
    Number begin_, end_;
    Trajectory& x_;
    LocalMap map_;
    Number count_;  ///< landmarks of the local map
    Map drawn_;  ///< m
    Guide guide_;
    std::vector<Vector> poses_;  ///< (n, N)
    std::vector<Number> parents_;  ///< (n, N) the particle of the pose before
    std::vector<Gaussian> maps_, spare_;  ///< (N, count)
    std::vector<double> log_weights_;
    std::vector<double> surplus_;  ///< log prod p(z | x, m) / p(z | x)
    std::vector<double> psi_;  ///< log psi of the pose before
    std::vector<Number> ancestors_;
};

}  // namespace

void renew_block(const Setting& given, bool ancestors, Number begin, Number end, Trajectory& x) {
    BlockMove(given, ancestors, begin, end, x).renew();
}

}  // namespace vmslam::gibbs
