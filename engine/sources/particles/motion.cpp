#include "vmslam/particles/motion.hpp"

#include "vmslam/particles/proposal.hpp"

namespace vmslam::particles {

using namespace numbers;

Pose driven(const Pose& x, const ControlMotion& u, const Lanes& c0, const Lanes& c1) {
    const Lanes half = (u.omega + u.omega_std * c1) * u.dt / 2.0;
    const Lanes sine = sincos(half).sine;
    const Lanes way = (u.nu + u.nu_std * c0) * u.dt * numbers::select(half != 0.0, Lanes(sine / half), 1.0);
    const auto [s, c] = sincos(Lanes(x.t + half));
    return {x.x + way * c, x.y + way * s, x.t + 2.0 * half};
}

Chord chord(double nu, double omega, double dt) {
    const double a = omega * dt / 2, q = a * a;
    const auto [sine, cosine] = sincos(a);
    // d/da (sin(a) / a): as a series, exact to rounding, where the difference would cancel
    const double slope = q < 0.09
                             ? a * polynomial(q, -1.0 / 3, 1.0 / 30, -1.0 / 840, 1.0 / 45360, -1.0 / 3991680, 1.0 / 518918400)
                             : (cosine - sine / a) / a;
    const double sinc = a != 0.0 ? sine / a : 1.0;
    return {a, {nu * dt * sinc, 0.0, 2 * a}, dt * sinc, nu * dt * dt / 2 * slope, nu * dt * dt / 2 * sinc, dt};
}

Symmetric Chord::covariance(double nu, double omega) const {
    return {by_nu * by_nu * nu + along * along * omega,
            along * across * omega,
            across * across * omega,
            along * turn * omega,
            across * turn * omega,
            turn * turn * omega};
}

Prediction predict(const Motion& motion, bool exact) {
    if (const auto* const whole = std::get_if<WholeMotion>(&motion.model))
        return {0.0, whole->mean, whole->covariance, exact ? lacking(whole->covariance) : 0.0};
    const auto& u = std::get<ControlMotion>(motion.model);
    const Chord f = chord(u.nu, u.omega, u.dt);
    const Symmetric AMA = f.covariance(u.nu_std * u.nu_std, u.omega_std * u.omega_std);
    return {f.angle, f.mean, AMA, exact ? widened(u.epsilon, AMA.xx + AMA.yy + AMA.tt) : u.epsilon};
}

// mean: moved in axes turned by `angle`; covariance: R A M A' R' + epsilon I
Gaussian Prediction::of(const Pose& x) const {
    const auto [s, c] = sincos(Lanes(x.t + angle));
    const Symmetric& P = covariance;
    return {x.x + c * mean.x - s * mean.y,
            x.y + s * mean.x + c * mean.y,
            wrap_angle(Lanes(x.t + mean.t)),
            c * c * P.xx - 2.0 * c * s * P.xy + s * s * P.yy + epsilon,
            c * s * (P.xx - P.yy) + (c * c - s * s) * P.xy,
            c * P.xt - s * P.yt,
            s * s * P.xx + 2.0 * c * s * P.xy + c * c * P.yy + epsilon,
            s * P.xt + c * P.yt,
            all<Lanes>(P.tt + epsilon)};
}

void move_poses(const Motion& motion, const Rows& starts, Rows& moved, std::size_t lo, std::size_t hi) {
    const auto each = [&](const auto& draw) {
        for (std::size_t i = lo; i < hi; i += lanes) write_pose(moved, i, draw(read_pose(starts, i), particles_of(i)));
    };
    if (const auto* const u = std::get_if<ControlMotion>(&motion.model)) {
        // x_t = f(x_{t-1}, u + std n_01) + sqrt(epsilon) n_234
        each([&motion, u, std = std::sqrt(u->epsilon)](const Pose& x, const Bits& particles) -> Pose {
            const auto [n0, n1, n2, n3, n4] = five_normals<Lanes>(motion.key, particles);
            const Pose there = driven(x, *u, n0, n1);
            return {there.x + std * n2, there.y + std * n3, wrap_angle(Lanes(there.t + std * n4))};
        });
        return;
    }
    // x_{t-1} moves, in its own axes, by mean + L n with L L' = covariance
    const auto& whole = std::get<WholeMotion>(motion.model);
    each([&motion, d = whole.mean, L = LowerRoot(whole.covariance, true)](const Pose& x, const Bits& particles) -> Pose {
        const auto [n0, n1] = normal_pair<Lanes>(motion.key, particles, 0);
        const Lanes n2 = normal_pair<Lanes>(motion.key, particles, 1).first;
        const Lanes ahead = d.x + L.xx * n0, left = d.y + L.yx * n0 + L.yy * n1;
        const auto [s, c] = sincos(x.t);
        return {x.x + c * ahead - s * left, x.y + s * ahead + c * left,
                wrap_angle(Lanes(x.t + d.t + L.tx * n0 + L.ty * n1 + L.tt * n2))};
    });
}

}  // namespace vmslam::particles
