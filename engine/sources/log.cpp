#include "vmslam/log.hpp"

#include <algorithm>
#include <cmath>

namespace vmslam {

using edges::Rotation;
using edges::Symmetric;

particles::ControlMotion MotionNoise::of(const Control& u) const {
    const double way = std::abs(u.nu) / u.dt, turn = std::abs(u.omega) / u.dt;
    return {u.nu,
            u.omega,
            std::sqrt(nn * nn * way + no * no * turn + sigma_v * sigma_v),
            std::sqrt(on * on * way + oo * oo * turn + sigma_omega * sigma_omega),
            u.dt,
            epsilon};
}

Measured measured(const Control& u, const MotionNoise& noise) { return measured(std::span(&u, 1), noise); }

Measured measured(std::span<const Control> controls, const MotionNoise& noise) {
    const auto [end, P] = moved(controls, noise);
    return {end, inverse(P, true)};
}

Moved moved(std::span<const Control> controls, const MotionNoise& noise) {
    edges::Vector end{};
    Symmetric P{};
    for (const Control& u : controls) {
        auto [angle, mean, each, epsilon] = particles::predict({noise.of(u), 0}, false);
        each.yy += noise.slip * noise.slip * std::abs(u.nu) * u.dt;
        const Rotation chord(end.t + angle);
        const edges::Vector d = turned(chord, mean);
        // F = [I, f; 0, 1], f the motion turned by a quarter
        const edges::Lever f{-d.y, d.x};
        P = Symmetric{P.xx + 2 * f.x * P.xt + f.x * f.x * P.tt,
                      P.xy + f.x * P.yt + f.y * P.xt + f.x * f.y * P.tt,
                      P.yy + 2 * f.y * P.yt + f.y * f.y * P.tt,
                      P.xt + f.x * P.tt,
                      P.yt + f.y * P.tt,
                      P.tt} +
            turned(chord, each);
        end = {end.x + d.x, end.y + d.y, end.t + d.t};
    }
    return {end, P + noise.epsilon * Symmetric{1, 0, 1, 0, 0, 1}};
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
