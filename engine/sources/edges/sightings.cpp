#include "vmslam/edges/sightings.hpp"

#include <algorithm>

#include "vmslam/edges/rotations.hpp"

namespace vmslam::edges {

LandmarkSightings::LandmarkSightings(ByLandmark seen)
    : starts_(std::move(seen.starts)),
      nodes_(std::move(seen.nodes)),
      groups_(nodes_.size()),
      seen_(std::move(seen.sightings)) {
    for (Index g = 0; g < landmarks(); ++g) std::fill(groups_.begin() + starts_[g], groups_.begin() + starts_[g + 1], g);
    const Index last = nodes_.empty() ? -1 : *std::max_element(nodes_.begin(), nodes_.end());
    by_node_ = sparse::Sorted(last + 1, static_cast<Index>(nodes_.size()), [&](Index k) { return nodes_[k]; });
}

void Sightings::add(const Sightings& from, std::size_t k) {
    z.push_back(from.z[k]);
    noisy.push_back(from.noisy[k]);
    trust.push_back(from.trust[k]);
}

ByLandmark LandmarkSightings::from_nodes(std::span<const Index> number) const {
    ByLandmark out{{0}, {}, seen_.emptied()};
    for (Index g = 0; g < landmarks(); ++g) {
        for (Index k = starts_[g]; k < starts_[g + 1]; ++k) {
            if (number[nodes_[k]] < 0) continue;
            out.nodes.push_back(number[nodes_[k]]);
            out.sightings.add(seen_, k);
        }
        const auto end = static_cast<Index>(out.nodes.size());
        if (end > out.starts.back()) out.starts.push_back(end);
    }
    return out;
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

std::vector<Placed> LandmarkSightings::from_robot(Covariance mode) const {
    const std::vector<double> origin(3 * (last_node() + 1), 0.0);
    return placed({origin.data(), origin.data()}, mode);
}

// Sightings of a landmark that follow each other are enough: a landmark of K sightings has K (K - 1) / 2 pairs.
template <class Use>
void LandmarkSightings::for_consecutive(Use use) const {
    for (std::size_t b = 1; b < nodes_.size(); ++b)
        if (groups_[b] == groups_[b - 1] && nodes_[b] != nodes_[b - 1]) use(b - 1, b);
}

std::vector<HeadingRelation> LandmarkSightings::headings() const {
    std::vector<HeadingRelation> out;
    if (!seen_.oriented) return out;
    // theta + phi - psi is the landmark's heading
    const auto facing = [&](std::size_t k) { return seen_.z[k].bearing - seen_.z[k].orientation; };
    const double information = 0.5 / (seen_.sensor.bearing + seen_.sensor.orientation);
    for_consecutive(
        [&](std::size_t a, std::size_t b) { out.push_back({nodes_[a], nodes_[b], facing(a) - facing(b), information}); });
    return out;
}

std::vector<PositionRelation> LandmarkSightings::positions(const double* state) const {
    std::vector<PositionRelation> out;
    const std::vector<Placed> at = placed({state, state}, Covariance::reference);
    for_consecutive([&](std::size_t a, std::size_t b) {
        // the lever is the way to the landmark, turned by a quarter
        const Lever &u = at[a].lever, &v = at[b].lever;
        const Symmetric W = inverse(at[a].C + at[b].C, false);
        out.push_back({nodes_[a], nodes_[b], u.y - v.y, v.x - u.x, W.xx, W.xy, W.yy});
    });
    return out;
}

}  // namespace vmslam::edges
