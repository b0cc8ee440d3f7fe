// The sampler without Python: its Gaussians, its random numbers, and a posterior that is known otherwise.
#include <algorithm>
#include <array>
#include <cmath>

#include "expect.hpp"
#include "gibbs/moves.hpp"
#include "vmslam/gibbs/backward.hpp"

namespace {

using namespace vmslam::gibbs;

double farthest(const Vector& a, const Vector& b) {
    return std::max({std::abs(a.x - b.x), std::abs(a.y - b.y), std::abs(wrap_angle(a.t - b.t))});
}

Symmetric covariance(Random& random) {
    const double a = random.normal(), b = random.normal(), c = random.normal();
    return {1.0 + a * a, a * b, 1.0 + b * b, a * c, b * c, 1.0 + c * c};
}

void random_numbers_have_their_moments() {
    Random random(1);
    constexpr int count = 200'000;
    double mean = 0.0, square = 0.0, beyond = 0.0, gammas = 0.0;
    std::array<double, 3> weights{1.0, 2.0, 1.0};
    int middle = 0;
    for (int k = 0; k < count; ++k) {
        const double n = random.normal();
        mean += n, square += n * n, beyond += std::abs(n) > 3.7;
        gammas += random.gamma(2.5);
        middle += random.pick(weights) == 1;
    }
    // five standard errors; P(|n| > 3.7) = 2.156e-4 is their tail
    const double error = 5 / std::sqrt(count);
    expect(std::abs(mean / count) < error && std::abs(square / count - 1) < error * std::sqrt(2.0), "normal numbers", 0);
    expect(std::abs(beyond / count - 2.156e-4) < error * std::sqrt(2.156e-4), "their tail", 0);
    expect(std::abs(gammas / count - 2.5) < error * std::sqrt(2.5), "gamma numbers", 0);
    expect(std::abs(middle / double(count) - 0.5) < error * 0.5, "picks", 0);
    std::array<double, 2> none{std::nan(""), 0.0};
    expect(random.choose(none) == 1, "weights that are no numbers choose something", 0);
}

/// The order of sightings does not matter, and neither do the axes.
void gaussians_are_fused(unsigned seed) {
    Random random(seed);
    const Vector y[] = {normals(random), normals(random), normals(random)};
    const Symmetric C[] = {covariance(random), covariance(random), covariance(random)};
    Gaussian forward, backward;
    double density_forward = 0.0, density_backward = 0.0;
    for (int k = 0; k < 3; ++k) {
        density_forward += fuse(forward, {{y[k].x, y[k].y, 0.2 * y[k].t}, C[k]}, true);
        density_backward += fuse(backward, {{y[2 - k].x, y[2 - k].y, 0.2 * y[2 - k].t}, C[2 - k]}, true);
    }
    expect(farthest(forward.mean, backward.mean) < 1e-12, "fused in any order", seed);
    expect(std::abs(density_forward - density_backward) < 1e-9, "the density of all is the same", seed);
    const Frame pose({random.normal(), random.normal(), 2.0});
    const Gaussian seen{y[0], C[0]};
    const double here = density(forward, seen, true), there = density(composed(pose, forward), composed(pose, seen), true);
    expect(std::abs(here - there) < 1e-9, "densities do not depend on the axes", seed);
    expect(farthest(relative(pose, composed(pose, y[0])), {y[0].x, y[0].y, wrap_angle(y[0].t)}) < 1e-12, "there and back",
           seed);
    const Symmetric product = passed(C[0], C[1]);
    const Symmetric expected = inverse(inverse(C[0]).matrix + inverse(C[1]).matrix).matrix;
    expect(std::abs(product.xx - expected.xx) + std::abs(product.yt - expected.yt) < 1e-12, "information after noise", seed);
}

/// A straight drive that sees one landmark from its first and its last pose. Without headings that matter, everything is
/// nearly linear: the end is the motion, corrected by the sightings.
Problem straight(bool exact) {
    Problem problem{{}, {}, {0, 1, 1, 1, 2}, 1, true, exact, 0.0};
    const Symmetric stiff{1e4, 0.0, 1e4, 0.0, 0.0, 1e6};
    for (int t = 0; t < 3; ++t) problem.motions.push_back({{1.0, 0.0, 0.0}, stiff});
    const Symmetric C{4e-4, 0.0, 4e-4, 0.0, 0.0, 1e-2}, weight{2500.0, 0.0, 2500.0, 0.0, 0.0, 100.0};
    const auto add = [&](Number step, const Vector& y) {
        const double range = std::hypot(y.x, y.y), bearing = std::atan2(y.y, y.x);
        problem.sightings.push_back(
            {{{y, C}, weight, {range, bearing, bearing - y.t}, {4e-4, 4e-4 / (range * range), 1e-2}}, step, 0});
    };
    add(0, {5.0, 0.0, 0.0});
    add(3, {2.06, 0.0, 0.0});
    return problem;
}

void chains_sample_the_posterior(bool exact) {
    const Problem problem = straight(exact);
    Random random(3);
    Chain chain;
    chain.poses = {{0.0, 0.0, 0.0}, {1.0, 0.0, 0.0}, {2.0, 0.0, 0.0}, {3.0, 0.0, 0.0}};
    chain.guess.assign(3, {1.0, 0.0, 0.0});
    const Directions none{chain.poses, {{5.0, 0.0, 0.0}}, {}, {}};
    const ChainSamples samples = chain.run(random, problem, none, {10, 2, 4000, 0});
    double mean = 0.0, square = 0.0;
    for (const Trajectory& x : samples.trajectories) mean += x[3].x, square += x[3].x * x[3].x;
    mean /= 4000, square = square / 4000 - mean * mean;
    // x_3 ~ N(3, 3e-4) by the motions, and 5 - 2.06 = 2.94 with the variance 8e-4 by the sightings
    const double variance = 1 / (1 / 3e-4 + 1 / 8e-4), expected = variance * (3 / 3e-4 + 2.94 / 8e-4);
    expect(std::abs(mean - expected) < 0.1 * std::sqrt(variance), "the mean of the posterior", exact);
    expect(std::abs(square / variance - 1) < 0.2, "its variance", exact);
    expect(samples.maps.size() == 4000 && std::abs(samples.maps.back()[0].x - 5.0) < 0.2, "maps", exact);
}

/// Particles of equal weights: the rest of a trajectory is attached where the landmark has been seen.
void trajectories_are_drawn_backwards(Number candidates) {
    constexpr Number N = 400;
    Random random(5);
    using vmslam::particles::Rows;
    const auto log_weights = std::make_shared<Rows>(1, N);
    log_weights->fill(-std::log(static_cast<double>(N)));
    // a start somewhere, and exact motions
    Rows poses(3, N);
    poses.fill(0.0);
    for (Number i = 0; i < N; ++i) poses.row(0)[i] = 0.3 * random.normal();
    vmslam::particles::Record record(std::make_shared<Rows>(poses), log_weights);
    for (int t = 1; t < 4; ++t) {
        for (Number i = 0; i < N; ++i) poses.row(0)[i] += 1.0;
        record.move(std::make_shared<Rows>(poses), log_weights);
    }
    const BackwardSampler sampler(record, straight(false), candidates);
    double mean = 0.0;
    constexpr int draws = 400;
    for (int k = 0; k < draws; ++k) {
        const Trajectory x = sampler.draw(random).first;
        expect(std::abs(x[3].x - x[0].x - 3.0) < 1e-12, "motions are those of the particles", candidates);
        mean += x[0].x / draws;
    }
    // both ends see the landmark at the same place relative to them, up to 6 cm, wherever they are
    expect(std::abs(mean) < 5 * 0.3 / std::sqrt(N) + 5 * 0.3 / std::sqrt(draws), "all starts are as likely", candidates);
}

/// Moves along all directions of the Gaussian itself are always accepted.
void moves_leave_a_gaussian_unchanged() {
    Problem problem = straight(false);
    for (Motion& motion : problem.motions) motion.information = {1e6, 0.0, 1e6, 0.0, 0.0, 1e12};
    Random random(4);
    Trajectory x{{0.0, 0.0, 0.0}, {1.0, 0.0, 0.0}, {2.0, 0.0, 0.0}, {3.0, 0.0, 0.0}};
    Map m{{5.0, 0.0, 0.0}};
    // the heading of the landmark has the information 100 of each sighting
    std::vector<double> row(12, 0.0), deviation{1 / std::sqrt(200.0)};
    row[11] = 1.0;
    const Directions directions{x, m, row, deviation};
    const int accepted = move_along(random, problem, directions, 0.5, 2000, x, m);
    expect(accepted > 1990, "moves along the Gaussian are accepted", 0);
    expect(std::abs(m[0].t) < 0.5 && m[0].t != 0.0, "and move the state", 0);
}

}  // namespace

void test_gibbs() {
    random_numbers_have_their_moments();
    for (unsigned seed = 0; seed < 50; ++seed) gaussians_are_fused(seed);
    chains_sample_the_posterior(false);
    chains_sample_the_posterior(true);
    trajectories_are_drawn_backwards(1000);
    trajectories_are_drawn_backwards(20);
    moves_leave_a_gaussian_unchanged();
}
