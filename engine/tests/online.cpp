// The online solver without Python: drives in a circle among landmarks.
#include <cmath>
#include <numbers>
#include <random>

#include "expect.hpp"
#include "vmslam/online/system.hpp"

namespace {

using namespace vmslam::online;

constexpr Symmetric stiff{400.0, 0.0, 400.0, 0.0, 0.0, 900.0}, sighting{100.0, 20.0, 150.0, 0.0, 0.0, 0.0};

Triple moved(const Triple& x, const Triple& d) {
    const Rotation axes(x[2]);
    return {x[0] + axes.c * d[0] - axes.s * d[1], x[1] + axes.s * d[0] + axes.c * d[1], x[2] + d[2]};
}

/// A drive with a turn of `turn` at each step, which sees the landmarks that are near.
class Drive {
   public:
    OnlineSystem system{1e-7, 15};
    std::vector<Id> poses;
    std::vector<Triple> truth{{0.0, 0.0, 0.0}};

    Drive(unsigned seed, double noise, vmslam::edges::Kernel kernel = {}) : random_(seed), noise_(noise) {
        system.use_kernel(kernel, 1.0);
        for (int k = 0; k < 12; ++k) marks_.push_back({normal() * 4, 4 + normal() * 4, 0.0});
        numbers_.assign(marks_.size(), -1);
        poses.push_back(system.add_node());
        system.add_prior(poses, truth, {1e6, 0, 0, 0, 1e6, 0, 0, 0, 1e6}, false);
        system.solve(poses, {}, poses);
    }
    void step() {
        const Triple motion{0.5, 0.0, 0.12};
        const auto known = static_cast<Id>(system.graph().nodes.size());
        truth.push_back(moved(truth.back(), motion));
        const Id from = poses.back();
        poses.push_back(system.add_node());
        const Vector z{motion[0] + noise() / 20, noise() / 20, motion[2] + noise() / 30};
        std::vector<NewEdge> edges{{{from, poses.back()}, Kind::motion, true, z, stiff}};
        const Triple& pose = truth.back();
        const Rotation axes(pose[2]);
        for (std::size_t k = 0; k < marks_.size(); ++k) {
            const double dx = marks_[k][0] - pose[0], dy = marks_[k][1] - pose[1];
            if (std::hypot(dx, dy) > 5.0) continue;
            if (numbers_[k] < 0) numbers_[k] = system.add_node();
            const Vector mark{axes.c * dx + axes.s * dy + noise() / 10, axes.c * dy - axes.s * dx + noise() / 12, 0.0};
            edges.push_back({{poses.back(), numbers_[k]}, Kind::sighting, false, mark, sighting});
        }
        expect(system.add(known, edges, {&poses.back(), 1}), "a step is taken", 0);
    }
    void drop_oldest() {
        // the first pose stays, and what the others leave is relative to it
        system.marginalize(poses[1], {&poses.back(), 1});
        poses.erase(poses.begin() + 1);
        if (!system.crowded()) return;
        const std::vector<Id> number = system.renumber();
        for (Id& pose : poses) pose = number[pose];
        for (Id& mark : numbers_) mark = mark < 0 ? mark : number[mark];
    }
    double normal() { return std::normal_distribution<>()(random_); }
    double noise() { return noise_ * normal(); }

   private:
    std::mt19937 random_;
    double noise_;
    std::vector<Triple> marks_;
    std::vector<Id> numbers_;
};

double farthest(const std::vector<Triple>& a, const std::vector<Triple>& b) {
    double most = 0.0;
    for (std::size_t k = 0; k < a.size(); ++k)
        for (int c = 0; c < 3; ++c) most = std::max(most, std::abs(a[k][c] - b[k][c]));
    return most;
}

void exact_measurements_are_met(unsigned seed) {
    Drive drive(seed, 0.0);
    for (int k = 0; k < 120; ++k) drive.step();
    expect(farthest(drive.system.values(drive.poses), drive.truth) < 1e-8, "exact measurements give the true poses", seed);
    expect(drive.system.cost() < 1e-12, "and no cost", seed);
}

/// The estimate is where the solution with all edges linearised anew is, and copies and saved systems go on as the original.
void steps_end_at_the_minimum(unsigned seed, vmslam::edges::Kernel kernel) {
    Drive drive(seed, 1.0, kernel);
    for (int k = 0; k < 150; ++k) drive.step();
    expect(drive.system.converged, "a noisy drive converges", seed);
    OnlineSystem other = drive.system, restored{0.0, 0};
    const std::string saved = drive.system.save();
    std::string damaged = saved;
    damaged[damaged.size() / 2] ^= 1;
    expect(!restored.restore(damaged), "damaged bytes are not restored", seed);
    expect(!restored.restore("nonsense") && !restored.restore(saved.substr(0, 2000)), "nor others", seed);
    expect(restored.restore(saved), "a saved system is restored", seed);
    expect(restored.values(drive.poses) == drive.system.values(drive.poses), "with its estimate", seed);
    expect(restored.save() == saved, "and with all its numbers", seed);
    const double cost = drive.system.cost();
    other.relinearize({&drive.poses.back(), 1});
    expect(cost <= other.cost() * (1 + 1e-6), "no lower cost nearby", seed);
    // 1e-6 of J, some 2,000, is 0.05 standard deviations, which are below 0.2
    expect(farthest(other.values(drive.poses), drive.system.values(drive.poses)) < 1e-2, "nor another estimate", seed);
    drive.system = restored;
    for (int k = 0; k < 20; ++k) drive.step();
    const auto covariance = drive.system.covariance({&drive.poses.back(), 1}, {&drive.poses.back(), 1});
    expect(covariance && (*covariance)[0] > 0.0 && (*covariance)[8] < 1.0, "a covariance", seed);
}

void a_lag_frees_nodes(unsigned seed) {
    Drive drive(seed, 0.1);
    for (int k = 0; k < 200; ++k) {
        drive.step();
        if (drive.poses.size() > 20) drive.drop_oldest();
    }
    expect(drive.system.graph().nodes.size() < 120 && drive.system.priors() == 2, "a lag frees nodes", seed);
    const std::vector<Triple> last = drive.system.values({&drive.poses.back(), 1});
    expect(farthest(last, {drive.truth.back()}) < 0.1, "and is near the truth", seed);
}

/// J' (b - Lambda v) of a prior against finite differences of v' Lambda v - 2 b' v.
void priors_have_the_right_gradient(unsigned seed) {
    std::mt19937 random(seed);
    std::normal_distribution<double> normal;
    const std::vector<char> point{0, 1, 0, 1, 0};
    const std::size_t k = point.size(), n = 3 * k;
    for (const bool relative : {false, true}) {
        Prior prior;
        prior.relative = relative;
        std::vector<Triple> x;
        for (std::size_t i = 0; i < k; ++i) {
            const Triple centre{3 * normal(random), 3 * normal(random), normal(random)};
            prior.centre.push_back(centre);
            x.push_back({centre[0] + normal(random), centre[1] + normal(random), centre[2] + 0.3 * normal(random)});
        }
        const auto means_nothing = [&](std::size_t i) { return i % 3 == 2 && point[i / 3]; };
        std::vector<double> root(n * n);
        for (std::size_t i = 0; i < n * n; ++i) root[i] = means_nothing(i % n) ? 0.0 : normal(random);
        prior.information.assign(n * n, 0.0);
        for (std::size_t i = 0; i < n * n * n; ++i)
            prior.information[i / n] += root[(i % n) * n + i / n / n] * root[(i % n) * n + i / n % n];
        for (std::size_t i = 0; i < n; ++i) prior.rhs.push_back(means_nothing(i) ? 0.0 : normal(random));
        const auto cost = [&](std::span<const Triple> at) { return Way(prior, at, point).cost(prior); };
        const std::vector<double> gradient = Way(prior, x, point).gradient(prior);
        double worst = 0.0;
        for (std::size_t i = 0; i < n; ++i) {
            if (means_nothing(i)) continue;
            double at[2];
            for (const int side : {0, 1}) {
                std::vector<Triple> there = x;
                Triple d{};
                d[i % 3] = side == 0 ? -1e-5 : 1e-5;
                Triple& node = there[i / 3];
                node = point[i / 3] ? Triple{node[0] + d[0], node[1] + d[1], node[2]} : moved(node, d);
                at[side] = cost(there);
            }
            worst = std::max(worst, std::abs(gradient[i] + (at[1] - at[0]) / 4e-5));
        }
        expect(worst < 1e-5, "the gradient of a prior", seed);
    }
}

/// The pulls of all kinds of edges against finite differences of their cost, by increments in the axes of each node.
void edges_have_the_right_gradient(unsigned seed) {
    std::mt19937 random(seed);
    std::normal_distribution<double> normal;
    const Symmetric W{20.0, 3.0, 15.0, 1.0, -2.0, 30.0}, of_point{20.0, 3.0, 15.0, 0.0, 0.0, 0.0};
    for (const bool robust : {false, true}) {
        Graph graph;
        if (robust) graph.kernels.fill({vmslam::edges::Robust::cauchy, 2.0});
        for (int k = 0; k < 3; ++k) {
            Node& node = graph.nodes.emplace_back();
            node.point = k == 2;
            node.begin({3 * normal(random), 3 * normal(random), k == 2 ? 0.0 : normal(random)});
        }
        const Vector z{normal(random), normal(random), normal(random)};
        const Lever lever{normal(random), normal(random)};
        const NewEdge added[] = {{{0, 1}, Kind::relation, true, z, W, {}, true},
                                 {{0, 2}, Kind::sighting, false, z, of_point},
                                 {{0, 2}, Kind::range, false, {std::abs(z.x), 0, 0}, W, lever},
                                 {{0, 1}, Kind::range, false, {std::abs(z.x), 0, 0}, W, lever},
                                 {{1, 2}, Kind::bearing, false, z, W, lever},
                                 {{1, 0}, Kind::bearing, false, z, W, lever},
                                 {{0, 0}, Kind::position, false, z, of_point, lever, true},
                                 {{1, 1}, Kind::position, true, z, W, lever, true}};
        graph.append(added, 3);
        for (const Edge& edge : graph.edges) {
            const auto cost = [&] { return linearize(graph, edge).cost; };
            const Pulls found = pulls(linearize(graph, edge));
            for (int side = 0; side < (edge.one_ended() ? 1 : 2); ++side)
                for (int k = 0; k < 3; ++k) {
                    Node& node = graph.nodes[edge.ends[side]];
                    if (node.point && k == 2) continue;
                    const Node before = node;
                    double at[2];
                    for (const int way : {0, 1}) {
                        Triple d{};
                        d[k] = way == 0 ? -1e-5 : 1e-5;
                        node.begin(node.point ? Triple{before.x[0] + d[0], before.x[1] + d[1], 0.0} : moved(before.x, d));
                        at[way] = cost();
                        node = before;
                    }
                    const double numeric = -(at[1] - at[0]) / 4e-5;
                    expect(std::abs(found.ends[side][k] - numeric) < 1e-5 * (1.0 + std::abs(numeric)),
                           "the gradient of an edge", seed);
                }
        }
    }
}

void a_refused_step_changes_nothing(unsigned seed) {
    Drive drive(seed, 1.0);
    for (int k = 0; k < 30; ++k) drive.step();
    OnlineSystem& system = drive.system;
    const std::string before = system.save();
    const auto known = static_cast<Id>(system.graph().nodes.size());
    const Id pose = system.add_node();
    const NewEdge loose{{drive.poses.back(), pose}, Kind::motion, true, {1.0, 0.0, 0.0}, {0.0, 0.0, 0.0, 0.0, 0.0, 0.0}};
    const NewEdge range{{drive.poses.back(), system.add_point(1.0, 2.0)}, Kind::range, false, {1.0, 0.0, 0.0}, {1.0}};
    const NewEdge edges[] = {loose, range};
    expect(!system.add(known, edges, {&pose, 1}), "a step without information is refused", seed);
    expect(system.save() == before, "and changes nothing", seed);
    OnlineSystem alone{1e-8, 15};
    for (const Id node : {alone.add_point(1.0, 2.0), alone.add_node()})
        expect(refused([&] { alone.marginalize(node, {&node, 1}); }), "a node without neighbours is not marginalised", seed);
    drive.step();
    expect(system.converged, "the next step is taken", seed);
    // nothing is solved with a prior that has no factor
    const Id first = alone.add_node(), mark = alone.add_node();
    const Triple place{1.0, 2.0, 0.0};
    alone.add_prior({&first, 1}, {&place, 1}, {1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0}, false);
    expect(alone.solve({&first, 1}, {}, {&first, 1}), "a pose with a prior", seed);
    alone.add_prior({&mark, 1}, {&place, 1}, {1.0, 2.0, 0.0, 2.0, 1.0, 0.0, 0.0, 0.0, 0.0}, true);
    expect(!alone.solve({&mark, 1}, {}, {&first, 1}), "an indefinite prior", seed);
    const Id next = alone.add_node();
    const NewEdge motion{{first, next}, Kind::motion, true, {1.0, 0.0, 0.0}, stiff};
    expect(!alone.add(next, {&motion, 1}, {&next, 1}), "nor a step after it", seed);
}

/// A loop closure after a heading error of a radian needs the batch solver.
void the_batch_solver_takes_a_large_correction(unsigned seed) {
    Drive drive(seed, 0.0);
    OnlineSystem& system = drive.system;
    std::vector<Triple> truth{{0.0, 0.0, 0.0}};
    for (int k = 1; k <= 300; ++k) {
        const auto known = static_cast<Id>(system.graph().nodes.size());
        const double turn = k % 75 == 0 ? std::numbers::pi / 2 : 0.0;
        truth.push_back(moved(truth.back(), {1.0, 0.0, turn}));
        const Id from = drive.poses.back();
        drive.poses.push_back(system.add_node());
        const Vector z{1.0 + 0.14 * drive.normal(), 0.14 * drive.normal(), turn + 0.1 * drive.normal()};
        const NewEdge edge{{from, drive.poses.back()}, Kind::motion, true, z, {50.0, 0.0, 50.0, 0.0, 0.0, 100.0}};
        system.add(known, {&edge, 1}, {&drive.poses.back(), 1});
    }
    const Triple& end = truth.back();
    const NewEdge closure{{drive.poses.front(), drive.poses.back()}, Kind::relation, true, {end[0], end[1], end[2]}, stiff};
    expect(system.add(system.graph().size(), {&closure, 1}, {&drive.poses.back(), 1}), "a closure is taken", seed);
    expect(system.converged, "and converges", seed);
    const Triple found = system.values({&drive.poses.back(), 1})[0];
    expect(std::hypot(found[0] - end[0], found[1] - end[1]) < 0.5, "the loop is closed", seed);
}

}  // namespace

void test_online() {
    using vmslam::edges::Robust;
    for (unsigned seed = 0; seed < 4; ++seed) {
        exact_measurements_are_met(seed);
        steps_end_at_the_minimum(seed, {});
        steps_end_at_the_minimum(seed, {Robust::cauchy, 2.4});
        a_lag_frees_nodes(seed);
        priors_have_the_right_gradient(seed);
        edges_have_the_right_gradient(seed);
        a_refused_step_changes_nothing(seed);
        the_batch_solver_takes_a_large_correction(seed);
    }
}
