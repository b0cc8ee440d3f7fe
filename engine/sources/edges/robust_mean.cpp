#include "robust_mean.hpp"

#include <algorithm>
#include <limits>

namespace vmslam::edges {
namespace {

constexpr int most_steps = 1000;  ///< a guard that is never reached in practice
constexpr int most_raises = 10;   ///< how often a re-weighting may raise the cost before its steps are halved
/// Re-weighting up to a step of a tenth of the mean's standard deviation, then Newton's method.
constexpr double near = 0.01;

double length(const Vector& v) { return std::abs(v.x) + std::abs(v.y) + std::abs(v.t); }

/// Positive definite by its leading minors; the last element of the inverse is the quotient of the last two.
bool positive(const Symmetric& H, const Symmetric& inverse) {
    return H.xx > 0 && H.xx * H.yy > H.xy * H.xy && inverse.tt > 0;
}

/// The cost at a mean m, half its negative gradient b = - sum w W e, A = sum w W, and D = sum 2 w' (W e)(W e)', w' the
/// derivative of w by r².
struct Evaluation {
    double cost = 0.0;
    Vector b{0.0, 0.0, 0.0};
    Symmetric A, D{0.0, 0.0, 0.0, 0.0, 0.0, 0.0};

    Evaluation(const Cluster& cluster, const Vector& m, std::span<AroundMean> sightings)
        : A{0.0, 0.0, 0.0, 0.0, 0.0, cluster.filling()} {
        for (std::size_t k = 0; k < sightings.size(); ++k) {
            AroundMean& s = sightings[k];
            const Vector& y = cluster.places[k];
            s.e = {m.x - y.x, m.y - y.y, wrap(m.t - y.t)};
            const Vector p = s.W * s.e;
            const double trust = cluster.trust[k], squares = trust * dot(p, s.e);
            cost += cluster.kernel.loss(squares);
            const double w = s.factor = trust * cluster.kernel.weight(squares);
            b = {b.x - w * p.x, b.y - w * p.y, b.t - w * p.t};
            A = A + w * s.W;
            const double bend = 2 * trust * trust * cluster.kernel.weight_slope(squares);
            D = D + bend * Symmetric{p.x * p.x, p.x * p.y, p.y * p.y, p.x * p.t, p.y * p.t, p.t * p.t};
        }
    }
};

}  // namespace

double start_heading(const Cluster& cluster, std::span<const AroundMean> sightings) {
    const auto far = [](const Vector& y) { return std::abs(wrap(y.t)) > std::numbers::pi / 2; };
    if (std::none_of(cluster.places.begin(), cluster.places.end(), far)) return 0.0;
    double c = 0.0, s = 0.0;
    for (std::size_t k = 0; k < sightings.size(); ++k) {
        c += cluster.trust[k] * sightings[k].W.tt * std::cos(cluster.places[k].t);
        s += cluster.trust[k] * sightings[k].W.tt * std::sin(cluster.places[k].t);
    }
    return std::atan2(s, c);
}

// Re-weighting lowers the cost from anywhere, but near the minimum it may take thousands of steps. There Newton's method
// takes over, with H = A + D. A Newton step that raises the cost is replaced by re-weighting. Re-weighting itself can raise
// the cost only by wrapping a heading: W ties headings to positions, so that the cost jumps there. Where it has done so
// `most_raises` times, the steps go to and fro over a jump. They are then halved, and the lower side of the jump is the end.
Mean robust_mean(const Cluster& cluster, const Vector& start, std::span<AroundMean> sightings) {
    constexpr double infinite = std::numeric_limits<double>::infinity();
    Vector mean = start, back{0.0, 0.0, 0.0}, step{0.0, 0.0, 0.0};
    double best = infinite, size = infinite, scale = 1.0;
    bool newton = false, done = false;
    int raises = 0;
    for (int k = 0; k < most_steps; ++k) {
        const Vector m{mean.x + scale * step.x, mean.y + scale * step.y, mean.t + scale * step.t};
        const Evaluation at(cluster, m, sightings);
        if (done) break;
        const double smallest = 1e-14 * (1 + std::abs(m.x) + std::abs(m.y));
        const bool raised = !(at.cost <= best * (1 + 1e-13));
        raises += raised && !newton;
        if (raised && (newton || raises > most_raises)) {
            if (newton) {
                step = back, newton = false, size = infinite;
            } else {
                scale /= 2;
                done = scale * length(step) < smallest;
                if (done) step = {0.0, 0.0, 0.0};
            }
            continue;
        }
        best = at.cost, mean = m, scale = std::min(1.0, 2 * scale);
        step = back = inverse(at.A, true) * at.b;
        newton = false;
        if (cluster.kernel && dot(back, at.b) < near) {
            const Symmetric H = at.A + at.D, inverted = inverse(H, true);
            if (positive(H, inverted)) step = inverted * at.b, newton = true;
        }
        const double before = size;
        size = length(step);
        // below rounding, or stopped by it
        if (size < smallest || (newton && before <= size && size < 1e4 * smallest)) break;
    }
    return {mean, best};
}

}  // namespace vmslam::edges
