#include "vmslam/log.hpp"

#include <algorithm>
#include <cmath>

namespace vmslam {

using edges::Rotation;
using edges::Symmetric;

particles::ControlMotion MotionNoise::of(const Control& u) const {
    const double way = std::abs(u.nu) / u.dt, turn = std::abs(u.omega) / u.dt;
    return {u.nu, u.omega, std::sqrt(nn * nn * way + no * no * turn), std::sqrt(on * on * way + oo * oo * turn),
            u.dt, epsilon};
}

Measured measured(const Control& u, const MotionNoise& noise) {
    const auto [angle, mean, P, epsilon] = particles::predict({noise.of(u), 0}, false);
    const Rotation chord(angle);
    const Symmetric covariance = turned(chord, {P.xx, P.xy, P.yy, P.xt, P.yt, P.tt}) + epsilon * Symmetric{1, 0, 1, 0, 0, 1};
    return {{chord.c * mean.x - chord.s * mean.y, chord.s * mean.x + chord.c * mean.y, mean.t}, inverse(covariance, true)};
}

Measured measured(const edges::Sighting& z, bool oriented, const edges::Sensor& sensor) {
    const Rotation along(z.bearing);
    return {{z.range * along.c, z.range * along.s, oriented ? z.bearing - z.orientation : 0.0},
            inverse(landmark_covariance(sensor, z.range, along, oriented), oriented)};
}

std::vector<double> dead_reckoning(const Log& log) {
    std::vector<double> poses(log.start.begin(), log.start.end());
    for (const Control& u : log.controls) {
        const double* const x = poses.data() + poses.size() - 3;
        const auto f = particles::chord(u.nu, u.omega, u.dt);
        const Rotation axes(x[2] + f.angle);
        poses.insert(poses.end(), {x[0] + axes.c * f.mean.x, x[1] + axes.s * f.mean.x, x[2] + f.mean.t});
    }
    return poses;
}

}  // namespace vmslam
