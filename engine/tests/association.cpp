// Joint hypotheses against all hypotheses of small problems, and views counted by bearings.
#include <algorithm>
#include <cmath>
#include <memory>
#include <numbers>
#include <random>

#include "expect.hpp"
#include "vmslam/association/growth.hpp"
#include "vmslam/association/search.hpp"
#include "vmslam/association/visibility.hpp"

namespace {

using namespace vmslam::association;

/// Random candidates of a few items, whose residuals are correlated.
struct Problem {
    std::size_t d, count;
    std::vector<Number> start{0}, items, landmarks;
    std::vector<double> nu, S, weights;
    std::unique_ptr<bool[]> allowed;

    explicit Problem(unsigned seed) : d(2 + seed % 2) {
        std::mt19937 random(seed);
        std::normal_distribution<> normal;
        for (Number item = 0; item < 4; ++item) {
            for (unsigned k = random() % 4; k > 0; --k) items.push_back(item), landmarks.push_back(random() % 4);
            start.push_back(static_cast<Number>(items.size()));
        }
        count = items.size();
        const std::size_t size = count * d;
        std::vector<double> A(size * (size + 2));
        for (double& value : A) value = 0.5 * normal(random);
        for (std::size_t r = 0; r < size; ++r)
            for (std::size_t c = 0; c < size; ++c) {
                S.push_back(r == c ? 0.1 : 0.0);
                for (std::size_t k = 0; k < size + 2; ++k) S.back() += A[r * (size + 2) + k] * A[c * (size + 2) + k];
            }
        for (std::size_t r = 0; r < size; ++r) nu.push_back(normal(random));
        for (std::size_t c = 0; c < count; ++c) weights.push_back(3.0 + normal(random));
        allowed.reset(new bool[count]);
        std::fill_n(allowed.get(), count, true);
    }

    Pairs pairs() const { return {landmarks, {nu, S, d}, weights, {allowed.get(), count}}; }

    struct Weighed {
        double evidence, squares;
    };

    /// E and nu' S^-1 nu of some pairs, by elimination.
    Weighed weigh(const std::vector<Number>& pairs) const {
        const std::size_t size = pairs.size() * d;
        const auto scalar = [&](std::size_t r) { return pairs[r / d] * d + r % d; };
        std::vector<double> M(size * size), x(size);
        for (std::size_t r = 0; r < size; ++r) {
            x[r] = nu[scalar(r)];
            for (std::size_t c = 0; c < size; ++c) M[r * size + c] = S[scalar(r) * count * d + scalar(c)];
        }
        double evidence = 0.0, squares = 0.0;
        for (const Number c : pairs) evidence += weights[c];
        for (std::size_t p = 0; p < size; ++p) {
            const double pivot = M[p * size + p];
            squares += x[p] * x[p] / pivot;
            evidence -= 0.5 * (x[p] * x[p] / pivot + std::log(2 * std::numbers::pi * pivot));
            for (std::size_t r = p + 1; r < size; ++r) {
                const double f = M[r * size + p] / pivot;
                for (std::size_t c = p; c < size; ++c) M[r * size + c] -= f * M[p * size + c];
                x[r] -= f * x[p];
            }
        }
        return {evidence, squares};
    }
};

/// The most evidence of all hypotheses that extend one within the gate.
double most_of_all(const Problem& problem, double gate, std::vector<Number>& pairs, Number item) {
    const Problem::Weighed weighed = problem.weigh(pairs);
    if (weighed.squares > gate) return 0.0;
    double most = weighed.evidence;
    for (; item < 4; ++item)
        for (Number c = problem.start[item]; c < problem.start[item + 1]; ++c) {
            const auto same = [&](Number other) { return problem.landmarks[other] == problem.landmarks[c]; };
            if (std::any_of(pairs.begin(), pairs.end(), same)) continue;
            pairs.push_back(c);
            most = std::max(most, most_of_all(problem, gate, pairs, item + 1));
            pairs.pop_back();
        }
    return most;
}

void the_search_finds_the_best(unsigned seed) {
    const Problem problem(seed);
    const double gate = 9.0;
    const std::vector<double> bounds(problem.count, 100.0), gates(5, gate);
    const BestHypothesis best = best_hypothesis(problem.pairs(), problem.start, bounds, gates, 100'000);
    std::vector<Number> chosen, none;
    std::copy_if(best.chosen.begin(), best.chosen.end(), std::back_inserter(chosen), [](Number c) { return c >= 0; });
    expect(std::abs(best.evidence - most_of_all(problem, gate, none, 0)) < 1e-9, "no hypothesis has more evidence", seed);
    expect(std::abs(best.evidence - problem.weigh(chosen).evidence) < 1e-9, "its evidence is that of its pairs", seed);
}

void growth_adds_up(unsigned seed) {
    const Problem problem(seed);
    for (Number seed_pair = 0; seed_pair < Number(problem.count); ++seed_pair) {
        const Number begin[] = {seed_pair, -1};
        const Grown grown = grown_from(begin, problem.pairs(), problem.items, {1e300, 20.0, true});
        std::vector<Number> members;
        for (std::size_t c = 0; c < problem.count; ++c)
            if (grown.members[c]) members.push_back(c);
        expect(grown.members[seed_pair], "the first pair stays", seed);
        expect(std::abs(grown.evidence - problem.weigh(members).evidence) < 1e-9, "steps add up to the joint evidence", seed);
        for (const Number a : members)
            for (const Number b : members)
                expect(a == b || (problem.items[a] != problem.items[b] && problem.landmarks[a] != problem.landmarks[b]),
                       "no item and no landmark is used twice", seed);
        for (const Number second : grown.second) {
            if (second < 0) continue;
            expect(problem.items[second] != problem.items[seed_pair], "second pairs can follow the first", seed);
        }
    }
    const std::vector<Number> often(problem.count + 1, 0);
    expect(problem.count == 0 || grown_from(often, problem.pairs(), problem.items, {1e300, 20.0, true}).members[0],
           "a pair that is given more than once", seed);
    const Grown nothing = grown_from({}, problem.pairs(), problem.items, {1e300, 20.0, false});
    expect(nothing.evidence == 0.0 && nothing.second[0] == -1, "no pairs have no evidence", seed);
}

void views_are_those_of_range_and_bearing(unsigned seed) {
    std::mt19937 random(seed);
    std::uniform_real_distribution<> uniform(-1.0, 1.0);
    std::vector<double> poses, marks;
    for (int k = 0; k < 60; ++k) poses.push_back(3 * uniform(random)), marks.push_back(5 * uniform(random));
    const vmslam::edges::Lever sensor{0.4, -0.2};
    const double bearings[] = {0.9, 2.5};
    const std::vector<FieldLimit> limits{{1.0, 4.0, std::cos(bearings[0])}, {0.5, 5.0, std::cos(bearings[1])}};
    const std::vector<std::int64_t> counts = count_views(poses, marks, 3, sensor, limits);
    for (std::size_t k = 0; k < limits.size(); ++k)
        for (std::size_t j = 0; j < 20; ++j) {
            std::int64_t expected = 0;
            for (std::size_t t = 0; t < 20; ++t) {
                const double *const x = &poses[3 * t], *const m = &marks[3 * j], c = std::cos(x[2]), s = std::sin(x[2]);
                const double dx = m[0] - x[0] - c * sensor.x + s * sensor.y, dy = m[1] - x[1] - s * sensor.x - c * sensor.y;
                const double range = std::hypot(dx, dy),
                             bearing = std::remainder(std::atan2(dy, dx) - x[2], 2 * std::numbers::pi);
                expected += range >= limits[k].nearest && range <= limits[k].farthest && std::abs(bearing) <= bearings[k];
            }
            expect(counts[k * 20 + j] == expected, "views within range and bearing", seed);
        }
}

}  // namespace

void test_association() {
    for (unsigned seed = 0; seed < 100; ++seed) {
        the_search_finds_the_best(seed);
        growth_adds_up(seed);
        views_are_those_of_range_and_bearing(seed);
    }
}
