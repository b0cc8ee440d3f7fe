#include "vmslam/solve/objective.hpp"

#include <algorithm>

namespace vmslam::solve {

void hold(const edges::System& system, std::span<const Index> blocks, std::span<const Index> nodes) {
    for (const Index block : blocks) std::fill_n(system.block(block), 9, 0.0);
    for (const Index node : nodes) {
        std::fill_n(system.xi + 3 * node, 3, 0.0);
        for (int c = 0; c < 3; ++c) system.diagonal(node)[4 * c] = 1.0;
    }
}

void rest(const edges::System& system, std::span<const Index> nodes, int coordinate) {
    for (const Index node : nodes)
        for (int c = coordinate; c < 3; ++c) system.diagonal(node)[4 * c] = 1.0;
}

double GraphObjective::linearize(std::span<const double> state, std::span<const double> reference) {
    std::fill_n(system_.values, values().size(), 0.0);
    std::fill_n(system_.xi, xi().size(), 0.0);
    double total = 0.0;
    for (const Member& m : families_) total += m.family->accumulate({state.data(), reference.data()}, &system_, m.pairs);
    rest(system_, held_.without_heading, 2);
    hold(system_, held_.blocks, held_.nodes);
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
    for (std::size_t i = 0; i < out.size(); ++i) out[i] = system_.diagonal(static_cast<Index>(i / 3))[4 * (i % 3)];
    return out;
}

}  // namespace vmslam::solve
