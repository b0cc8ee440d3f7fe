#include "vmslam/particles/kalman.hpp"

namespace vmslam::particles {

using namespace numbers;

namespace {

/// A particle nearer than this [m] stands on the landmark: the bearing is rounding error, and H = dh/dm is undefined.
constexpr double on_landmark = 1e-9;
/// The smallest normal number: a smaller det V has lost its digits.
constexpr double smallest = 2.3e-308;

/// -(squared + log det) / 2 - constant, or -inf where this is undefined.
Lanes log_density(const Lanes& squared, const Lanes& determinant, double constant, const Lanes& r) {
    const Lanes value = -0.5 * (squared + log(determinant)) - constant;
    const auto possible =
        (r >= on_landmark) & (determinant >= smallest) & (determinant < infinity) & (value > -infinity) & (value < infinity);
    return numbers::select(possible, value, -infinity);
}

/// The residual e of a sighting, V = L D L' and the columns w_k.
struct Innovation {
    Lanes e0, e1, e2, l10, l20, l21, d0, d1, d2;
    Pose w0, w1, w2;
};

/// The sum of y_k² / d_k with y = L^-1 e, and g_k = y_k / d_k.
struct Whitened {
    Lanes squared, g0, g1, g2;
};

template <int rows>
Whitened whiten(const Innovation& v) {
    const Lanes y1 = v.e1 - v.l10 * v.e0;
    const Lanes g0 = v.e0 * (1.0 / v.d0), g1 = y1 * (1.0 / v.d1);
    const Lanes squared = v.e0 * g0 + y1 * g1;
    if constexpr (rows == 2) return {squared, g0, g1, Lanes{}};
    const Lanes y2 = v.e2 - v.l20 * v.e0 - v.l21 * y1, g2 = y2 * (1.0 / v.d2);
    return {squared + y2 * g2, g0, g1, g2};
}

/// mean += w y / d, P -= w w' / d, with g = y / d; `coordinates` 2: without the heading.
template <int coordinates>
VMSLAM_INLINE void add_column(Gaussian& P, const Pose& w, const Lanes& g, const Lanes& d) {
    const Lanes i = 1.0 / d;
    P.x += w.x * g, P.y += w.y * g;
    P.xx -= w.x * w.x * i, P.xy -= w.x * w.y * i, P.yy -= w.y * w.y * i;
    if constexpr (coordinates == 2) return;
    P.h += w.t * g;
    P.xh -= w.x * w.t * i, P.yh -= w.y * w.t * i, P.hh -= w.t * w.t * i;
}

/// mean += sum of w_k y_k / d_k, P -= sum of w_k w_k' / d_k, for V of some rows.
template <int rows, int coordinates>
VMSLAM_INLINE Gaussian updated(Gaussian P, const Innovation& v, const Whitened& y) {
    add_column<coordinates>(P, v.w0, y.g0, v.d0);
    add_column<coordinates>(P, v.w1, y.g1, v.d1);
    if constexpr (rows == 3) add_column<coordinates>(P, v.w2, y.g2, v.d2);
    if constexpr (coordinates == 3) P.h = wrap_angle(P.h);
    return P;
}

/// log N(e; 0, V); r: distance between robot and landmark [m].
template <int rows>
Lanes likelihood(const Innovation& v, const Whitened& y, const Lanes& r) {
    const Lanes determinant = rows == 3 ? Lanes(v.d0 * v.d1 * v.d2) : Lanes(v.d0 * v.d1);
    return log_density(y.squared, determinant, 0.5 * rows * log_2pi, r);
}

/// Returns log N(e; 0, V) and updates the Gaussian.
template <int rows, int coordinates>
Lanes weigh_and_update(Gaussian& P, const Innovation& v, const Lanes& r) {
    const Whitened y = whiten<rows>(v);
    const Lanes value = likelihood<rows>(v, y, r);
    P = select(value > -infinity, updated<rows, coordinates>(P, v, y), P);
    return value;
}

/// Distance, and the unit vector u to the landmark.
struct Direction {
    Lanes r, inverse, ux, uy, angle;
    Direction(const Lanes& dx, const Lanes& dy)
        : r(root(Lanes(dx * dx + dy * dy))),
          inverse(1.0 / r),
          ux(dx * inverse),
          uy(dy * inverse),
          angle(numbers::atan2(dy, dx)) {}
};

// H is [[u_x, u_y, 0], [-u_y/r, u_x/r, 0], [-u_y/r, u_x/r, -1]]
template <bool oriented>
Lanes update_landmark_of(Gaussian& m, const Pose& pose, const Sighting& s, const Lanes& range_variance) {
    const Direction u(m.x - pose.x, m.y - pose.y);
    Innovation v;
    v.e0 = s.z.range - u.r;
    v.e1 = wrap_angle(Lanes(s.z.bearing - u.angle + pose.t));
    // the columns of S H'
    Pose &a = v.w0, &b = v.w1, &c = v.w2;
    a.x = m.xx * u.ux + m.xy * u.uy;
    a.y = m.xy * u.ux + m.yy * u.uy;
    b.x = (m.xy * u.ux - m.xx * u.uy) * u.inverse;
    b.y = (m.yy * u.ux - m.xy * u.uy) * u.inverse;
    if constexpr (oriented) {
        v.e2 = wrap_angle(Lanes(s.z.psi - u.angle + m.h));
        a.t = m.xh * u.ux + m.yh * u.uy;
        b.t = (m.yh * u.ux - m.xh * u.uy) * u.inverse;
        c = {b.x - m.xh, b.y - m.yh, b.t - m.hh};
    }
    // V = H S H' + Q = L D L', column by column
    v.d0 = u.ux * a.x + u.uy * a.y + range_variance;
    const Lanes i0 = 1.0 / v.d0;
    v.l10 = (u.ux * b.x + u.uy * b.y) * i0;
    if constexpr (oriented) {
        v.l20 = (u.ux * c.x + u.uy * c.y) * i0;
        b.t -= v.l10 * a.t;
        c = {c.x - v.l20 * a.x, c.y - v.l20 * a.y, c.t - v.l20 * a.t};
    }
    b.x -= v.l10 * a.x;
    b.y -= v.l10 * a.y;
    v.d1 = (u.ux * b.y - u.uy * b.x) * u.inverse + s.variances.bearing;
    if constexpr (!oriented) return weigh_and_update<2, 2>(m, v, u.r);
    v.l21 = (u.ux * c.y - u.uy * c.x) * u.inverse * (1.0 / v.d1);
    c = {c.x - v.l21 * b.x, c.y - v.l21 * b.y, c.t - v.l21 * b.t};
    v.d2 = (u.ux * c.y - u.uy * c.x) * u.inverse - c.t + s.variances.psi;
    return weigh_and_update<3, 3>(m, v, u.r);
}

// h depends on pose and landmark through m - x, theta and the landmark's heading, so V is made of their covariances
template <bool oriented>
Innovation pose_innovation(const Gaussian& P, const Gaussian& m, const Sighting& s, const Direction& u) {
    const Lanes vx = -u.uy * u.inverse, vy = u.ux * u.inverse;
    Innovation v;
    v.e0 = s.z.range - u.r;
    v.e1 = wrap_angle(Lanes(s.z.bearing - u.angle + P.h));
    // C = Cov(m - x), and the columns of P H_x'
    const Lanes cxx = P.xx + m.xx, cxy = P.xy + m.xy, cyy = P.yy + m.yy;
    Pose &a = v.w0, &b = v.w1;
    a = {-(P.xx * u.ux + P.xy * u.uy), -(P.xy * u.ux + P.yy * u.uy), -(P.xh * u.ux + P.yh * u.uy)};
    const Pose across{P.xx * vx + P.xy * vy, P.xy * vx + P.yy * vy, P.xh * vx + P.yh * vy};
    b = {-(across.x + P.xh), -(across.y + P.yh), -(across.t + P.hh)};
    // V, with Cov(m - x, theta) = -P_xt and Cov(m - x, h) = S_xh
    const Lanes fx = cxx * vx + cxy * vy, fy = cxy * vx + cyy * vy;
    // with v = d angle / d m: the variance of v' (m - x), and the parts of V from its covariances with theta, and with h
    // below
    const Lanes bearing = vx * fx + vy * fy, turned = vx * P.xh + vy * P.yh;
    v.d0 = u.ux * (cxx * u.ux + cxy * u.uy) + u.uy * (cxy * u.ux + cyy * u.uy) + s.variances.range;
    const Lanes v10 = u.ux * fx + u.uy * fy + u.ux * P.xh + u.uy * P.yh, i0 = 1.0 / v.d0;
    v.l10 = v10 * i0;
    v.d1 = bearing + 2.0 * turned + P.hh + s.variances.bearing - v.l10 * v10;
    b = {b.x - v.l10 * a.x, b.y - v.l10 * a.y, b.t - v.l10 * a.t};
    if constexpr (oriented) {
        v.e2 = wrap_angle(Lanes(s.z.psi - u.angle + m.h));
        const Lanes headed = vx * m.xh + vy * m.yh;
        const Lanes v20 = u.ux * fx + u.uy * fy - u.ux * m.xh - u.uy * m.yh, v21 = bearing + turned - headed;
        v.l20 = v20 * i0;
        v.l21 = (v21 - v.l20 * v10) * (1.0 / v.d1);
        v.d2 = bearing - 2.0 * headed + m.hh + s.variances.psi - v.l20 * v20 - v.l21 * v.l21 * v.d1;
        v.w2 = {-across.x - v.l20 * a.x - v.l21 * b.x, -across.y - v.l20 * a.y - v.l21 * b.y,
                -across.t - v.l20 * a.t - v.l21 * b.t};
    }
    return v;
}

/// The difference of two landmarks as a residual with H = I, V = S_a + S_b + diag(blur).
Innovation between(const Gaussian& a, const Gaussian& b, double blur_position, double blur_heading, bool oriented) {
    Innovation v;
    v.e0 = b.x - a.x, v.e1 = b.y - a.y;
    v.e2 = oriented ? wrap_angle(Lanes(b.h - a.h)) : Lanes{};
    const Lanes v10 = a.xy + b.xy, v20 = oriented ? Lanes(a.xh + b.xh) : Lanes{},
                v21 = oriented ? Lanes(a.yh + b.yh) : Lanes{};
    const Lanes v22 = oriented ? Lanes(a.hh + b.hh + blur_heading) : all<Lanes>(1.0);
    v.d0 = a.xx + b.xx + blur_position;
    v.l10 = v10 / v.d0, v.l20 = v20 / v.d0;
    v.d1 = a.yy + b.yy + blur_position - v.l10 * v10;
    v.l21 = (v21 - v.l20 * v10) / v.d1;
    v.d2 = v22 - v.l20 * v20 - v.l21 * v.l21 * v.d1;
    v.w0 = {a.xx, a.xy, a.xh};
    v.w1 = {a.xy - v.l10 * a.xx, a.yy - v.l10 * a.xy, a.yh - v.l10 * a.xh};
    v.w2 = {a.xh - v.l20 * a.xx - v.l21 * v.w1.x, a.yh - v.l20 * a.xy - v.l21 * v.w1.y, a.hh - v.l20 * a.xh - v.l21 * v.w1.t};
    return v;
}

}  // namespace

Lanes known_likelihood(const Pose& pose, const Vector& landmark, const Sighting& s, bool oriented) {
    const Lanes dx = landmark.x - pose.x, dy = landmark.y - pose.y, direction = numbers::atan2(dy, dx);
    const Lanes r = root(Lanes(dx * dx + dy * dy));
    const Lanes e0 = s.z.range - r, e1 = wrap_angle(Lanes(s.z.bearing - direction + pose.t));
    Lanes squared = e0 * e0 / s.variances.range + e1 * e1 / s.variances.bearing;
    double determinant = s.variances.range * s.variances.bearing;
    if (oriented) {
        const Lanes e2 = wrap_angle(Lanes(s.z.psi - direction + landmark.t));
        squared += e2 * e2 / s.variances.psi;
        determinant *= s.variances.psi;
    }
    return log_density(squared, all<Lanes>(determinant), (oriented ? 1.5 : 1.0) * log_2pi, r);
}

Gaussian landmark_from(const Pose& pose, const Sighting& sighting, double ahead, double along, double across,
                       double bearing) {
    const auto& [z, q] = sighting;
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

Gaussian initial_landmark(const Pose& pose, const Sighting& sighting) {
    const auto& [z, q] = sighting;
    return landmark_from(pose, sighting, z.range, q.range, z.range * z.range * q.bearing, z.range * q.bearing);
}

Lanes update_landmark(Gaussian& m, const Pose& pose, const Sighting& s, const Lanes& range_variance, bool oriented) {
    return oriented ? update_landmark_of<true>(m, pose, s, range_variance)
                    : update_landmark_of<false>(m, pose, s, range_variance);
}

Lanes update_pose(Gaussian& pose, const Gaussian& landmark, const Sighting& s, bool oriented) {
    const Direction u(landmark.x - pose.x, landmark.y - pose.y);
    return oriented ? weigh_and_update<3, 3>(pose, pose_innovation<true>(pose, landmark, s, u), u.r)
                    : weigh_and_update<2, 3>(pose, pose_innovation<false>(pose, landmark, s, u), u.r);
}

Lanes predicted_likelihood(const Gaussian& pose, const Gaussian& landmark, const Sighting& s, bool oriented) {
    const Direction u(landmark.x - pose.x, landmark.y - pose.y);
    const Innovation v =
        oriented ? pose_innovation<true>(pose, landmark, s, u) : pose_innovation<false>(pose, landmark, s, u);
    return oriented ? likelihood<3>(v, whiten<3>(v), u.r) : likelihood<2>(v, whiten<2>(v), u.r);
}

Lanes squared_distance(const Gaussian& a, const Gaussian& b, double blur_position, double blur_heading, bool oriented) {
    return whiten<3>(between(a, b, blur_position, blur_heading, oriented)).squared;
}

Gaussian fused(const Gaussian& a, const Gaussian& b, bool oriented) {
    const Innovation v = between(a, b, 0.0, 0.0, oriented);
    return oriented ? updated<3, 3>(a, v, whiten<3>(v)) : updated<2, 2>(a, v, whiten<2>(v));
}

Pose drawn(const Gaussian& P, const Lanes& n0, const Lanes& n1, const Lanes& n2) {
    const Lanes zero{};
    const Lanes l00 = root(larger(P.xx, zero)), i00 = numbers::select(l00 > 0.0, Lanes(1.0 / l00), 0.0);
    const Lanes l10 = P.xy * i00, l20 = P.xh * i00;
    const Lanes l11 = root(larger(Lanes(P.yy - l10 * l10), zero));
    const Lanes l21 = (P.yh - l20 * l10) * numbers::select(l11 > 0.0, Lanes(1.0 / l11), 0.0);
    const Lanes l22 = root(larger(Lanes(P.hh - l20 * l20 - l21 * l21), zero));
    return {P.x + l00 * n0, P.y + l10 * n0 + l11 * n1, wrap_angle(Lanes(P.h + l20 * n0 + l21 * n1 + l22 * n2))};
}

}  // namespace vmslam::particles
