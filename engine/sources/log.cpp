#include "vmslam/log.hpp"

#include <cmath>

namespace vmslam {

using edges::Rotation;
using edges::Symmetric;
using edges::Vector;

ControlVariances MotionNoise::variances(const Control& u) const {
    const double way = std::abs(u.nu) / u.dt, turn = std::abs(u.omega) / u.dt;
    return {nn * nn * way + no * no * turn + sigma_v * sigma_v, on * on * way + oo * oo * turn + sigma_omega * sigma_omega,
            slip * slip * std::abs(u.nu) * u.dt};
}

particles::ControlMotion MotionNoise::of(const Control& u) const {
    const ControlVariances M = variances(u);
    return {u.nu, u.omega, std::sqrt(M.nu), std::sqrt(M.omega), u.dt, epsilon};
}

Measured measured(const Control& u, const MotionNoise& noise) { return measured(std::span(&u, 1), noise); }

Measured measured(std::span<const Control> controls, const MotionNoise& noise) {
    const auto [end, P] = moved(controls, noise);
    return {end, inverse(P, true)};
}

Moved moved(std::span<const Control> controls, const MotionNoise& noise) {
    std::vector<ControlVariances> variances;
    for (const Control& u : controls) variances.push_back(noise.variances(u));
    auto [end, P] = moved(controls, variances);
    return {end, P + noise.epsilon * Symmetric{1, 0, 1, 0, 0, 1}};
}

Moved moved(std::span<const Control> controls, std::span<const ControlVariances> variances) {
    Vector end{};
    Symmetric P{};
    for (std::size_t k = 0; k < controls.size(); ++k) {
        const particles::Chord f = particles::chord(controls[k].nu, controls[k].omega, controls[k].dt);
        const auto [nu, omega, sideways] = variances[k];
        const Rotation axes(end.t + f.angle);
        const Vector d = turned(axes, f.mean);
        const Symmetric AMA_S = f.covariance(nu, omega) + Symmetric{0, 0, sideways, 0, 0, 0};
        // F = [I, (-d.y, d.x); 0, 1]
        const edges::Lever lever{-d.y, d.x};
        P = Symmetric{P.xx + 2 * lever.x * P.xt + lever.x * lever.x * P.tt,
                      P.xy + lever.x * P.yt + lever.y * P.xt + lever.x * lever.y * P.tt,
                      P.yy + 2 * lever.y * P.yt + lever.y * lever.y * P.tt,
                      P.xt + lever.x * P.tt,
                      P.yt + lever.y * P.tt,
                      P.tt} +
            turned(axes, AMA_S);
        end = end + d;
    }
    return {end, P};
}

Vector slopes(std::span<const Control> controls, std::span<ControlSlope> by_control) {
    Vector end{};
    std::vector<Vector> reached;
    for (std::size_t k = 0; k < controls.size(); ++k) {
        const particles::Chord f = particles::chord(controls[k].nu, controls[k].omega, controls[k].dt);
        const Rotation axes(end.t + f.angle);
        by_control[k] = {{axes.c * f.by_nu, axes.c * f.along - axes.s * f.across},
                         {axes.s * f.by_nu, axes.s * f.along + axes.c * f.across},
                         {0.0, f.turn}};
        end = end + turned(axes, f.mean);
        reached.push_back(end);
    }
    // a turn also moves what follows
    for (std::size_t k = 0; k < controls.size(); ++k) {
        by_control[k].x[1] -= (end.y - reached[k].y) * by_control[k].t[1];
        by_control[k].y[1] += (end.x - reached[k].x) * by_control[k].t[1];
    }
    return end;
}

Measured measured(const edges::Sighting& z, bool oriented, const edges::Sensor& sensor) {
    const Rotation along(z.bearing);
    return {{z.range * along.c, z.range * along.s, oriented ? z.bearing - z.orientation : 0.0},
            inverse(landmark_covariance(sensor, z.range, along, oriented), oriented)};
}

std::vector<double> dead_reckoning(const Log& log) {
    std::vector<double> poses(log.start.begin(), log.start.end());
    std::array<double, 3> x = log.start;
    for (std::size_t t = 0; t + 1 < log.poses(); ++t) {
        for (const Control& u : log.motion(t)) {
            const auto f = particles::chord(u.nu, u.omega, u.dt);
            const Rotation axes(x[2] + f.angle);
            x = {x[0] + axes.c * f.mean.x, x[1] + axes.s * f.mean.x, x[2] + f.mean.t};
        }
        poses.insert(poses.end(), x.begin(), x.end());
    }
    return poses;
}

}  // namespace vmslam
