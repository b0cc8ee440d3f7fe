#include "vmslam/solve/objective.hpp"

#include <algorithm>
#include <cmath>

namespace vmslam::solve {

namespace {

std::vector<char> marked(std::size_t count, std::span<const Index> places) {
    std::vector<char> marks(count, 0);
    for (const Index place : places) marks[place] = 1;
    return marks;
}

}  // namespace

OwnedSystem::OwnedSystem(sparse::OwnedPattern pattern, int threads, std::span<const Index> points)
    : pattern_(std::move(pattern)),
      values_(9 * pattern_.rows.size()),
      xi_(3 * (pattern_.start.size() - 1)),
      factor_(analyze(pattern_, sparse::shape_of<sparse::Real3>, threads, marked(pattern_.start.size() - 1, points))) {}

double GraphObjective::linearize(std::span<const double> state, std::span<const double> reference) {
    std::fill_n(system_.values, values().size(), 0.0);
    std::fill_n(system_.xi, xi().size(), 0.0);
    double total = 0.0;
    for (const Member& m : families_) total += m.family->accumulate({state.data(), reference.data()}, &system_, m.pairs);
    for (const Index node : held_.without_heading) system_.diagonal(node)[8] = 1.0;
    for (const Index block : held_blocks_) std::fill_n(system_.block(block), 9, 0.0);
    for (const Index node : held_.nodes) {
        std::fill_n(system_.xi + 3 * node, 3, 0.0);
        for (int c = 0; c < 3; ++c) system_.diagonal(node)[4 * c] = 1.0;
    }
    return total + constant_;
}

double GraphObjective::cost(std::span<const double> state, std::span<const double> reference) {
    double total = 0.0;
    for (const Member& m : families_) total += m.family->accumulate({state.data(), reference.data()}, nullptr, m.pairs);
    return total + constant_;
}

bool GraphObjective::factorize(double damping) { return factor_.factorize(values(), damping) < 0; }

bool GraphObjective::solve(std::span<double> delta) { return factor_.solve(xi(), delta); }

std::vector<double> GraphObjective::diagonal() {
    std::vector<double> out(3 * nodes());
    for (std::size_t i = 0; i < out.size(); ++i) out[i] = std::abs(system_.diagonal(static_cast<Index>(i / 3))[4 * (i % 3)]);
    return out;
}

bool GraphObjective::curves() const {
    return !state_dependent && std::ranges::all_of(families_, [](const Member& m) { return m.family->curves(); });
}

}  // namespace vmslam::solve
