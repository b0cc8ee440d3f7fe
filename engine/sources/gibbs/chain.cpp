#include "vmslam/gibbs/chain.hpp"

#include <algorithm>

#include "moves.hpp"

namespace vmslam::gibbs {
namespace {

/// The share of the low-rank moves that should be accepted.
constexpr double aim = 0.3;

/// The sum of log N(z; h(x, m), diag(q)) - log N(y; relative place, C), without constants.
double log_ratio(const Trajectory& x, const Map& m, std::span<const Sighting> sightings, bool oriented) {
    double total = 0.0;
    each_with_pose(x, sightings, [&](const Frame& pose, const Sighting& s) {
        const Vector place = relative(pose, m[s.mark]);
        const Vector r = deviation(s.seen.mean, place, oriented);
        total -= 0.5 * (exact_squares(s.z, s.q, place, oriented) - squared(inverse(s.seen.S).matrix, r));
    });
    return total;
}

}  // namespace

bool Correction::accepts(Random& random, const Trajectory& trial, std::span<const Sighting> sightings, bool oriented) {
    Map candidate = draw_map(random, trial, sightings, map.size(), oriented);
    const double value = log_ratio(trial, candidate, sightings, oriented);
    if (logarithm(random.uniform()) >= value - log_weight) return false;
    map = std::move(candidate);
    log_weight = value;
    return true;
}

ChainSamples Chain::run(Random& random, const Problem& problem, const Directions& directions, const ChainRules& rules) {
    ChainSamples samples;
    tried_ = kept_ = 0;
    weigh_sightings(problem);
    state_.map = draw_map(random, poses, sightings_, problem.marks, problem.oriented);
    for (Number sweep = 0; sweep < rules.sweeps; ++sweep) {
        if (problem.exact) state_.log_weight = log_ratio(poses, state_.map, sightings_, problem.oriented);
        Correction* const correction = problem.exact ? &state_ : nullptr;
        const Setting setting{random, problem, sightings_, guess, rules.particles};
        renew_motions(setting, correction, poses);
        renew_blocks(setting, rules.block);
        if (!problem.exact) state_.map = draw_map(random, poses, sightings_, problem.marks, problem.oriented);
        move_low_rank(random, problem, directions, rules, sweep);
        // after the low-rank moves, which integrate the precisions out
        if (problem.degrees > 0) renew_precisions(random, problem);
        samples.trajectories.push_back(poses);
        samples.maps.push_back(state_.map);
    }
    accepted = static_cast<double>(kept_) / static_cast<double>(tried_);
    return samples;
}

void Chain::weigh_sightings(const Problem& problem) {
    precision_.resize(problem.sightings.size(), 1.0);
    sightings_ = problem.sightings;
    for (std::size_t k = 0; k < sightings_.size(); ++k) {
        Sighting& s = sightings_[k];
        const double variance = 1.0 / precision_[k];
        s.seen.S = variance * s.seen.S;
        s.q = {variance * s.q.x, variance * s.q.y, variance * s.q.t};
    }
}

/// Renew all poses in blocks of `block` steps, the first one of a random length.
void Chain::renew_blocks(const Setting& given, Number block) {
    const Problem& problem = given.problem;
    const Number T = problem.steps();
    Number begin = 1;
    Number end = std::min(1 + static_cast<Number>(given.random.uniform() * static_cast<double>(block)), T);
    while (begin <= T) {
        const Trajectory old(poses.begin() + begin, poses.begin() + end + 1);
        renew_block(given, !problem.exact, begin, end, poses);
        ++tried_;
        if (!problem.exact || state_.accepts(given.random, poses, sightings_, problem.oriented))
            ++kept_;
        else
            std::copy(old.begin(), old.end(), poses.begin() + begin);
        begin = end + 1;
        end = std::min(end + block, T);
    }
}

void Chain::move_low_rank(Random& random, const Problem& problem, const Directions& directions, const ChainRules& rules,
                          Number sweep) {
    if (rules.moves == 0) return;
    const int accepted_moves = move_along(random, problem, directions, step_, rules.moves, poses, state_.map);
    if (!rules.warm_up) return;
    // Robbins and Monro: log b rises by (share - aim) / sqrt(sweep)
    const double share = static_cast<double>(accepted_moves) / rules.moves;
    step_ = std::min(step_ * exponential((share - aim) / std::sqrt(1.0 + static_cast<double>(sweep))), 1.0);
}

/// precision_k ~ Gamma((nu + n) / 2, 2 / (nu + e' C^-1 e)).
void Chain::renew_precisions(Random& random, const Problem& problem) {
    std::vector<double> squares(problem.sightings.size());
    cost(problem, poses, state_.map, problem.exact, squares);
    const double shape = 0.5 * (problem.degrees + problem.coordinates());
    for (std::size_t k = 0; k < squares.size(); ++k) precision_[k] = 2 / (problem.degrees + squares[k]) * random.gamma(shape);
    weigh_sightings(problem);
}

}  // namespace vmslam::gibbs
