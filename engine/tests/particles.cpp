// Particle filters without Python: each part against a plain computation.
#include <algorithm>
#include <array>
#include <limits>
#include <map>
#include <numeric>
#include <random>

#include "expect.hpp"
#include "vmslam/particles/filter.hpp"

namespace {

using namespace vmslam;
using namespace vmslam::particles;

double normal(std::mt19937& random) { return std::normal_distribution<>()(random); }
Lanes each(double x) { return numbers::all<Lanes>(x); }

/// A random Gaussian around a place.
Gaussian gaussian(std::mt19937& random, double x, double y, double h, double spread) {
    double a[3][3], S[3][3]{};
    for (auto& row : a)
        for (double& entry : row) entry = spread * normal(random);
    for (int r = 0; r < 3; ++r)
        for (int c = 0; c < 3; ++c)
            for (int k = 0; k < 3; ++k) S[r][c] += a[r][k] * a[c][k];
    for (int k = 0; k < 3; ++k) S[k][k] += 1e-3;
    return {each(x),       each(y),       each(h),       each(S[0][0]), each(S[0][1]),
            each(S[0][2]), each(S[1][1]), each(S[1][2]), each(S[2][2])};
}

/// The history against one list of poses per particle, with resampling up to twice in a step.
void test_history(unsigned seed) {
    std::mt19937 random(seed);
    const std::size_t count = 1 + seed % 13;
    History tree(count);
    std::vector<std::vector<double>> lines(count);
    std::vector<std::map<std::int64_t, Index>> names(count);
    for (int step = 0; step < 60; ++step) {
        Rows poses(3, count);
        for (std::size_t i = 0; i < count; ++i) lines[i].push_back(poses.row(0)[i] = normal(random));
        tree.open_level();
        tree.write(poses, 0, count);
        for (unsigned again = random() % 3; again > 0; --again) {
            const std::int64_t level = tree.level_to_write();
            for (std::size_t i = 0; i < count; ++i) names[i][level] = static_cast<Index>(i);
            std::vector<Index> ancestors(count);
            for (Index& a : ancestors) a = static_cast<Index>(random() % count);
            std::sort(ancestors.begin(), ancestors.end());
            tree.branch(ancestors);
            const auto old_lines = lines;
            const auto old_names = names;
            for (std::size_t i = 0; i < count; ++i) lines[i] = old_lines[ancestors[i]], names[i] = old_names[ancestors[i]];
        }
        if (step % 20 == 19) tree.prune();
    }
    for (const auto& [level, unused] : names[0]) {
        const Index* const ancestors = tree.ancestors(level);
        for (std::size_t i = 0; i < count; ++i)
            expect((ancestors ? ancestors[i] : static_cast<Index>(i)) == names[i][level], "ancestors of a level", seed);
    }
    for (std::size_t i = 0; i < count; ++i) {
        const auto path = tree.trajectory(i);
        expect(path.size() == lines[i].size(), "a history has a pose for each step", seed);
        for (std::size_t t = 0; t < path.size(); ++t) expect(path[t][0] == lines[i][t], "poses of a history", seed);
    }
    const History::Summary summary = tree.summary(std::vector<double>(count, 1.0 / static_cast<double>(count)));
    for (std::size_t t = 0; t < 60; ++t) {
        double mean = 0.0;
        for (const auto& line : lines) mean += line[t] / static_cast<double>(count);
        expect(std::fabs(summary.means[t][0] - mean) < 1e-12, "the mean of all histories", seed);
    }
}

/// Weights that are normalised, whatever the number of particles; sums that do not depend on the threads.
void test_weights(unsigned seed) {
    std::mt19937 random(seed);
    const std::size_t count = 1 + random() % 3000;
    Rows log_weights(1, count), weights(1, count);
    for (std::size_t i = 0; i < count; ++i)
        log_weights.row(0)[i] = i % 7 == 1 ? -std::numeric_limits<double>::infinity() : -300 + 20 * normal(random);
    const Rows before = log_weights;
    const double highest = *std::max_element(before.row(0), before.row(0) + count);
    const WeightSums sums = normalize({log_weights.row(0), count}, highest, weights.row(0));
    double total = 0.0, all = 0.0;
    for (std::size_t i = 0; i < count; ++i) {
        total += std::exp(before.row(0)[i] - highest);
        all += std::exp(log_weights.row(0)[i]);
    }
    expect(std::fabs(sums.total / total - 1) < 1e-13 && std::fabs(all - 1) < 1e-12, "normalised weights", seed);
}

/// A M A' + epsilon I on both sides of every branch of the prediction, A by central differences.
void test_prediction(double omega) {
    const ControlMotion u{0.4, omega, 0.1, 0.2, 1.3, 1e-4};
    std::mt19937 random(1);
    const Pose x{each(0.3), each(-0.2), each(normal(random))};
    const Gaussian predicted = predict({u, 0}, false).of(x);
    const auto f = [&](double c0, double c1) {
        const Pose moved = driven(x, u, each(c0), each(c1));
        return std::array<double, 3>{moved.x[0], moved.y[0], moved.t[0]};
    };
    constexpr double h = 1e-5;
    const auto nu_more = f(h, 0), nu_less = f(-h, 0), omega_more = f(0, h), omega_less = f(0, -h), mean = f(0, 0);
    double P[3][3];
    for (int r = 0; r < 3; ++r)
        for (int c = 0; c < 3; ++c)
            P[r][c] = ((nu_more[r] - nu_less[r]) * (nu_more[c] - nu_less[c]) +
                       (omega_more[r] - omega_less[r]) * (omega_more[c] - omega_less[c])) /
                          (4 * h * h) +
                      (r == c ? u.epsilon : 0);
    const double found[6]{predicted.xx[0], predicted.xy[0], predicted.xh[0],
                          predicted.yy[0], predicted.yh[0], predicted.hh[0]};
    const double wanted[6]{P[0][0], P[0][1], P[0][2], P[1][1], P[1][2], P[2][2]};
    for (int k = 0; k < 6; ++k) expect(std::fabs(found[k] - wanted[k]) < 1e-9, "the covariance of a motion", 0);
    expect(std::fabs(predicted.x[0] - mean[0]) < 1e-13 && std::fabs(predicted.y[0] - mean[1]) < 1e-13, "the mean of a motion",
           0);
}

/// The product of two Gaussians, in the information form.
void test_merged(unsigned seed) {
    std::mt19937 random(seed);
    const bool oriented = seed % 2 == 0;
    const Gaussian a = gaussian(random, 0.1, 0.2, 3.1, 0.2), b = gaussian(random, 0.15, 0.1, -3.1, 0.2),
                   c = fused(a, b, oriented);
    const auto information = [&](const Gaussian& g) {
        return edges::inverse({g.xx[0], g.xy[0], g.yy[0], g.xh[0], g.yh[0], g.hh[0]}, oriented);
    };
    const Symmetric A = information(a), B = information(b), C = information(c), sum = A + B;
    const auto away = [&](const Gaussian& g) {
        return Vector{c.x[0] - g.x[0], c.y[0] - g.y[0], oriented ? numbers::wrap_angle(c.h[0] - g.h[0]) : 0.0};
    };
    const Vector pull_a = A * away(a), pull_b = B * away(b);
    for (int k = 0; k < 3; ++k) {
        const double one = (&pull_a.x)[k], other = (&pull_b.x)[k];
        expect(std::fabs(one + other) < 1e-8 * (1 + std::fabs(one) + std::fabs(other)), "the mean of merged landmarks", seed);
    }
    const double diagonal[]{C.xx, C.yy, C.tt};
    constexpr int rows[]{0, 0, 1, 0, 1, 2}, columns[]{0, 1, 1, 2, 2, 2};
    for (int k = 0; k < 6; ++k)
        expect(std::fabs((&C.xx)[k] - (&sum.xx)[k]) < 1e-8 * (1 + diagonal[rows[k]] + diagonal[columns[k]]),
               "information of merged landmarks", seed);
}

/// Two landmarks of classes, just outside and just inside of the gate; the product of their probabilities.
void test_merge(bool alike) {
    Blocks old(13, lanes), young(13, lanes);
    const double p[2][2]{{0.95, 0.05}, {alike ? 0.9 : 0.02, alike ? 0.1 : 0.98}};
    const auto reset = [&] {
        for (int row = 0; row < 13; ++row)
            for (int i = 0; i < lanes; ++i)
                old.at(row, i) = young.at(row, i) = row == 3 || row == 6 ? 0.1 : row == 8 ? 1.0 : 0.0;
        for (int i = 0; i < lanes; ++i) {
            young.at(0, i) = 0.3;  // at a squared distance of 0.45
            old.at(evidence_row, i) = young.at(evidence_row, i) = 2.0;
            old.at(last_step_row, i) = 4.0;
            young.at(last_step_row, i) = i == 1 ? 4.0 : 5.0;
            for (int c = 0; c < 2; ++c) old.at(first_class_row + c, i) = p[0][c], young.at(first_class_row + c, i) = p[1][c];
        }
    };
    const double common = p[0][0] * p[1][0] + p[0][1] * p[1][1], bound = 0.45 - 2 * std::log(2 * common);
    Blocks* const both[]{&old, &young};
    for (const bool merged : {false, true}) {
        reset();
        merge(both, false, bound + (merged ? 1e-6 : -1e-6), {0.0, 0.0}, 2, 0, lanes);
        expect((young.at(evidence_row, 0) == 0.0) == merged, "landmarks that are one", 0);
        expect(young.at(evidence_row, 1) == 2.0, "one scan saw both", 0);
        if (!merged) continue;
        expect(old.at(evidence_row, 0) == permanent_evidence && old.at(last_step_row, 0) == 5.0, "evidence of both", 0);
        expect(std::fabs(old.at(first_class_row, 0) - p[0][0] * p[1][0] / common) < 1e-12, "classes of both", 0);
    }
}

/// Filters of all kinds run, with one thread and with three to the same numbers.
void test_filters(bool oriented, bool ids, Version version, std::size_t jointly) {
    const auto run = [&](std::size_t threads) {
        const std::size_t count = 12'301;
        Rows poses(3, count);
        poses.fill(0.0);
        Filter filter(std::move(poses), threads, false);
        const double unknown = std::numeric_limits<double>::quiet_NaN();
        if (ids) {
            expect(refused([&] { filter.use_ids(oriented, most_sightings + 1, std::nullopt); }), "17 sightings", 0);
            filter.use_ids(oriented, jointly, std::nullopt);
        } else
            filter.use_no_ids(oriented, {20.0, 6.0, 2, {unknown, unknown, unknown}}, {});
        for (int step = 0; step < 5; ++step) {
            if (step > 0)
                filter.move({ControlMotion{0.3, 0.2, 0.05, 0.05, 1.0, 1e-4}, static_cast<std::uint64_t>(step)}, true);
            std::vector<Sighting> sightings;
            const double x = 0.3 * step, t = 0.2 * step;
            for (const auto& [mx, my] : {std::pair{3.0, 1.0}, {2.5, -1.0}, {4.0, 0.2}})
                sightings.push_back({{std::hypot(mx - x, my), std::atan2(my, mx - x) - t, -t}, {0.04, 0.003, 0.003}});
            const std::array<LandmarkId, 3> names{4, 2, 9};
            const std::array<std::int64_t, 3> shown{};
            if (ids)
                filter.weigh_identified(names, sightings, version);
            else
                filter.weigh_anonymous(sightings, shown, version);
            const Filter::Reweighed weighed = filter.reweigh();
            expect(weighed.possible && weighed.ess >= 1.0, "effective sample size", 0);
            std::vector<double> sums(count);
            std::partial_sum(filter.weights().begin(), filter.weights().end(), sums.begin());
            filter.branch(evenly_spaced(sums, 0.5));
            filter.end_step();
        }
        std::vector<double> out;
        for (int k = 0; k < 3; ++k) out.insert(out.end(), filter.poses()->row(k), filter.poses()->row(k) + count);
        return out;
    };
    const std::vector<double> one = run(1);
    expect(one == run(3), "a filter does not depend on the number of threads", 0);
    expect(std::all_of(one.begin(), one.end(), [](double x) { return std::isfinite(x); }), "finite poses", 0);
}

}  // namespace

void test_particles() {
    for (unsigned seed = 0; seed < 40; ++seed) {
        test_history(seed);
        test_weights(seed);
        test_merged(seed);
    }
    for (const double omega : {0.0, 1e-9, 0.05, 0.4, 0.5, 1.7, -2.5}) test_prediction(omega);
    test_merge(true);
    test_merge(false);
    for (const bool oriented : {false, true}) {
        for (const Version version : {Version::motion, Version::corrected_exact, Version::corrected_linearised}) {
            test_filters(oriented, true, version, 0);
            test_filters(oriented, false, version, 0);
        }
        test_filters(oriented, true, Version::corrected_exact, 3);
    }
}
