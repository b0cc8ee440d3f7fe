#include "vmslam/particles/joint.hpp"

#include <array>
#include <limits>

#include "moments.hpp"
#include "vmslam/particles/kalman.hpp"

namespace vmslam::particles {

using namespace numbers;

namespace {

/// Range and bearing of a position from a pose, and how far the sighting is off.
struct Offset {
    Lanes r2, r, direction, e0, e1;
    Offset(const Lanes& dx, const Lanes& dy, const Pose& pose, const Reading& z)
        : r2(dx * dx + dy * dy),
          r(root(r2)),
          direction(numbers::atan2(dy, dx)),
          e0(z.range - r),
          e1(wrap_angle(Lanes(z.bearing - direction + pose.t))) {}
};

/// The sightings of one landmark in a group of particles.
class Seen {
   public:
    Seen(std::span<const Pose> poses, std::span<const RatedSighting> sightings, const Lanes& heading, bool oriented)
        : poses_(poses), sightings_(sightings), heading_(heading), oriented_(oriented) {}

    Mode mode(Lanes x, Lanes y) const;
    /// The integrand over the density of the points, in logarithms without constants, at a position.
    Lanes log_density(const Lanes& x, const Lanes& y) const;
    /// -2 log of the constants of the integrand.
    double constant() const;
    /// The mean heading that the sightings give at a position, relative to `heading`, and its variance.
    Lanes mean_heading(const Lanes& x, const Lanes& y) const;
    double heading_variance() const;

   private:
    struct Normal;
    void add(Normal& sums, std::size_t k, const Lanes& x, const Lanes& y) const;
    Lanes headed(std::size_t k, const Lanes& direction) const {
        return wrap_angle(Lanes(direction - sightings_[k].sighting.z.psi - heading_));
    }

    std::span<const Pose> poses_;
    std::span<const RatedSighting> sightings_;
    Lanes heading_;
    bool oriented_;
};

/// The normal equations of a Gauss-Newton step for the position, and those of the heading, which is eliminated.
struct Seen::Normal {
    Lanes axx{}, axy{}, ayy{}, gx{}, gy{}, tx{}, ty{}, mean{};
    double total = 0.0;

    void eliminate_heading() {
        axx -= tx * tx / total, axy -= tx * ty / total, ayy -= ty * ty / total;
        gx += mean * tx / total, gy += mean * ty / total;
    }
};

void Seen::add(Normal& sums, std::size_t k, const Lanes& x, const Lanes& y) const {
    const auto& [z, q] = sightings_[k].sighting;
    const double rate = sightings_[k].rate;
    const Lanes dx = x - poses_[k].x, dy = y - poses_[k].y;
    const Offset o(dx, dy, poses_[k], z);
    const Lanes ux = dx / o.r, uy = dy / o.r, vx = -dy / o.r2, vy = dx / o.r2;
    const Lanes w0 = 1.0 / (q.range + rate * rate * o.r2);
    const double w1 = 1.0 / q.bearing;
    sums.axx += w0 * ux * ux + w1 * vx * vx;
    sums.axy += w0 * ux * uy + w1 * vx * vy;
    sums.ayy += w0 * uy * uy + w1 * vy * vy;
    sums.gx += ux * (w0 * o.e0) + vx * (w1 * o.e1);
    sums.gy += uy * (w0 * o.e0) + vy * (w1 * o.e1);
    if (!oriented_) return;
    const double w2 = 1.0 / q.psi;
    const Lanes e = headed(k, o.direction);
    sums.total += w2;
    sums.tx += w2 * vx, sums.ty += w2 * vy, sums.mean += w2 * e;
    sums.axx += w2 * vx * vx, sums.axy += w2 * vx * vy, sums.ayy += w2 * vy * vy;
    sums.gx -= w2 * e * vx, sums.gy -= w2 * e * vy;
}

Mode Seen::mode(Lanes x, Lanes y) const {
    constexpr int steps = 5;  // of Gauss-Newton, from the mean before the sighting to the mode
    for (int step = 0;; ++step) {
        Normal sums;
        for (std::size_t k = 0; k < sightings_.size(); ++k) add(sums, k, x, y);
        if (oriented_) sums.eliminate_heading();
        if (step == steps) return Mode(x, y, sums.axx, sums.axy, sums.ayy);
        const Lanes area = sums.axx * sums.ayy - sums.axy * sums.axy;
        x += (sums.ayy * sums.gx - sums.axy * sums.gy) / area;
        y += (sums.axx * sums.gy - sums.axy * sums.gx) / area;
    }
}

Lanes Seen::log_density(const Lanes& x, const Lanes& y) const {
    Lanes squared{}, mean{}, square{};
    double total = 0.0;
    for (std::size_t k = 0; k < sightings_.size(); ++k) {
        const auto& [z, q] = sightings_[k].sighting;
        const double rate = sightings_[k].rate;
        const Offset o(x - poses_[k].x, y - poses_[k].y, poses_[k], z);
        const Lanes variance = q.range + rate * rate * o.r2;
        squared += o.e0 * o.e0 / variance + o.e1 * o.e1 / q.bearing;
        if (rate > 0.0) squared += numbers::log(variance);
        if (!oriented_) continue;
        const Lanes e = headed(k, o.direction);
        total += 1.0 / q.psi;
        mean += 1.0 / q.psi * e, square += 1.0 / q.psi * e * e;
    }
    if (oriented_) squared += square - mean * mean / total + numbers::log(total) - log_2pi;
    return -0.5 * squared;
}

double Seen::constant() const {
    double sum = 0.0;
    for (const auto& [sighting, rate] : sightings_) {
        const Reading& q = sighting.variances;
        sum += (oriented_ ? 3.0 : 2.0) * log_2pi + numbers::log(q.bearing);
        if (oriented_) sum += numbers::log(q.psi);
        if (rate == 0.0) sum += numbers::log(q.range);
    }
    return sum;
}

Lanes Seen::mean_heading(const Lanes& x, const Lanes& y) const {
    Lanes mean{};
    if (!oriented_) return mean;
    for (std::size_t k = 0; k < sightings_.size(); ++k)
        mean += 1.0 / sightings_[k].sighting.variances.psi *
                headed(k, numbers::atan2(Lanes(y - poses_[k].y), Lanes(x - poses_[k].x)));
    return mean * heading_variance();
}

double Seen::heading_variance() const {
    double total = 0.0;
    for (const auto& rated : sightings_) total += 1.0 / rated.sighting.variances.psi;
    return oriented_ ? 1.0 / total : 0.0;
}

}  // namespace

Evidence joint_evidence(std::span<const Pose> poses, std::span<const RatedSighting> sightings, const Gaussian& about,
                        bool oriented) {
    const Seen seen(poses, sightings, about.h, oriented);
    const Mode mode = seen.mode(about.x, about.y);
    const double constant = seen.constant();
    // points in each direction, for the density of the standard normal distribution, and their weights
    constexpr int nodes = 5;
    static constexpr std::array<double, nodes> node{-2.8569700138728056, -1.355626179974266, 0.0, 1.355626179974266,
                                                    2.8569700138728056};
    static constexpr std::array<double, nodes> weight{0.011257411327720677, 0.22207592200561257, 0.5333333333333335,
                                                      0.22207592200561257, 0.011257411327720677};
    std::array<Lanes, nodes * nodes> values;
    Lanes top = all<Lanes>(-infinity);
    for (int p = 0; p < nodes * nodes; ++p) {
        const double n0 = node[p / nodes], n1 = node[p % nodes];
        // the points are those of the standard normal density, by which the integrand is divided
        const double points = 0.5 * (n0 * n0 + n1 * n1 - constant) + numbers::log(weight[p / nodes] * weight[p % nodes]);
        values[p] = seen.log_density(mode.x + mode.right(n0), mode.y + mode.up(n0, n1)) + points;
        top = larger(top, values[p]);
    }
    Moments sums;
    for (int p = 0; p < nodes * nodes; ++p) {
        const double n0 = node[p / nodes], n1 = node[p % nodes];
        const Lanes ex = mode.right(n0), ey = mode.up(n0, n1);
        sums.add(numbers::exp(Lanes(values[p] - top)), ex, ey, seen.mean_heading(mode.x + ex, mode.y + ey));
    }
    const Lanes value = numbers::log(sums.mass()) + top + numbers::log(Lanes(mode.l00 * mode.l11)) + log_2pi;
    const Gaussian landmark = sums.gaussian(mode, about.h, all<Lanes>(seen.heading_variance()));
    return {value, landmark, found(value, landmark)};
}

}  // namespace vmslam::particles
