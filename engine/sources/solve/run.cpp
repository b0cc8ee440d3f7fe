#include "vmslam/solve/run.hpp"

#include <algorithm>
#include <array>
#include <cmath>

namespace vmslam::solve {

const char* describe(End end) {
    switch (end) {
        case End::most_steps: return "it has taken all its steps";
        case End::diverged: return "J is infinite or not a number";
        case End::cost_settled: return "the last step changed J by less than the tolerance";
        case End::short_step: return "the last step was shorter than the tolerance, and promised little";
        case End::small_decrease: return "the last step lowered J by less than the tolerance";
        case End::rounding_floor: return "the steps are no longer than rounding makes them";
        case End::no_lower_cost: return "no step lowers J, however short";
        case End::singular: return "damped steps lead to a state where the edges do not determine all nodes";
        case End::not_determined: return "the edges do not determine all nodes: some can move without a change of J";
    }
    return "";
}

double inner(std::span<const double> a, std::span<const double> b) {
    // four sums, because each addition waits for the one before it
    std::array<double, 4> totals{};
    std::size_t k = 0;
    for (; k + 4 <= a.size(); k += 4)
        for (std::size_t i = 0; i < 4; ++i) totals[i] += a[k + i] * b[k + i];
    for (; k < a.size(); ++k) totals[0] += a[k] * b[k];
    return (totals[0] + totals[1]) + (totals[2] + totals[3]);
}

double rounding(std::span<const double> state, std::span<const double> diagonal) {
    std::array<double, 3> largest{}, sums{};
    for (std::size_t k = 0; k < state.size(); ++k) {
        const double size = std::abs(state[k]);
        if (!(size <= largest[k % 3])) largest[k % 3] = size;
        sums[k % 3] += diagonal[k];
    }
    double total = 0.0;
    for (int c = 0; c < 3; ++c) {
        const double error = 1e-15 * (1 + largest[c]);
        total += sums[c] * (error * error);
    }
    return total;
}

void Run::step(double cost, std::span<const double> delta) {
    if (anderson)
        state = anderson->next(state, delta);
    else
        for (std::size_t k = 0; k < state.size(); ++k) state[k] += delta[k];
    costs.push_back(cost);
    norms.push_back(std::sqrt(inner(delta, delta)));
    if (observer) observer(*this);
}

bool Run::diverged(double cost) {
    if (std::isfinite(cost)) return false;
    end = End::diverged;
    cost_at_end = cost;
    return true;
}

// The predicted decrease must be small, too: a step from one side of a valley to the other also leaves J unchanged.
bool Run::settled(double cost) {
    const double enough = costs.empty() ? 0.0 : rules.cost_tolerance * costs.back();
    if (std::abs(predicted) <= confirmed * enough && std::abs(costs.back() - cost) <= enough && enough != 0)
        converge(End::cost_settled);
    return converged;
}

// A short step alone proves nothing where J is steep: it must also promise little, compared with J or with what rounding of
// the state (about 1e-15 of each coordinate) does to J.
//
// On badly scaled graphs rounding keeps the steps from becoming shorter than some 1e-7 (INTEL). Therefore a step that no
// longer shrinks is also the last one, if its predicted decrease is below the rounding error of J, or what rounding of the state
// does to J: of coordinates in UTM, which are millions of metres, and precise edges that is more. Mixed steps may grow for a while
// and shrink again, so ten of them are compared.
bool Run::finished(double decrease, Objective& objective) {
    predicted = decrease;
    const double norm = norms.back(), small = rules.cost_tolerance * costs.back();
    const std::size_t window = mixed() ? 10 : 1;
    if (norm < rules.tolerance && negligible(decrease, objective)) return converge(End::short_step);
    if (std::abs(decrease) <= small && small != 0) return converge(End::small_decrease);
    if (norms.size() > window && norm > 0.5 * *std::min_element(norms.end() - 1 - window, norms.end() - 1) &&
        (std::abs(decrease) < 1e-15 * costs.back() || std::abs(decrease) < rounding(state, objective.diagonal())))
        return converge(End::rounding_floor);
    return converged;
}

bool Run::negligible(double decrease, Objective& objective) const {
    const double part = std::max({promise, rules.tolerance, rules.cost_tolerance});
    return std::abs(decrease) <= part * costs.back() || std::abs(decrease) <= rounding(state, objective.diagonal());
}

bool Run::converge(End reason) {
    end = reason;
    return converged = true;
}

}  // namespace vmslam::solve
