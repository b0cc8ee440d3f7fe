#include "vmslam/edges/polar.hpp"

#include "vmslam/edges/rotations.hpp"
#include "vmslam/edges/single_numbers.hpp"

namespace vmslam::edges {

// With the unit vector (c, s) from the sensor to the landmark at distance r and (p, q) = (-s, c) / r, the Jacobian is M B
// with the rows (c, s, 0), (p, q, 0) and (p, q, -1) of M for l, phi and psi. B is that of a pair edge: turning the pose is
// turning the landmark about it the other way, -[I, u; 0, 1] with u = (-dy, dx), d from pose to landmark.
double PolarEdges::accumulate(const State& state, System* system, std::span<const Index> pairs) const {
    const Sensor& sensor = seen_.sensor;
    double total = 0.0;
    Rotations axes(first_.size(), [&](std::size_t k) { return state.node(first_[k])[2]; });
    for (std::size_t k = 0; k < first_.size(); ++k) {
        const Index i = first_[k], j = second_[k];
        const double *const x = state.node(i), *const m = state.node(j);
        const Sighting& z = seen_.z[k];
        const Rotation robot = axes[k];
        const double dx = m[0] - x[0], dy = m[1] - x[1];
        const double sx = dx - robot.c * sensor.offset_x + robot.s * sensor.offset_y;
        const double sy = dy - robot.s * sensor.offset_x - robot.c * sensor.offset_y;
        const double r = std::sqrt(sx * sx + sy * sy), direction = std::atan2(sy, sx);
        // e = h(x, m) - z
        const double range = r - z.range, bearing = wrap(direction - x[2] - z.bearing);
        const double orientation = seen_.oriented ? wrap(direction - m[2] - z.orientation) : 0.0;
        double w_range = 1 / sensor.range_variance(seen_.noisy[k].range), w_bearing = 1 / sensor.bearing;
        double w_orientation = seen_.oriented ? 1 / sensor.orientation : 0.0;
        const double squares = seen_.trust[k] * (w_range * range * range + w_bearing * bearing * bearing +
                                                 w_orientation * orientation * orientation);
        total += seen_.kernel.loss(squares);
        if (!system) continue;
        const double weight = seen_.kernel.weight(squares), f = seen_.trust[k] * weight;
        w_range *= f, w_bearing *= f, w_orientation *= f;
        const double c = sx / r, s = sy / r, p = -s / r, q = c / r, across = w_bearing + w_orientation;
        Symmetric W{w_range * c * c + across * p * p,
                    w_range * c * s + across * p * q,
                    w_range * s * s + across * q * q,
                    -w_orientation * p,
                    -w_orientation * q,
                    w_orientation};
        const double turning = w_bearing * bearing + w_orientation * orientation;
        const Vector g{w_range * range * c + turning * p, w_range * range * s + turning * q, -w_orientation * orientation};
        if (system->curved)
            W = W + outer(2 * seen_.kernel.weight_slope(squares) / (weight * weight), g) +
                w_range * range * bent(Number::range, {c, s}, r) + turning * bent(Number::bearing, {p, q}, r);
        add_pair(*system, i, j, pairs[k], W, g, {-dy, dx}, {0.0, 0.0});
        if (system->curved) add_turning(*system, i, j, pairs[k], g, dx, dy);
    }
    return total;
}

std::unique_ptr<const Family> PolarEdges::among(std::span<const Index> number) const {
    auto out = std::make_unique<PolarEdges>(std::vector<Index>{}, std::vector<Index>{}, seen_.emptied());
    for (std::size_t k = 0; k < first_.size(); ++k) {
        const Index i = number[first_[k]], j = number[second_[k]];
        if (std::min(i, j) < 0) continue;
        out->first_.push_back(i);
        out->second_.push_back(j);
        out->seen_.add(seen_, k);
    }
    return out;
}

}  // namespace vmslam::edges
