#include "vmslam/gibbs/backward.hpp"

#include <algorithm>

#include "require.hpp"

namespace vmslam::gibbs {

BackwardSampler::BackwardSampler(particles::Record record, Problem problem, Number candidates)
    : record_(std::move(record)),
      problem_(std::move(problem)),
      count_(record_.steps()[0].parents.size()),
      candidates_(std::min(candidates, count_)) {
    require(record_.steps().size() == problem_.steps() + 1, "the record must have as many steps as the problem");
    require(candidates > 0, "at least one particle must be considered");
    compute_maps();
    for (Number t = 0; t <= problem_.steps(); ++t) {
        double sum = 0.0;
        for (const double w : log_weights(t)) cumulative_.push_back(sum += exponential(w));
    }
}

/// The landmarks of all particles after each step: one array for each step at which a landmark was seen.
void BackwardSampler::compute_maps() {
    const Number J = problem_.marks, N = count_, steps = record_.steps().size();
    last_event_.assign(steps * J, -1);
    slots_.resize(steps * J * N);
    for (Number t = 0; t < steps; ++t) {
        for (Number j = 0; t > 0 && j < J; ++j) {
            last_event_[t * J + j] = last_event_[(t - 1) * J + j];
            if (last_event_[t * J + j] < 0) continue;
            const std::int32_t* const before = slots_.data() + ((t - 1) * J + j) * N;
            for (Number i = 0; i < N; ++i) slots_[(t * J + j) * N + i] = before[parent(t, i)];
        }
        observe(t);
    }
}

/// Let the particles absorb the sightings of a step.
void BackwardSampler::observe(Number t) {
    const Number J = problem_.marks, N = count_;
    const auto sightings = seen_at(problem_, problem_.sightings, t, t);
    for (const Sighting& s : sightings) {
        std::int32_t& event = last_event_[t * J + s.mark];
        std::int32_t* const slots = slots_.data() + (t * J + s.mark) * N;
        const auto first = std::find_if(sightings.begin(), sightings.end(), [&](const auto& o) { return o.mark == s.mark; });
        // the first sighting of the landmark at this step begins an event
        if (&*first == &s) {
            std::vector<Gaussian> marks(N);
            if (event >= 0)
                for (Number i = 0; i < N; ++i) marks[i] = events_[event][slots[i]];
            for (Number i = 0; i < N; ++i) slots[i] = static_cast<std::int32_t>(i);
            event = static_cast<std::int32_t>(events_.size());
            events_.push_back(std::move(marks));
        }
        for (Number i = 0; i < N; ++i) fuse(events_[event][i], composed(Frame(pose(t, i)), s.seen), problem_.oriented);
    }
}

std::pair<Trajectory, Map> BackwardSampler::draw(Random& random) const {
    const Number J = problem_.marks, N = count_, T = problem_.steps();
    std::vector<Gaussian> after(J);
    Trajectory motions(T + 1), path(T + 1);
    std::vector<Shared> shared;
    Number chosen = random.choose(log_weights(T));
    for (Number t = T + 1; t-- > 0;) {
        if (t < T) {
            const Number ancestor = parent(t + 1, chosen);
            motions[t + 1] = relative(Frame(pose(t, ancestor)), pose(t + 1, chosen));
            const Frame d(motions[t + 1]);
            shared.clear();
            for (Number j = 0; j < J; ++j) {
                if (!after[j].seen()) continue;
                after[j] = composed(d, after[j]);
                const std::int32_t event = last_event_[t * J + j];
                if (event >= 0) shared.push_back({&events_[event], slots_.data() + (t * J + j) * N, &after[j]});
            }
            chosen = attach(random, t, ancestor, shared);
        }
        for (const Sighting& s : seen_at(problem_, problem_.sightings, t, t)) fuse(after[s.mark], s.seen, problem_.oriented);
    }
    path[0] = pose(0, chosen);
    for (Number t = 1; t <= T; ++t) path[t] = composed(Frame(path[t - 1]), motions[t]);
    Map map = draw_map(random, path, problem_.sightings, problem_.marks, problem_.oriented);
    return {std::move(path), std::move(map)};
}

/// The particle of step t to which the rest of the trajectory is attached.
Number BackwardSampler::attach(Random& random, Number t, Number ancestor, std::span<const Shared> shared) const {
    const Number N = count_;
    const auto sums = std::span(cumulative_).subspan(t * N, N);
    std::vector<Number> candidates(candidates_);
    std::vector<double> log_weights(candidates_, 0.0);
    for (Number c = 0; c < candidates_; ++c) {
        if (candidates_ == N) {
            candidates[c] = c;
            log_weights[c] = this->log_weights(t)[c];
        } else if (c == 0) {
            candidates[c] = ancestor;
        } else {
            const double level = random.uniform() * sums.back();
            const auto at = std::upper_bound(sums.begin(), sums.end(), level) - sums.begin();
            candidates[c] = std::min(static_cast<Number>(at), N - 1);
        }
    }
    add_log_likelihoods(t, candidates, shared, log_weights);
    return candidates[random.choose(log_weights)];
}

/// Add the sum of log N(mean_after; q(x_i, mean_i), S_after + S_i), in world axes, for some particles i. The particles of one
/// landmark follow each other, because they are near each other in memory.
void BackwardSampler::add_log_likelihoods(Number t, std::span<const Number> particles, std::span<const Shared> shared,
                                          std::span<double> log_weights) const {
    std::vector<Frame> poses;
    for (const Number i : particles) poses.emplace_back(pose(t, i));
    std::vector<LogDensities> densities(particles.size());
    for (const auto& [marks, slots, after] : shared)
        for (std::size_t c = 0; c < particles.size(); ++c)
            densities[c].add((*marks)[slots[particles[c]]], composed(poses[c], *after), problem_.oriented);
    for (std::size_t c = 0; c < particles.size(); ++c) log_weights[c] += densities[c].sum();
}

}  // namespace vmslam::gibbs
