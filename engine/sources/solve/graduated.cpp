#include "vmslam/solve/graduated.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "require.hpp"

namespace vmslam::solve {

double truncated_trust(double square, double mu) {
    if (!std::isfinite(mu)) return square <= 1 ? 1.0 : 0.0;
    if (square <= mu / (mu + 1)) return 1.0;
    if (square >= (mu + 1) / mu) return 0.0;
    return std::clamp(std::sqrt(mu * (mu + 1) / square) - mu, 0.0, 1.0);
}

template <class Use>
void Graduation::for_each(Use use) const {
    std::vector<double> factors = trust;
    for (double& factor : factors) factor = std::max(factor, least_trust);
    std::size_t start = 0;
    for (const Doubted& each : doubted_) {
        use(each, std::span(factors).subspan(start, each.measurements));
        start += each.measurements;
    }
}

void Graduation::graduate(int most_rounds) {
    const std::vector<double> plain = squares();
    const double largest = plain.empty() ? 0.0 : *std::max_element(plain.begin(), plain.end());
    settled = largest <= 1;
    double mu = 2 * largest > 1 ? 1 / (2 * largest - 1) : std::numeric_limits<double>::infinity();
    for (; rounds < most_rounds && !settled; mu *= growth) {
        ++rounds;
        judge(mu);
        settled = std::all_of(trust.begin(), trust.end(), [](double w) { return w == 0 || w == 1; });
        if (!descend()) return;
    }
}

void Graduation::settle() {
    std::vector<double> before;
    for (int k = 0; k < last_rounds && trust != before; ++k) {
        ++rounds;
        if (!descend()) return;
        before = trust;
        judge(std::numeric_limits<double>::infinity());
    }
}

void Graduation::judge(double mu) {
    const std::vector<double> at = squares();
    std::transform(at.begin(), at.end(), trust.begin(), [mu](double square) { return truncated_trust(square, mu); });
}

bool Graduation::descend() {
    std::vector<GraphObjective::Member> members = graph_.families();
    std::vector<std::unique_ptr<const edges::Family>> trusting;
    for_each([&](const Doubted& each, std::span<const double> factors) {
        trusting.push_back(members[each.member].family->trusting(factors));
        require(trusting.back() != nullptr, "a family whose measurements may be wrong has no trust in them");
        members[each.member].family = trusting.back().get();
    });
    GraphObjective graph = graph_.with(std::move(members));
    Run run{steps_, state};
    levenberg_marquardt(graph, run, steps_.most_steps);
    if (run.end == End::not_determined) stuck = run.damping;
    if (std::all_of(run.state.begin(), run.state.end(), [](double x) { return std::isfinite(x); })) state = run.state;
    return !stuck;
}

std::vector<double> Graduation::squares() const {
    std::vector<double> out;
    for_each([&](const Doubted& each, std::span<const double> factors) {
        for (const double square : each.measured->squares(state.data(), factors)) out.push_back(square / each.limit);
    });
    return out;
}

double Graduation::truncated() const {
    double total = 0.0;
    for_each([&](const Doubted& each, std::span<const double> factors) {
        for (const double square : each.measured->squares(state.data(), factors)) total += std::min(square, each.limit);
    });
    return total;
}

}  // namespace vmslam::solve
