#include "vmslam/particles/joint.hpp"

#include <array>
#include <optional>

#include "vmslam/particles/kalman.hpp"

namespace vmslam::particles {

using namespace numbers;

namespace {

/// Points of Gauss and Hermite for the density of the standard normal distribution, with their weights, and the steps of
/// Gauss-Newton to the mode about which they lie.
struct Rule {
    int count, steps;
    std::array<double, 5> node, weight;
};
constexpr Rule of_all{
    5,
    5,
    {-2.8569700138728056, -1.355626179974266, 0.0, 1.355626179974266, 2.8569700138728056},
    {0.011257411327720677, 0.22207592200561257, 0.5333333333333335, 0.22207592200561257, 0.011257411327720677}};
constexpr Rule of_one{3, 3, {-1.7320508075688772, 0.0, 1.7320508075688772}, {1.0 / 6, 2.0 / 3, 1.0 / 6}};

/// The mode of a density of positions, and L with L L' the inverse of its curvature (axx, axy; axy, ayy) there.
struct Mode {
    Lanes x, y, l00, l10, l11;
    Mode(const Lanes& mode_x, const Lanes& mode_y, const Lanes& axx, const Lanes& axy, const Lanes& ayy)
        : x(mode_x), y(mode_y) {
        const Lanes area = axx * ayy - axy * axy;
        l00 = root(Lanes(ayy / area));
        l10 = -axy / (area * l00);
        l11 = root(Lanes(axx / area - l10 * l10));
    }
};

/// Sums over points of w, w x, w y, ... for positions (x, y) relative to the mode and headings h relative to one before.
struct Moments {
    Lanes mass{}, x{}, y{}, h{}, xx{}, xy{}, yy{}, xh{}, yh{}, hh{};

    void add(const Lanes& w, const Lanes& dx, const Lanes& dy, const Lanes& dh) {
        mass += w, x += w * dx, y += w * dy, h += w * dh;
        xx += w * dx * dx, xy += w * dx * dy, yy += w * dy * dy, xh += w * dx * dh, yh += w * dy * dh, hh += w * dh * dh;
    }
    /// The Gaussian of the points; each has in its heading the variance `rest` beside.
    Gaussian gaussian(const Mode& about, const Lanes& heading, const Lanes& rest) const {
        const Lanes mx = x / mass, my = y / mass, mh = h / mass;
        return {about.x + mx,        about.y + my,        wrap_angle(Lanes(heading + mh)),
                xx / mass - mx * mx, xy / mass - mx * my, xh / mass - mx * mh,
                yy / mass - my * my, yh / mass - my * mh, hh / mass - mh * mh + rest};
    }
};

/// Whether the points found the posterior: a finite value, and a covariance.
Integers found(const Lanes& value, const Gaussian& g) {
    return (magnitude(value) < 1e300) & (g.xx > 0.0) & (g.xx * g.yy > g.xy * g.xy);
}

/// Range and bearing of a position from a pose, and how far the sighting is off.
struct Offset {
    Lanes dx, dy, r2, r, direction, e0, e1;
    Offset(const Lanes& x, const Lanes& y, const Pose& pose, const Reading& z)
        : dx(x - pose.x),
          dy(y - pose.y),
          r2(dx * dx + dy * dy),
          r(root(r2)),
          direction(numbers::atan2(dy, dx)),
          e0(z.range - r),
          e1(wrap_angle(Lanes(z.bearing - direction + pose.t))) {}
};

/// A Gaussian as the information on the position, and the heading given the position: mean h + B d, variance v.
struct Prior {
    const Gaussian& m;
    Lanes determinant, ixx, ixy, iyy, bx{}, by{}, v;

    Prior(const Gaussian& prior, bool oriented) : m(prior), v(all<Lanes>(1.0)) {
        determinant = m.xx * m.yy - m.xy * m.xy;
        ixx = m.yy / determinant, ixy = -m.xy / determinant, iyy = m.xx / determinant;
        if (!oriented) return;
        bx = ixx * m.xh + ixy * m.yh, by = ixy * m.xh + iyy * m.yh;
        v = m.hh - bx * m.xh - by * m.yh;
    }
};

/// The sightings of one landmark in a group of particles, and what was known of it before, if that is not nothing.
class Posterior {
   public:
    Posterior(std::span<const Pose> poses, std::span<const RatedSighting> sightings, const Gaussian* prior,
              const Lanes& heading, bool oriented)
        : poses_(poses), sightings_(sightings), heading_(heading), oriented_(oriented) {
        if (prior) prior_.emplace(*prior, oriented);
    }

    /// log of the integral, and its moments.
    Evidence evidence(Lanes x, Lanes y, const Rule& rule) const;

   private:
    struct Normal;
    struct Density;
    Mode mode(Lanes x, Lanes y, int steps) const;
    Density density(const Lanes& x, const Lanes& y) const;
    Lanes constant() const;
    Lanes headed(const Lanes& direction, const Reading& z) const { return wrap_angle(Lanes(direction - z.psi - heading_)); }
    /// The mean heading before, given the position.
    Lanes headed_before(const Lanes& x, const Lanes& y) const {
        const Prior& p = *prior_;
        return wrap_angle(Lanes(p.m.h - heading_ + p.bx * (x - p.m.x) + p.by * (y - p.m.y)));
    }

    std::span<const Pose> poses_;
    std::span<const RatedSighting> sightings_;
    Lanes heading_;
    bool oriented_;
    std::optional<Prior> prior_;
};

/// The normal equations of a Gauss-Newton step for the position, and those of the heading, which is eliminated.
struct Posterior::Normal {
    Lanes axx{}, axy{}, ayy{}, gx{}, gy{}, tx{}, ty{}, mean{}, total{};

    void add_heading(const Lanes& w, const Lanes& e, const Lanes& bx, const Lanes& by) {
        total += w, tx += w * bx, ty += w * by, mean += w * e;
        axx += w * bx * bx, axy += w * bx * by, ayy += w * by * by;
        gx -= w * e * bx, gy -= w * e * by;
    }
    void eliminate_heading() {
        axx -= tx * tx / total, axy -= tx * ty / total, ayy -= ty * ty / total;
        gx += mean * tx / total, gy += mean * ty / total;
    }
};

Mode Posterior::mode(Lanes x, Lanes y, int steps) const {
    for (int step = 0;; ++step) {
        Normal sums;
        if (prior_) {
            const Prior& p = *prior_;
            const Lanes ex = x - p.m.x, ey = y - p.m.y;
            sums.axx = p.ixx, sums.axy = p.ixy, sums.ayy = p.iyy;
            sums.gx = -p.ixx * ex - p.ixy * ey, sums.gy = -p.ixy * ex - p.iyy * ey;
            if (oriented_) sums.add_heading(1.0 / p.v, headed_before(x, y), p.bx, p.by);
        }
        for (std::size_t k = 0; k < sightings_.size(); ++k) {
            const auto& [sighting, rate] = sightings_[k];
            const auto& [z, q] = sighting;
            const Offset o(x, y, poses_[k], z);
            const Lanes ux = o.dx / o.r, uy = o.dy / o.r, vx = -o.dy / o.r2, vy = o.dx / o.r2;
            const Lanes w0 = 1.0 / (q.range + rate * rate * o.r2);
            const double w1 = 1.0 / q.bearing;
            sums.axx += w0 * ux * ux + w1 * vx * vx;
            sums.axy += w0 * ux * uy + w1 * vx * vy;
            sums.ayy += w0 * uy * uy + w1 * vy * vy;
            sums.gx += ux * (w0 * o.e0) + vx * (w1 * o.e1);
            sums.gy += uy * (w0 * o.e0) + vy * (w1 * o.e1);
            if (oriented_) sums.add_heading(all<Lanes>(1.0 / q.psi), headed(o.direction, z), vx, vy);
        }
        if (oriented_) sums.eliminate_heading();
        if (step == steps) return Mode(x, y, sums.axx, sums.axy, sums.ayy);
        const Lanes area = sums.axx * sums.ayy - sums.axy * sums.axy;
        x += (sums.ayy * sums.gx - sums.axy * sums.gy) / area;
        y += (sums.axx * sums.gy - sums.axy * sums.gx) / area;
    }
}

/// The integrand in logarithms without constants, at a position; and what is measured of the heading there, relative to
/// `heading_`: sums of w, w e and w e².
struct Posterior::Density {
    Lanes value{}, total{}, mean{}, square{};
    void add_heading(const Lanes& w, const Lanes& e) { total += w, mean += w * e, square += w * e * e; }
};

Posterior::Density Posterior::density(const Lanes& x, const Lanes& y) const {
    Density at;
    Lanes squared{};
    if (prior_) {
        const Lanes ex = x - prior_->m.x, ey = y - prior_->m.y;
        squared = prior_->ixx * ex * ex + 2.0 * prior_->ixy * ex * ey + prior_->iyy * ey * ey;
        if (oriented_) at.add_heading(1.0 / prior_->v, headed_before(x, y));
    }
    for (std::size_t k = 0; k < sightings_.size(); ++k) {
        const auto& [sighting, rate] = sightings_[k];
        const auto& [z, q] = sighting;
        const Offset o(x, y, poses_[k], z);
        const Lanes variance = q.range + rate * rate * o.r2;
        squared += o.e0 * o.e0 / variance + o.e1 * o.e1 / q.bearing;
        if (rate > 0.0) squared += numbers::log(variance);
        if (oriented_) at.add_heading(all<Lanes>(1.0 / q.psi), headed(o.direction, z));
    }
    if (oriented_) squared += at.square - at.mean * at.mean / at.total + numbers::log(at.total) - log_2pi;
    at.value = -0.5 * squared;
    return at;
}

/// -2 log of the constants of the integrand.
Lanes Posterior::constant() const {
    const double each = (oriented_ ? 3.0 : 2.0) * log_2pi;
    Lanes sum{};
    if (prior_) sum += each + numbers::log(oriented_ ? Lanes(prior_->determinant * prior_->v) : prior_->determinant);
    for (const auto& [sighting, rate] : sightings_) {
        const Reading& q = sighting.variances;
        sum += each + numbers::log(q.bearing);
        if (oriented_) sum += numbers::log(q.psi);
        if (rate == 0.0) sum += numbers::log(q.range);
    }
    return sum;
}

Evidence Posterior::evidence(Lanes x, Lanes y, const Rule& rule) const {
    const Mode mode = this->mode(x, y, rule.steps);
    const Lanes constants = constant();
    struct Point {
        Lanes x, y, heading, value;
    };
    std::array<Point, 25> points;
    const std::span used(points.data(), rule.count * rule.count);
    Lanes top = all<Lanes>(-infinity), rest{};
    for (std::size_t p = 0; p < used.size(); ++p) {
        const double n0 = rule.node[p / rule.count], n1 = rule.node[p % rule.count];
        const double log_weight = numbers::log(rule.weight[p / rule.count] * rule.weight[p % rule.count]);
        const Lanes ex = mode.l00 * n0, ey = mode.l10 * n0 + mode.l11 * n1;
        const Density at = density(mode.x + ex, mode.y + ey);
        // the points are those of the standard normal density, by which the integrand is divided
        const double over_normal = 0.5 * (n0 * n0 + n1 * n1) + log_weight;
        used[p] = {ex, ey, oriented_ ? Lanes(at.mean / at.total) : Lanes{}, at.value + over_normal - 0.5 * constants};
        if (oriented_) rest = 1.0 / at.total;
        top = larger(top, used[p].value);
    }
    Moments sums;
    for (const Point& p : used) sums.add(numbers::exp(Lanes(p.value - top)), p.x, p.y, p.heading);
    const Lanes value = numbers::log(sums.mass) + top + numbers::log(Lanes(mode.l00 * mode.l11)) + log_2pi;
    const Gaussian landmark = sums.gaussian(mode, heading_, rest);
    return {value, landmark, found(value, landmark)};
}

}  // namespace

Gaussian initial_moments(const Pose& pose, const Sighting& sighting) {
    const auto& [z, q] = sighting;
    const double square = z.range * z.range + 3 * q.range;
    const double shrink = numbers::exp(-0.5 * q.bearing), twice = numbers::exp(-2 * q.bearing);
    const double ahead = (z.range + q.range / z.range) * shrink;
    const double along = 0.5 * square * (1 + twice) - ahead * ahead, across = 0.5 * square * (1 - twice);
    return landmark_from(pose, sighting, ahead, along, across, ahead * q.bearing);
}

Evidence joint_evidence(std::span<const Pose> poses, std::span<const RatedSighting> sightings, const Gaussian& about,
                        bool oriented) {
    return Posterior(poses, sightings, nullptr, about.h, oriented).evidence(about.x, about.y, of_all);
}

Evidence single_evidence(const Gaussian& prior, const Gaussian& about, const Pose& pose, const RatedSighting& sighting,
                         bool oriented) {
    return Posterior({&pose, 1}, {&sighting, 1}, &prior, about.h, oriented).evidence(about.x, about.y, of_one);
}

}  // namespace vmslam::particles
