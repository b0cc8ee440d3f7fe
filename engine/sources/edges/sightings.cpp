#include "vmslam/edges/sightings.hpp"

#include <algorithm>
#include <numeric>

#include "vmslam/edges/rotations.hpp"

namespace vmslam::edges {

LandmarkSightings::LandmarkSightings(std::vector<Index> starts, std::vector<Index> nodes, Sightings sightings)
    : starts_(std::move(starts)),
      nodes_(std::move(nodes)),
      groups_(nodes_.size()),
      seen_(std::move(sightings)),
      order_(nodes_.size()) {
    for (Index g = 0; g < landmarks(); ++g) std::fill(groups_.begin() + starts_[g], groups_.begin() + starts_[g + 1], g);
    std::iota(order_.begin(), order_.end(), 0);
    std::stable_sort(order_.begin(), order_.end(), [&](Index a, Index b) { return nodes_[a] < nodes_[b]; });
    const Index last = nodes_.empty() ? -1 : *std::max_element(nodes_.begin(), nodes_.end());
    node_starts_.assign(last + 2, 0);
    for (const Index node : nodes_) ++node_starts_[node + 1];
    std::partial_sum(node_starts_.begin(), node_starts_.end(), node_starts_.begin());
}

std::vector<Placed> LandmarkSightings::placed(const State& state, Covariance mode) const {
    const Sensor& sensor = seen_.sensor;
    std::vector<Placed> out(nodes_.size());
    Rotations directions(out.size(), [&](std::size_t k) { return state.node(nodes_[k])[2] + seen_.z[k].bearing; });
    Rotations robots(out.size(), [&](std::size_t k) { return state.node(nodes_[k])[2]; });
    for (std::size_t k = 0; k < out.size(); ++k) {
        const double* const x = state.node(nodes_[k]);
        const Sighting &z = seen_.z[k], &noisy = seen_.noisy[k];
        const double direction = x[2] + z.bearing;
        Rotation along = directions[k];
        double vx = z.range * along.c, vy = z.range * along.s;
        if (sensor.offset_x != 0 || sensor.offset_y != 0) {
            const Rotation robot = robots[k];
            vx += robot.c * sensor.offset_x - robot.s * sensor.offset_y;
            vy += robot.s * sensor.offset_x + robot.c * sensor.offset_y;
        }
        Placed& p = out[k];
        p.lever = {-vy, vx};
        p.y = {x[0] + vx, x[1] + vy, seen_.oriented ? direction - z.orientation : 0.0};
        p.gamma = 0.0;
        if (mode == Covariance::landmark) {
            p.gamma = p.y.t;
            along = Rotation(noisy.orientation);
        } else {
            const double before = state.reference_of(nodes_[k])[2];
            if (mode == Covariance::rotating) p.gamma = x[2] - before;
            if (before != x[2] || noisy.bearing != z.bearing) along = Rotation(before + noisy.bearing);
        }
        p.C = landmark_covariance(sensor, noisy.range, along, seen_.oriented);
    }
    return out;
}

}  // namespace vmslam::edges
