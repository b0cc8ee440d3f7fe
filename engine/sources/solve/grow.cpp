#include "vmslam/solve/grow.hpp"

#include <algorithm>
#include <cmath>

#include "vmslam/edges/arithmetic.hpp"
#include "vmslam/solve/run.hpp"

namespace vmslam::solve {
namespace {

/// Beyond this number of poses, more are added at a time in proportion, so that the time grows little faster than them.
constexpr Index many = 300;
/// The most steps of Gauss-Newton after each addition, and the step norm for each pose [m, rad] that ends them.
constexpr int steps_each = 4;
constexpr double rough = 1e-3;

/// The new numbers of the nodes that have one.
std::vector<Index> renumbered(std::span<const Index> nodes, std::span<const Index> number) {
    std::vector<Index> out;
    for (const Index node : nodes)
        if (number[node] >= 0) out.push_back(number[node]);
    return out;
}

/// Put a node where its parent sees it.
void place(std::vector<double>& state, const Growth& growth, Index node) {
    const double *const parent = state.data() + 3 * growth.parents[node], *const d = growth.offsets.data() + 3 * node;
    const edges::Rotation axes(parent[2]);
    state[3 * node] = parent[0] + axes.c * d[0] - axes.s * d[1];
    state[3 * node + 1] = parent[1] + axes.s * d[0] + axes.c * d[1];
    state[3 * node + 2] = edges::wrap(parent[2] + d[2]);
}

/// Place the poses from `first` on, and then the landmarks that these are the parents of.
void place_from(std::vector<double>& state, const Growth& growth, Index first, Index end) {
    for (Index pose = std::max(first, Index{1}); pose < end; ++pose) place(state, growth, pose);
    for (auto k = static_cast<std::size_t>(growth.poses); k < growth.parents.size(); ++k)
        if (growth.parents[k] >= first && growth.parents[k] < end) place(state, growth, static_cast<Index>(k));
}

/// A few steps on the graph of the nodes that `used` marks. Where these do not determine each other, nothing moves: more poses
/// may do so later. Returns false where a family cannot be divided.
bool correct(const GraphObjective& graph, std::span<const char> used, Index poses, std::vector<double>& state) {
    Part part(graph, used);
    if (!part.divided()) return false;
    Run run{{.tolerance = rough * std::sqrt(static_cast<double>(poses)), .most_steps = steps_each}, {}};
    for (const Index node : part.nodes())
        run.state.insert(run.state.end(), state.begin() + 3 * node, state.begin() + 3 * node + 3);
    gauss_newton(part.objective(), run);
    const bool finite = std::all_of(run.state.begin(), run.state.end(), [](double x) { return std::isfinite(x); });
    if (run.end == End::not_determined || !finite) return true;
    for (std::size_t k = 0; k < part.nodes().size(); ++k)
        std::copy_n(run.state.begin() + static_cast<std::ptrdiff_t>(3 * k), 3, state.begin() + 3 * part.nodes()[k]);
    return true;
}

}  // namespace

// The pattern of the part has all blocks between its nodes: those that are tied by a landmark that is no node see it themselves.
Part::Part(const GraphObjective& whole, std::span<const char> used) {
    const edges::System& system = whole.system();
    std::vector<Index> number(used.size(), -1), block(system.rows.size(), -1);
    sparse::OwnedPattern pattern{{0}, {}};
    for (Index j = 0; j < static_cast<Index>(used.size()); ++j) {
        if (!used[j]) continue;
        number[j] = static_cast<Index>(nodes_.size());
        nodes_.push_back(j);
        for (Index k = system.start[j]; k < system.start[j + 1]; ++k) {
            if (number[system.rows[k]] < 0) continue;
            block[k] = static_cast<Index>(pattern.rows.size());
            pattern.rows.push_back(number[system.rows[k]]);
        }
        pattern.start.push_back(static_cast<Index>(pattern.rows.size()));
    }
    std::vector<GraphObjective::Member> members;
    for (const GraphObjective::Member& member : whole.families()) {
        families_.push_back(member.family->among(number));
        if (!families_.back()) return;
        pairs_.push_back(renumbered(member.pairs, block));
        members.push_back({families_.back().get(), pairs_.back()});
    }
    held_nodes_ = renumbered(whole.held().nodes, number);
    points_ = renumbered(whole.held().without_heading, number);
    system_.emplace(std::move(pattern), whole.symbolic().threads, points_);
    objective_.emplace(std::move(members), *system_, Held{held_nodes_, points_});
    objective_->state_dependent = whole.state_dependent;
    objective_->reweighted = whole.reweighted;
}

Index Growth::next(Index count) const { return std::min(count + each * std::max(count, many) / many, poses); }

double Growth::most_steps() const {
    double steps = 0.0;
    for (Index count = 1; count < poses;) {
        count = next(count);
        steps += static_cast<double>(steps_each * count) / static_cast<double>(poses);
    }
    return steps;
}

std::optional<std::vector<double>> grow(const GraphObjective& graph, std::vector<double> state, const Growth& growth) {
    std::vector<char> used(growth.from.size());
    place_from(state, growth, 0, 1);
    for (Index count = 1; count < growth.poses;) {
        const Index before = count;
        count = growth.next(count);
        place_from(state, growth, before, count);
        for (std::size_t k = 0; k < used.size(); ++k) used[k] = growth.from[k] < count;
        if (!correct(graph, used, count, state)) return std::nullopt;
    }
    return state;
}

}  // namespace vmslam::solve
