#include "vmslam/edges/relative.hpp"

#include <algorithm>

#include "vmslam/edges/rotations.hpp"

namespace vmslam::edges {

template <bool poses, bool world>
double RelativeEdges::add(const State& state, System* system, std::span<const Index> pairs) const {
    double total = 0.0;
    Rotations axes_of(edges_.size(), [&](std::size_t k) { return state.node(edges_[k].i)[2]; });
    Rotations references(edges_.size(), [&](std::size_t k) { return state.reference_of(edges_[k].i)[2]; });
    for (std::size_t k = 0; k < edges_.size(); ++k) {
        const auto& [i, j, z, omega] = edges_[k];
        const double *const a = state.node(i), *const b = state.node(j);
        const Rotation axes = axes_of[k];
        // e in world axes: p_j - p_i - R t
        const double dx = b[0] - a[0], dy = b[1] - a[1];
        const double rx = axes.c * z.x - axes.s * z.y, ry = axes.s * z.x + axes.c * z.y;
        const Vector e{dx - rx, dy - ry, poses ? wrap(b[2] - a[2] - z.t) : 0.0};
        // Both frames have the Jacobians -[I, u; 0, 1] and [I, 0; 0, 1]: u is the derivative of the rotated measurement
        // (world: information held still) or of the offset itself (body: information turns along).
        const Lever u = world ? Lever{-ry, rx} : Lever{-dy, dx};
        Symmetric W = turned(world ? references[k] : axes, omega);
        Vector g = W * e;
        const double squares = dot(g, e);
        const bool curved = !world && system && system->curved;
        if (kernel_) {
            total += kernel_.loss(squares);
            W = kernel_.weight(squares) * W;
            if (curved) W = W + outer(2 * kernel_.weight_slope(squares), g);
            g = kernel_.weight(squares) * g;
        } else {
            total += squares;
        }
        if (!system) continue;
        if constexpr (poses)
            add_pair(*system, i, j, pairs[k], W, g, u, {0.0, 0.0});
        else
            add_point(*system, i, j, pairs[k], W, g, u);
        if (curved) add_turning(*system, i, j, pairs[k], g, dx, dy);
    }
    return total;
}

double RelativeEdges::accumulate(const State& state, System* system, std::span<const Index> pairs) const {
    if (poses_) return world_ ? add<true, true>(state, system, pairs) : add<true, false>(state, system, pairs);
    return world_ ? add<false, true>(state, system, pairs) : add<false, false>(state, system, pairs);
}

std::vector<HeadingRelation> RelativeEdges::headings() const {
    std::vector<HeadingRelation> out;
    if (!poses_) return out;
    out.reserve(edges_.size());
    for (const auto& [i, j, z, omega] : edges_) out.push_back({i, j, z.t, omega.tt});
    return out;
}

std::vector<PositionRelation> RelativeEdges::positions(const double* state) const {
    std::vector<PositionRelation> out;
    out.reserve(edges_.size());
    Rotations axes(edges_.size(), [&](std::size_t k) { return state[3 * edges_[k].i + 2]; });
    for (std::size_t k = 0; k < edges_.size(); ++k) {
        const auto& [i, j, z, omega] = edges_[k];
        const Rotation& r = axes[k];
        const Vector offset = turned(r, z);
        const Symmetric W = turned(r, omega);
        out.push_back({i, j, offset.x, offset.y, W.xx, W.xy, W.yy});
    }
    return out;
}

bool RelativeEdges::list(std::vector<ConstantEdge>& to) const {
    to.reserve(to.size() + edges_.size());
    for (const auto& [i, j, z, omega] : edges_) to.push_back({i, j, {z.x, z.y}, {}, z.t, poses_, omega});
    return true;
}

double PositionEdges::accumulate(const State& state, System* system, std::span<const Index>) const {
    double total = 0.0;
    for (const auto& [i, z, omega, lever] : edges_) {
        const double* const x = state.node(i);
        const Rotation axes(x[2]);
        const Lever arm{axes.c * lever.x - axes.s * lever.y, axes.s * lever.x + axes.c * lever.y}, v{-arm.y, arm.x};
        const Vector e{x[0] + arm.x - z.x, x[1] + arm.y - z.y, wrap(x[2] - z.t)};
        Vector g = omega * e;
        const double squares = dot(g, e), w = kernel_.weight(squares);
        total += kernel_.loss(squares);
        if (!system) continue;
        Symmetric W = w * omega;
        if (system->curved) W = W + outer(2 * kernel_.weight_slope(squares), g);
        g = w * g;
        add_block(system->diagonal(i), W, v);
        if (system->curved) system->diagonal(i)[8] -= g.x * arm.x + g.y * arm.y;
        add_gradient(system->xi + 3 * i, -1.0, g, v);
    }
    return total;
}

// A relative pose, or point, measured from the origin of the world.
bool PositionEdges::list(std::vector<ConstantEdge>& to) const {
    const bool oriented = std::any_of(edges_.begin(), edges_.end(), [](const Position& p) {
        return p.omega.tt != 0 || p.omega.xt != 0 || p.omega.yt != 0;
    });
    for (const auto& [i, z, omega, lever] : edges_)
        to.push_back({-1, i, {z.x, z.y}, {lever.x, lever.y}, z.t, oriented, omega});
    return true;
}

}  // namespace vmslam::edges
