#include "vmslam/solve/restarts.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <set>
#include <tuple>

#include "vmslam/edges/arithmetic.hpp"
#include "vmslam/numbers/random.hpp"
#include "vmslam/solve/run.hpp"

namespace vmslam::solve {
namespace {

using State = std::vector<double>;
constexpr double pi = std::numbers::pi;

/// A turn is tried where it raises the cost of the motion edges by at most this: a factor of exp(-5) in likelihood.
constexpr double most_rise = 10.0;
/// The shortest and the longest stretches [motions] of each group; stretches of one group do not overlap.
constexpr std::size_t lengths[][2] = {{2, 8}, {9, 32}, {33, 100}};
/// The most turns to try, at most one for so many poses.
constexpr std::size_t most_turns = 40, poses_per_turn = 4;
/// A turn is kept if it lowers J by more than this part of it.
constexpr double lower = 1e-6;
/// The most steps after a turn. They end where J changes by less than this part of it, and go on where it is the lowest one.
constexpr int steps_after = 30;
constexpr double settled = 3e-3;
/// The same after steps without a half of the measurements, which end nearer to the minimum that they come from.
constexpr double settled_after_half = 1e-5;
/// So many halves one after the other that lead no lower end the search.
constexpr int most_halves = 25;
/// The most steps without a half, and the part of their information that keeps what it measures determined.
constexpr int steps_without = 15;
constexpr double left_out = 1e-6;

/// E and V from the first pose to each pose, and how many motions up to it are unknown.
struct Deviations {
    std::vector<double> E, V;
    std::vector<std::size_t> unknown;

    Deviations(std::span<const double> state, const Odometry& odometry)
        : E(odometry.poses()), V(odometry.poses()), unknown(odometry.poses()) {
        for (std::size_t t = 1; t < E.size(); ++t) {
            const bool known = std::isfinite(odometry.variances[t]);
            const double turn = state[3 * t + 2] - state[3 * t - 1];
            E[t] = E[t - 1] + (known ? edges::wrap(turn - odometry.motions[3 * t + 2]) : 0.0);
            V[t] = V[t - 1] + (known ? odometry.variances[t] : 0.0);
            unknown[t] = unknown[t - 1] + !known;
        }
    }

    /// The stretches with the least rises that do not overlap, of those with a number of motions between two.
    std::vector<Stretch> among(std::size_t shortest, std::size_t longest) const {
        std::vector<Stretch> found, out;
        for (std::size_t length = shortest; length <= longest; ++length)
            for (std::size_t a = 0, b = length; b < E.size(); ++a, ++b) {
                if (unknown[b] != unknown[a]) continue;
                const double rise = 4 * pi * (pi - std::abs(E[b] - E[a])) / std::max(V[b] - V[a], 1e-300);
                if (rise < most_rise) found.push_back({rise, a, b, E[b] > E[a]});
            }
        sort(found);
        std::vector<char> taken(E.size());
        for (const Stretch& each : found) {
            const auto begin = taken.begin() + static_cast<std::ptrdiff_t>(each.first);
            const auto end = taken.begin() + static_cast<std::ptrdiff_t>(each.last);
            if (std::find(begin, end, 1) != end) continue;
            std::fill(begin, end, 1);
            out.push_back(each);
        }
        return out;
    }

    static void sort(std::vector<Stretch>& stretches) {
        std::ranges::sort(stretches, {}, [](const Stretch& each) { return std::tie(each.rise, each.first, each.last); });
    }
};

/// A search for lower states: the lowest one so far, its J, and what is found.
struct Descent {
    Objective& objective;
    State best;
    double cost = objective.cost(best, best);
    Lowered out{};

    /// Whether steps from a changed state lead below the lowest one, whose place their end takes then. Where J is lower once it
    /// changes by less than the part `settled`, they go on to the minimum.
    bool lowers(State state, double settled) {
        const std::size_t nodes = state.size() / 3;
        const double tolerance = 1e-6 * std::sqrt(static_cast<double>(nodes));
        double reached = cost;
        for (const double part : {settled, 0.0}) {
            Run run{{.tolerance = tolerance, .most_steps = steps_after, .cost_tolerance = part}, std::move(state)};
            gauss_newton(objective, run);
            out.steps += run.steps();
            if (run.end == End::not_determined) return false;
            reached = objective.cost(run.state, run.state);
            if (!(reached < cost)) return false;
            state = std::move(run.state);
        }
        if (!(reached < cost * (1 - lower))) return false;
        out.state = best = std::move(state);
        cost = reached;
        return true;
    }

    /// Try other turns, one after the other; whether any leads lower.
    bool turn(const Odometry& odometry, double limit) {
        const std::size_t most = std::min(most_turns, odometry.poses() / poses_per_turn);
        std::set<std::tuple<std::size_t, std::size_t, bool>> tried;
        bool found = false;
        for (bool again = true; again; found |= again) {
            again = false;
            for (const Stretch& stretch : stretches(best, odometry)) {
                if (again || tried.size() >= most || out.steps >= limit) break;
                if (!tried.emplace(stretch.first, stretch.last, stretch.left).second) continue;
                again = lowers(other_turn(best, odometry, stretch), settled);
            }
        }
        return found;
    }
};

/// The end of some steps without a random half of the measurements of some families; where these fail, the state itself.
State without_half(const GraphObjective& graph, std::span<const std::size_t> doubted, const State& state, std::uint64_t key,
                   int& steps) {
    std::vector<GraphObjective::Member> members = graph.families();
    std::vector<std::unique_ptr<const edges::Family>> halves;
    for (std::uint64_t index = 0; const std::size_t m : doubted) {
        std::vector<double> trust(members[m].family->measurements());
        for (double& w : trust) w = numbers::uniform(key, index++) < 0.5 ? left_out : 1.0;
        halves.push_back(members[m].family->trusting(trust));
        if (halves.back()) members[m].family = halves.back().get();
    }
    GraphObjective half = graph.with(std::move(members));
    const std::size_t nodes = state.size() / 3;
    Run run{{.tolerance = 1e-3 * std::sqrt(static_cast<double>(nodes)), .most_steps = steps_without}, state};
    gauss_newton(half, run);
    steps += run.steps();
    const bool good =
        run.end != End::not_determined && std::ranges::all_of(run.state, [](double x) { return std::isfinite(x); });
    return good ? run.state : state;
}

}  // namespace

std::vector<Stretch> stretches(std::span<const double> state, const Odometry& odometry) {
    const Deviations deviations(state, odometry);
    std::vector<Stretch> all;
    for (const auto& [shortest, longest] : lengths) {
        const std::vector<Stretch> some = deviations.among(shortest, longest);
        all.insert(all.end(), some.begin(), some.end());
    }
    Deviations::sort(all);
    return all;
}

std::vector<double> other_turn(std::vector<double> state, const Odometry& odometry, const Stretch& stretch) {
    const auto [rise, first, last, left] = stretch;
    double variance = 0.0;
    for (std::size_t t = first + 1; t <= last; ++t) variance += odometry.variances[t];
    const double end[] = {state[3 * last], state[3 * last + 1]};
    double share = 0.0, heading = state[3 * first + 2], before = heading, turned = heading;
    for (std::size_t t = first + 1; t <= last; ++t) {
        const double* const motion = odometry.motions.data() + 3 * t;
        double* const pose = state.data() + 3 * t;
        const edges::Rotation axes(turned);
        // what the pose of the end adds to the odometry stays
        heading += motion[2] + edges::wrap(pose[2] - before - motion[2]);
        before = pose[2];
        share += odometry.variances[t] / variance;
        turned = heading - (left ? 2 : -2) * pi * share;
        pose[0] = pose[-3] + axes.c * motion[0] - axes.s * motion[1];
        pose[1] = pose[-2] + axes.s * motion[0] + axes.c * motion[1];
        pose[2] = t < last ? turned : before;
    }
    const double missing[] = {end[0] - state[3 * last], end[1] - state[3 * last + 1]};
    for (std::size_t t = first + 1; t < last; ++t)
        for (const int c : {0, 1})
            state[3 * t + c] += static_cast<double>(t - first) / static_cast<double>(last - first) * missing[c];
    std::copy_n(end, 2, state.begin() + static_cast<std::ptrdiff_t>(3 * last));
    return state;
}

Lowered lowered_by_turns(Objective& objective, std::span<const double> state, const Odometry& odometry, double limit) {
    Descent search{objective, {state.begin(), state.end()}};
    search.turn(odometry, limit);
    return search.out;
}

Lowered lowered_by_halves(GraphObjective& graph, std::span<const std::size_t> doubted, std::span<const double> state,
                          const Odometry& odometry, double limit) {
    if (doubted.empty()) return {};
    Descent search{graph, {state.begin(), state.end()}};
    std::uint64_t key = 0;
    do
        for (int failed = 0; failed < most_halves && search.out.steps < limit; ++failed)
            if (search.lowers(without_half(graph, doubted, search.best, key++, search.out.steps), settled_after_half))
                failed = -1;
    while (search.out.state && search.turn(odometry, limit));
    return search.out;
}

}  // namespace vmslam::solve
