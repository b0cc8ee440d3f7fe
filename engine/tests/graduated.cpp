// Graduated non-convexity: its trust, and the mean of places of which some are wrong.
#include "vmslam/solve/graduated.hpp"

#include <cmath>

#include "expect.hpp"
#include "vmslam/edges/relative.hpp"

namespace {

using namespace vmslam;
constexpr double all_or_nothing = std::numeric_limits<double>::infinity();

void test_trust() {
    using solve::truncated_trust;
    // trust falls as 1 / r, so that no measurement pulls harder the farther it is
    for (const double square : {0.1, 0.5, 1.0, 40.0}) {
        const double pull = truncated_trust(square, 1e-4) * std::sqrt(square);
        expect(std::abs(pull - std::sqrt(1e-4 * 1.0001)) < 1e-3, "the pull does not depend on the distance", 0);
    }
    expect(truncated_trust(1.0, all_or_nothing) == 1 && truncated_trust(1.001, all_or_nothing) == 0, "all or nothing", 0);
    expect(truncated_trust(0.5, 1.0) == 1 && truncated_trust(2.0, 1.0) == 0, "the ends of the part between", 0);
    expect(std::abs(truncated_trust(1.0, 1.0) - (std::sqrt(2.0) - 1)) < 1e-15, "between", 0);
}

/// Places of one pose with the information omega on x, and the rounds of its graph with c² = 9.
void with_places(const std::vector<double>& x, double omega, auto use) {
    std::vector<edges::Position> places;
    for (const double each : x) places.push_back({0, {each, 2.0, 0.5}, {omega, 0.0, 100.0, 0.0, 0.0, 100.0}});
    const edges::PositionEdges family(std::move(places));
    solve::OwnedSystem system({{0, 1}, {0}});
    const solve::GraphObjective graph({{&family, {}}}, system);
    use(solve::Graduation(graph, {{0, x.size(), 9.0, &family}}, {.tolerance = 1e-9, .most_steps = 30}, {0.0, 0.0, 0.0},
                          std::vector<double>(x.size(), 1.0)));
}

}  // namespace

void test_graduated() {
    test_trust();
    // deviations of 0.1, two places far away: the minimum is the mean of the others
    const std::vector<double> x{1.0, 1.1, 0.9, 1.05, 0.95, 6.0, -20.0};
    with_places(x, 100.0, [&](solve::Graduation rounds) {
        rounds.graduate(100);
        expect(rounds.settled && rounds.rounds > 1 && !rounds.stuck, "the rounds settle", 0);
        expect(rounds.trust == std::vector<double>{1, 1, 1, 1, 1, 0, 0}, "the wrong places are rejected", 0);
        // the rejected ones keep a billionth of their weight
        expect(std::abs(rounds.state[0] - 1.0) < 1e-7 && std::abs(rounds.state[1] - 2.0) < 1e-9, "the mean", 0);
        expect(std::abs(rounds.truncated() - (100 * (2 * 0.01 + 2 * 0.0025) + 2 * 9.0)) < 1e-5, "truncated squares", 0);
        const int before = rounds.rounds;
        rounds.settle();
        expect(rounds.rounds == before + 1 && rounds.trust[4] == 1 && rounds.trust[5] == 0, "nothing is left to change", 0);
    });
    with_places(x, 100.0, [&](solve::Graduation rounds) {
        rounds.graduate(2);
        expect(!rounds.settled && rounds.rounds == 2, "no more rounds than asked for", 0);
    });
    with_places({1.0, 1.1}, 0.0, [&](solve::Graduation rounds) {
        rounds.settle();
        expect(rounds.stuck.has_value(), "nothing determines x", 0);
    });
}
