// One sighting of one landmark beyond linearisation: in closed form for the first one, by quadrature for a later one.
#include <array>
#include <limits>

#include "moments.hpp"
#include "vmslam/particles/joint.hpp"
#include "vmslam/particles/kalman.hpp"

namespace vmslam::particles {

using namespace numbers;

namespace {

/// Three points of Gauss and Hermite, and their weights.
constexpr std::array<double, 3> node{-1.7320508075688772, 0.0, 1.7320508075688772}, weight{1.0 / 6, 2.0 / 3, 1.0 / 6};
/// Gauss-Newton steps from the Kalman update to the mode, about which the points lie.
constexpr int steps = 3;

/// The prior of a landmark as that of its position, and of its heading given the position: mean h + B d, variance v.
struct Prior {
    const Gaussian& m;
    bool oriented;
    Lanes determinant, ixx, ixy, iyy, bx{}, by{}, v;

    Prior(const Gaussian& prior, bool with_heading) : m(prior), oriented(with_heading) {
        determinant = m.xx * m.yy - m.xy * m.xy;
        ixx = m.yy / determinant, ixy = -m.xy / determinant, iyy = m.xx / determinant;
        v = all<Lanes>(1.0);
        if (!oriented) return;
        bx = ixx * m.xh + ixy * m.yh, by = ixy * m.xh + iyy * m.yh;
        v = m.hh - bx * m.xh - by * m.yh;
    }
};

/// Prior and sighting at a position.
struct At {
    Lanes ex, ey, dx, dy, r2, r, direction, e0, e1, e2;
    At(const Prior& prior, const Lanes& x, const Lanes& y, const Pose& pose, const Reading& z)
        : ex(x - prior.m.x),
          ey(y - prior.m.y),
          dx(x - pose.x),
          dy(y - pose.y),
          r2(dx * dx + dy * dy),
          r(root(r2)),
          direction(numbers::atan2(dy, dx)),
          e0(z.range - r),
          e1(wrap_angle(Lanes(z.bearing - direction + pose.t))),
          e2{} {
        if (prior.oriented) e2 = wrap_angle(Lanes(z.psi - direction + prior.m.h + prior.bx * ex + prior.by * ey));
    }
};

Mode mode_of(const Prior& prior, Lanes x, Lanes y, const Pose& pose, const RatedSighting& rated) {
    const auto& [z, q] = rated.sighting;
    const double rate = rated.rate, w1 = 1.0 / q.bearing;
    const Lanes w2 = prior.oriented ? Lanes(1.0 / (prior.v + q.psi)) : Lanes{};
    for (int step = 0;; ++step) {
        const At at(prior, x, y, pose, z);
        const Lanes ux = at.dx / at.r, uy = at.dy / at.r, vx = -at.dy / at.r2, vy = at.dx / at.r2;
        const Lanes wx = vx - prior.bx, wy = vy - prior.by, w0 = 1.0 / (q.range + rate * rate * at.r2);
        const Lanes axx = prior.ixx + w0 * ux * ux + w1 * vx * vx + w2 * wx * wx;
        const Lanes axy = prior.ixy + w0 * ux * uy + w1 * vx * vy + w2 * wx * wy;
        const Lanes ayy = prior.iyy + w0 * uy * uy + w1 * vy * vy + w2 * wy * wy;
        if (step == steps) return Mode(x, y, axx, axy, ayy);
        const Lanes g0 = w0 * at.e0, g1 = w1 * at.e1, g2 = w2 * at.e2;
        const Lanes gx = ux * g0 + vx * g1 + wx * g2 - prior.ixx * at.ex - prior.ixy * at.ey;
        const Lanes gy = uy * g0 + vy * g1 + wy * g2 - prior.ixy * at.ex - prior.iyy * at.ey;
        const Lanes area = axx * ayy - axy * axy;
        x += (ayy * gx - axy * gy) / area;
        y += (axx * gy - axy * gx) / area;
    }
}

}  // namespace

Gaussian initial_moments(const Pose& pose, const Sighting& sighting) {
    const auto& [z, q] = sighting;
    const double square = z.range * z.range + 3 * q.range;
    const double shrink = numbers::exp(-0.5 * q.bearing), twice = numbers::exp(-2 * q.bearing);
    const double ahead = (z.range + q.range / z.range) * shrink;
    const double along = 0.5 * square * (1 + twice) - ahead * ahead, across = 0.5 * square * (1 - twice);
    const double bearing = ahead * q.bearing;
    const auto [s, c] = sincos(Lanes(pose.t + z.bearing));
    return {pose.x + ahead * c,
            pose.y + ahead * s,
            wrap_angle(Lanes(pose.t + z.bearing - z.psi)),
            c * c * along + s * s * across,
            c * s * (along - across),
            -s * bearing,
            s * s * along + c * c * across,
            c * bearing,
            all<Lanes>(q.bearing + q.psi)};
}

Evidence single_evidence(const Gaussian& before, const Gaussian& about, const Pose& pose, const RatedSighting& rated,
                         bool oriented) {
    const auto& [z, q] = rated.sighting;
    const Prior prior(before, oriented);
    const Lanes total = prior.v + q.psi, gain = oriented ? Lanes(prior.v / total) : Lanes{};
    const Mode mode = mode_of(prior, about.x, about.y, pose, rated);
    std::array<Lanes, 9> values, headings;
    Lanes top = all<Lanes>(-std::numeric_limits<double>::infinity());
    for (int p = 0; p < 9; ++p) {
        const double n0 = node[p / 3], n1 = node[p % 3];
        const At at(prior, mode.x + mode.right(n0), mode.y + mode.up(n0, n1), pose, z);
        const Lanes variance = q.range + rated.rate * rated.rate * at.r2;
        const Lanes of_prior = prior.ixx * at.ex * at.ex + 2.0 * prior.ixy * at.ex * at.ey + prior.iyy * at.ey * at.ey;
        const Lanes squared = of_prior + at.e0 * at.e0 / variance + at.e1 * at.e1 / q.bearing + at.e2 * at.e2 / total +
                              numbers::log(variance) - (n0 * n0 + n1 * n1);
        values[p] = -0.5 * squared + numbers::log(weight[p / 3] * weight[p % 3]);
        // relative to the prior's mean, in which the sighting of the heading is linear
        headings[p] = prior.bx * at.ex + prior.by * at.ey - gain * at.e2;
        top = larger(top, values[p]);
    }
    Moments sums;
    for (int p = 0; p < 9; ++p) {
        const double n0 = node[p / 3], n1 = node[p % 3];
        sums.add(numbers::exp(Lanes(values[p] - top)), mode.right(n0), mode.up(n0, n1), headings[p]);
    }
    Lanes value = numbers::log(sums.mass()) + top + numbers::log(Lanes(mode.l00 * mode.l11)) -
                  0.5 * numbers::log(Lanes(prior.determinant * q.bearing * total)) - (oriented ? 1.5 : 1.0) * log_2pi;
    if (!oriented) value += 0.5 * numbers::log(total);
    const Gaussian landmark = sums.gaussian(mode, before.h, Lanes((1.0 - gain) * prior.v));
    return {value, landmark, found(value, landmark)};
}

}  // namespace vmslam::particles
