// Initial values of a graph, its minimum, and the proof of that.
#include <cmath>
#include <numbers>
#include <numeric>
#include <random>

#include "expect.hpp"
#include "vmslam/solve/graph.hpp"
#include "vmslam/solve/grow.hpp"
#include "vmslam/solve/restarts.hpp"

namespace {

using namespace vmslam;
using edges::Vector;

/// Pose b in the axes of pose a.
Vector between(const Vector& a, const Vector& b) {
    const Vector offset = edges::turned(edges::Rotation(-a.t), Vector{b.x - a.x, b.y - a.y, 0.0});
    return {offset.x, offset.y, edges::wrap(b.t - a.t)};
}

void test_ring(unsigned seed) {
    std::mt19937 random(seed);
    std::normal_distribution<> noise(0.0, 0.03);
    const int poses = 8 + static_cast<int>(random() % 20);
    std::vector<Vector> truth;
    for (int k = 0; k < poses; ++k) {
        const double angle = 2 * std::numbers::pi * k / poses;
        truth.push_back({5 * std::cos(angle), 5 * std::sin(angle), edges::wrap(angle + std::numbers::pi / 2)});
    }
    std::vector<edges::RelativeEdge> measured;
    for (int k = 0; k < 2 * poses; ++k) {
        const int i = k < poses ? k : static_cast<int>(random() % poses), j = (i + (k < poses ? 1 : 3)) % poses;
        Vector z = between(truth[i], truth[j]);
        z = {z.x + noise(random), z.y + noise(random), z.t + noise(random)};
        measured.push_back({i, j, z, {100.0, 5.0, 200.0, 3.0, 1.0, 300.0}});
    }
    solve::Graph graph(poses);
    graph.add_anchor(0, truth[0]);
    graph.add_relative(measured, seed % 2 ? edges::Kernel{edges::Robust::cauchy, 3.0} : edges::Kernel{});

    const solve::Start start = graph.rotation_first();
    expect(start.found(), "the edges determine all poses", seed);
    if (!start.found()) return;
    for (int k = 0; k < poses; ++k) {
        const double apart = std::hypot(start.state[3 * k] - truth[k].x, start.state[3 * k + 1] - truth[k].y);
        expect(apart < 1.0 && std::abs(edges::wrap(start.state[3 * k + 2] - truth[k].t)) < 0.3, "the start is near the truth",
               seed);
    }
    solve::Run run{{.tolerance = 1e-9}, start.state};
    graph.solve(run);
    expect(run.converged, "the iteration converges", seed);
    const auto least = graph.lower_bound(run.state);
    expect(least && least->global && least->lowest <= least->cost, "the minimum is proven", seed);
    if (seed % 2 == 0) expect(std::abs(least->cost - run.costs.back()) < 1e-6 * least->cost, "J of the proof", seed);

    // the headings wind twice around the ring
    std::vector<double> wound = run.state;
    for (int k = 0; k < poses; ++k) wound[3 * k + 2] += 2 * std::numbers::pi * k / poses;
    const auto other = graph.lower_bound(wound);
    expect(other && !other->global, "a worse state is not proven", seed);
    expect(other && (seed % 2 || other->lowest <= least->cost), "a lower bound is below the minimum", seed);
}

/// The motions of a log, and the variances of their turns.
struct Motions {
    std::vector<double> ends{0.0, 0.0, 0.0}, variances{0.0};

    explicit Motions(const Log& log, const MotionNoise& noise = {}) {
        for (std::size_t t = 0; t + 1 < log.poses(); ++t) {
            const auto [end, covariance] = moved(log.motion(t), noise);
            ends.insert(ends.end(), {end.x, end.y, end.t});
            variances.push_back(covariance.tt);
        }
    }
};

/// Growth along odometry that turns 3 % too fast ends near the minimum, because sightings correct it on the way.
void test_growth(unsigned seed) {
    const double turn = 2 * std::numbers::pi / 20;
    Log log;
    log.start = {1.0, 2.0, 0.5};
    log.oriented = seed % 2;
    for (int t = 0; t < 45; ++t) log.controls.push_back({0.5, turn, 1.0});
    const std::vector<double> truth = dead_reckoning(log);
    for (std::size_t t = 0; t < log.poses(); ++t)
        for (std::int64_t j = 0; j < 6; ++j) {
            const double x = 1.0 + 2 * std::cos(j), y = 3.6 + 2 * std::sin(j), dx = x - truth[3 * t],
                         dy = y - truth[3 * t + 1];
            const double direction = std::atan2(dy, dx);
            log.sightings.push_back(
                {t, j, {std::hypot(dx, dy), edges::wrap(direction - truth[3 * t + 2]), edges::wrap(direction)}});
        }
    for (Control& u : log.controls) u.omega *= 1.03;

    const solve::Graph graph = solve::graph_of(log);
    solve::Run run{{.tolerance = 1e-9}, truth};
    graph.solve(run);
    expect(run.converged, "the iteration converges", seed);
    const auto apart = [&](const std::vector<double>& state) {
        double farthest = 0.0;
        for (std::size_t t = 0; t < log.poses(); ++t)
            farthest =
                std::max(farthest, std::hypot(state[3 * t] - run.state[3 * t], state[3 * t + 1] - run.state[3 * t + 1]));
        return farthest;
    };
    const auto one_by_one = solve::graph_of(log, {}, book_sensor, {}, {.one_by_one = true}).costs(truth);
    const auto all = graph.costs(truth);
    expect(one_by_one.size() == 1 + 45 + 6 && std::abs(std::accumulate(one_by_one.begin(), one_by_one.end(), 0.0) -
                                                       std::accumulate(all.begin(), all.end(), 0.0)) < 1e-9,
           "edges one by one cost as much", seed);
    const std::vector<std::vector<std::size_t>> pairs{{0, 6}, {1, 7}};
    const auto virtual_motions = solve::graph_of(log, {}, book_sensor, {}, {.motions = false, .virtual_motions = pairs});
    const auto pair_costs = virtual_motions.costs(truth);
    expect(pair_costs.size() == 2 && pair_costs[1] < 1e-20 && virtual_motions.costs(dead_reckoning(log))[1] > 1e-6,
           "virtual motions of perfect sightings", seed);

    const Motions odometry(log);
    std::vector<solve::Index> parents(log.poses()), from(log.poses());
    std::iota(parents.begin(), parents.end(), -1);
    std::iota(from.begin(), from.end(), 0);
    std::vector<double> start(3 * log.poses(), 0.0);
    std::copy(log.start.begin(), log.start.end(), start.begin());
    const auto poses = static_cast<solve::Index>(log.poses());
    const auto grown = grow(*solve::Graph::Assembled(graph).objective, start, {poses, 7, parents, odometry.ends, from});
    expect(grown && apart(*grown) < 0.02 && apart(dead_reckoning(log)) > 0.5, "growth corrects drift", seed);

    expect(std::abs(solve::Growth{25, 10, {}, {}, {}}.most_steps() - 4.0 * (11 + 21 + 25) / 25) < 1e-12,
           "the steps of growth", seed);
}

/// The robot turns by pi out of sight of its only landmarks; the odometry leaves open in which direction.
void test_other_turns() {
    Log log;
    for (int t = 0; t < 12; ++t) log.controls.push_back({0.5, std::numbers::pi / 12, 1.0});
    const std::vector<double> truth = dead_reckoning(log);
    const Vector places[] = {{2.0, 1.0, 0.0}, {1.0, 3.0, 0.0}, {3.0, 2.0, 0.0}};
    for (const std::size_t t : {0, 1, 11, 12})
        for (std::int64_t j = 0; j < 3; ++j) {
            const Vector seen = between({truth[3 * t], truth[3 * t + 1], truth[3 * t + 2]}, places[j]);
            log.sightings.push_back({t, j, {std::hypot(seen.x, seen.y), std::atan2(seen.y, seen.x), 0.0}});
        }
    log.oriented = false;
    const MotionNoise noise{.nn = 0.1, .no = 0.01, .on = 0.1, .oo = 0.6};
    const solve::Graph graph = solve::graph_of(log, noise);
    solve::Run best{{.tolerance = 1e-9}, truth}, wrong = best;
    graph.solve(best);
    // from pose 1 on the headings turn to the other side, so that the last ones are what they were, less a full turn
    for (int t = 1; t < 12; ++t) wrong.state[3 * t + 2] -= 2 * std::numbers::pi * (t - 1) / 10;
    graph.solve(wrong);
    const auto cost = [&graph](const std::vector<double>& state) {
        const std::vector<double> costs = graph.costs(state);
        return std::accumulate(costs.begin(), costs.end(), 0.0);
    };
    expect(wrong.converged && cost(wrong.state) > cost(best.state) + 1, "a wrong minimum", 0);
    const Motions odometry(log, noise);
    solve::Graph::Assembled assembled(graph);
    const auto lowered_from = [&](const std::vector<double>& state, double limit) {
        return lowered_by_turns(*assembled.objective, state, {odometry.ends, odometry.variances}, limit);
    };
    const solve::Lowered lowered = lowered_from(wrong.state, 1e4);
    expect(lowered.state && std::abs(cost(*lowered.state) - cost(best.state)) < 1e-6, "another turn leads out of it", 0);
    expect(!lowered_from(best.state, 1e4).state, "no turn leads below the minimum", 0);
    expect(lowered_from(wrong.state, 0).steps == 0, "no steps are left", 0);

    // after an unknown motion other turns are tried as before
    std::vector<double> unknown(13, 0.04);
    for (const double missing : {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity()}) {
        unknown[1] = missing;
        const std::vector<solve::Stretch> later = solve::stretches(wrong.state, {odometry.ends, unknown});
        expect(!later.empty(), "turns after an unknown motion", 0);
        expect(std::ranges::all_of(later, [](const solve::Stretch& s) { return s.first > 0; }), "none across it", 0);
    }
}

/// Two of five closures with a kernel agree on a wrong place of the last pose, whose odometry says little.
void test_halves() {
    solve::Graph graph(3);
    graph.add_anchor(0, {0.0, 0.0, 0.0});
    graph.add_relative(
        {{0, 1, {1.0, 0.0, 0.0}, {1e4, 0.0, 1e4, 0.0, 0.0, 1e4}}, {1, 2, {1.0, 0.0, 0.0}, {1e-4, 0.0, 1e-4, 0.0, 0.0, 1.0}}});
    const edges::Symmetric omega{100.0, 0.0, 100.0, 0.0, 0.0, 100.0};
    graph.add_relative({{0, 2, {2.0, 0.0, 0.0}, omega},
                        {0, 2, {2.0, 0.01, 0.0}, omega},
                        {1, 2, {1.0, 0.0, 0.0}, omega},
                        {0, 2, {2.0, 3.0, 0.0}, omega},
                        {0, 2, {2.0, 3.01, 0.0}, omega}},
                       {edges::Robust::cauchy, 3.0});
    solve::Run right{{.tolerance = 1e-9}, {0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 2.0, 0.0, 0.0}}, wrong = right;
    wrong.state[7] = 3.0;
    graph.solve(right);
    graph.solve(wrong);
    expect(wrong.converged && wrong.state[7] > 2.9, "a wrong minimum", 0);
    const std::vector<double> motions{0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0}, variances{0.0, 1e-4, 1.0};
    solve::Graph::Assembled assembled(graph);
    const auto lowered_from = [&](const std::vector<double>& state) {
        const std::size_t doubted[] = {2};
        return lowered_by_halves(*assembled.objective, doubted, state, {motions, variances}, 1e4);
    };
    const solve::Lowered lowered = lowered_from(wrong.state);
    expect(lowered.state && std::abs((*lowered.state)[7] - right.state[7]) < 1e-4, "a half without it leads out of it", 0);
    expect(!lowered_from(right.state).state, "no half leads below the minimum", 0);
}

void test_loose() {
    solve::Graph graph(3);
    graph.add_anchor(0, {0.0, 0.0, 0.0});
    graph.add_relative({{0, 1, {1.0, 0.0, 0.0}, {1.0, 0.0, 1.0, 0.0, 0.0, 1.0}}});
    const solve::Start start = graph.rotation_first();
    expect(!start.found() && start.unturned == std::vector<solve::Index>{2}, "a pose that no edge ties has no initial value",
           0);
}

/// What has no lower bound, or none that is certain, is not proven.
void test_no_proof() {
    const std::vector<double> state{0.0, 0.0, 0.0, 1.25, 0.0, 1.0};
    const auto proven = [&](const edges::Symmetric& first, const edges::Symmetric& second) {
        solve::Graph graph(2);
        graph.add_anchor(0, {0.0, 0.0, 0.0});
        graph.add_relative({{0, 1, {1.0, 0.0, 0.0}, first}, {0, 1, {1.5, 0.0, 0.0}, second}});
        const auto bound = graph.lower_bound(state);
        return bound && bound->global;
    };
    expect(!proven({1.0, 0.0, 1.0, 0.0, 0.0, -1.0}, {1.0, 0.0, 1.0, 0.0, 0.0, 0.0}), "a negative eigenvalue", 0);
    expect(!proven({100.0, 500.0, 100.0, 0.0, 0.0, 400.0}, {1.0, 0.0, 1.0, 0.0, 0.0, 1.0}), "indefinite information", 0);
    expect(!proven({1.0, 0.0, 1.0, 0.0, 0.0, 1.0}, {1.0, 0.0, 1.0, 0.0, 0.0, 1.0}), "no stationary point", 0);
    // a ring whose headings wind twice, with a cost below what counts as zero
    solve::Graph ring(12);
    ring.add_anchor(0, {0.0, 0.0, 0.0});
    std::vector<double> wound;
    for (int k = 0; k < 12; ++k) {
        const double turn = 2 * std::numbers::pi / 12;
        ring.add_relative({{k, (k + 1) % 12, {1.0, 0.0, turn}, {1e-9, 0.0, 1e-9, 0.0, 0.0, 1e-8}}});
        wound.insert(wound.end(), {0.0, 0.0, edges::wrap(2 * turn * k)});
    }
    solve::Run run{{.tolerance = 1e-9}, wound};
    ring.solve(run);
    const auto bound = ring.lower_bound(run.state);
    expect(bound && bound->cost < 1e-6 && !bound->global, "a small cost is no proof", 0);

    using certificate::semidefinite;
    expect(semidefinite({0.0, 0.0, 0.0, 0.0, 0.0, 1.0}) && semidefinite({1.0, 1.0, 1.0, 0.0, 0.0, 0.0}), "singular matrices",
           0);
    expect(semidefinite({2.0, 0.5, 1.0, 0.1, 0.2, 3.0}) && !semidefinite({0.0, 0.0, 1.0, 0.1, 0.0, 1.0}),
           "correlated headings", 0);
    const double more = std::nextafter(1.0, 2.0);
    expect(semidefinite({1.0, 1.0, 1.0, 1.0, 1.0, 1.0}) && !semidefinite({1.0, 1.0, 1.0, more, more, 1.0}), "one number", 0);
    expect(semidefinite({2.0, 1.0, 1.0, 1.0, 1.0, more}) && !semidefinite({2.0, 1.0, 1.0, 1.0, more, 1.0}),
           "a rounding apart", 0);
    expect(semidefinite({1e300, 1e300, 1e300, 1e300, 1e300, 1e300}) && semidefinite({1e-300, 0.0, 1e-300, 0.0, 0.0, 1e-300}),
           "large and small numbers", 0);
    expect(!semidefinite({1e300, 0.0, 1e-300, 0.0, 2e-300, 1e-300}), "numbers too far apart", 0);
}

void test_wrong_arguments() {
    solve::Graph graph(3);
    expect(refused([] { solve::Graph(0); }), "a graph without nodes", 0);
    for (const solve::Index node : {-1, 3})
        expect(refused([&] { graph.add_anchor(node, {}); }) && refused([&] { graph.add_relative({{0, node, {}, {}}}); }),
               "a node that is not there", 0);
    expect(refused([] { solve::Graph(3, {3}); }), "a point that is not there", 0);
    expect(refused([&] { graph.add_pairs(nullptr, {0, 1}, {1}); }), "an edge with one end", 0);
    const solve::Index starts[] = {0, 2}, backwards[] = {1, 0};
    expect(refused([&] { graph.add_groups(nullptr, starts, backwards); }), "nodes of a group that decrease", 0);
    solve::Run run{{.tolerance = 1e-9}, {0.0}};
    expect(refused([&] { graph.solve(run); }) && refused([&] { graph.costs(run.state); }), "a short state", 0);
    Log log;
    log.controls = {{1.0, 0.0, 1.0}};
    log.sightings = {{5, 1, {1.0, 0.0, 0.0}}};
    expect(refused([&] { solve::graph_of(log); }), "a sighting from a pose that is not there", 0);
}

}  // namespace

void test_start() {
    for (unsigned seed = 0; seed < 50; ++seed) test_ring(seed);
    for (unsigned seed = 0; seed < 2; ++seed) test_growth(seed);
    test_other_turns();
    test_halves();
    test_loose();
    test_no_proof();
    test_wrong_arguments();
}
