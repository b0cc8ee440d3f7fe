#include "vmslam/edges/single_numbers.hpp"

#include "vmslam/edges/rotations.hpp"

namespace vmslam::edges {

double NumberEdges::accumulate(const State& state, System* system, std::span<const Index> pairs) const {
    double total = 0.0;
    Rotations axes_of(edges_.size(), [&](std::size_t k) { return state.node(edges_[k].i)[2]; });
    for (std::size_t k = 0; k < edges_.size(); ++k) {
        const auto& [i, j, z, omega, offset] = edges_[k];
        const double *const a = state.node(i), *const b = state.node(j);
        const Rotation axes = axes_of[k];
        const double dx = b[0] - a[0], dy = b[1] - a[1];
        const auto [e, n, distance] =
            number_seen(kind_, z, axes.c * dx + axes.s * dy - offset.x, axes.c * dy - axes.s * dx - offset.y);
        const double squares = omega * e * e, w = omega * kernel_.weight(squares);
        total += kernel_.loss(squares);
        if (!system) continue;
        const Lever world{axes.c * n.x - axes.s * n.y, axes.s * n.x + axes.c * n.y};
        const Vector g{w * e * world.x, w * e * world.y, 0.0};
        Symmetric W = along(w, world);
        if (system->curved)
            W = W + along(2 * omega * squares * kernel_.weight_slope(squares), world) + w * e * bent(kind_, world, distance);
        add_point(*system, i, j, pairs[k], W, g, {-dy, dx});
        if (system->curved) add_turning(*system, i, j, pairs[k], g, dx, dy);
    }
    return total;
}

std::vector<double> NumberEdges::squares(const double* state, std::span<const double>) const {
    std::vector<double> out;
    for (const auto& [i, j, z, omega, offset] : edges_) {
        const double *const a = state + 3 * i, *const b = state + 3 * j;
        const Vector seen = turned(Rotation(-a[2]), Vector{b[0] - a[0], b[1] - a[1], 0.0});
        const double e = number_seen(kind_, z, seen.x - offset.x, seen.y - offset.y).e;
        out.push_back(omega * e * e);
    }
    return out;
}

}  // namespace vmslam::edges
