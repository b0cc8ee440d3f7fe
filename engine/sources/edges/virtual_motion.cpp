#include "vmslam/edges/virtual_motion.hpp"

#include <numeric>

#include "vmslam/edges/rotations.hpp"

namespace vmslam::edges {
namespace {

/// The axes of the covariances, which gamma turns.
std::vector<Rotation> axes_of(std::span<const Placed> at) {
    std::vector<Rotation> axes(at.size());
    Rotations facing(at.size(), [&](std::size_t k) { return at[k].gamma; });
    for (std::size_t k = 0; k < at.size(); ++k) axes[k] = facing[k];
    return axes;
}

}  // namespace

VirtualMotionEdges::VirtualMotionEdges(ByLandmark seen, bool tempered, bool body)
    : LandmarkSightings(std::move(seen)), tempered_(tempered), body_(body) {
    for (Index g = 0; g < landmarks(); ++g) {
        const auto first = seen_.trust.begin() + starts_[g], last = seen_.trust.begin() + starts_[g + 1];
        weights_.push_back(tempered_ ? 2 / std::accumulate(first, last, 0.0) : 1.0);
    }
}

// Column by column of Omega: the system maps the rows of a column to blocks, so that no list of pairs is needed.
double VirtualMotionEdges::accumulate(const State& state, System* system, std::span<const Index>) const {
    const Covariance mode = !body_ ? Covariance::reference : seen_.oriented ? Covariance::landmark : Covariance::rotating;
    const std::vector<Placed> at = placed(state, mode);
    const std::vector<Rotation> axes = axes_of(at);
    std::vector<Index> slot_of(system ? system->size() : 0);
    double total = 0.0;
    for (Index j = 0; j <= last_node(); ++j) {
        if (from(j).empty()) continue;
        if (system) system->open(j, slot_of);
        for (const Index b : from(j)) {
            const Index g = groups_[b];
            const double weight = weights_[g] * seen_.trust[b];
            // rho of s r² with the width c sqrt(s) is s times rho of r² with the width c
            const Kernel kernel{seen_.kernel.kind, seen_.kernel.c * std::sqrt(weights_[g])};
            for (Index a = starts_[g]; a < b; ++a) {
                const Index i = nodes_[a];
                if (i == j) continue;
                const Vector e{at[b].y.x - at[a].y.x, at[b].y.y - at[a].y.y, wrap(at[b].y.t - at[a].y.t)};
                Symmetric W = weight * seen_.trust[a] * inverse(turned(axes[a], at[a].C + at[b].C), seen_.oriented);
                Vector omega_e = W * e;
                const double squares = dot(omega_e, e);
                if (kernel) {
                    total += kernel.loss(squares);
                    W = kernel.weight(squares) * W;
                    omega_e = W * e;
                } else {
                    total += squares;
                }
                if (!system) continue;
                Lever u = at[a].lever;
                if (body_) u = {u.x - e.y, u.y + e.x};
                add_pair(*system, i, j, slot_of[i], W, omega_e, u, at[b].lever);
            }
        }
    }
    return total;
}

// Without psi the information depends on the direction between the two poses.
bool VirtualMotionEdges::constant(const double* state, Index, ConstantEdges& out) const {
    if (!body_ || !seen_.oriented) return false;
    const std::vector<Placed> seen = from_robot(Covariance::landmark);
    const std::vector<Rotation> axes = axes_of(seen);
    for (std::size_t b = 0; b < seen.size(); ++b) {
        const Index g = groups_[b];
        const Kernel kernel{seen_.kernel.kind, seen_.kernel.c * std::sqrt(weights_[g])};
        for (std::size_t a = starts_[g]; a < b; ++a) {
            if (nodes_[a] == nodes_[b]) continue;
            const Vector &from_a = seen[a].y, &from_b = seen[b].y;
            // from the axes of the landmark to those of the first pose
            const Symmetric C = turned(axes[a], seen[a].C + seen[b].C);
            ConstantEdge edge{nodes_[a],
                              nodes_[b],
                              {from_a.x, from_a.y},
                              {from_b.x, from_b.y},
                              from_a.t - from_b.t,
                              true,
                              weights_[g] * seen_.trust[a] * seen_.trust[b] * inverse(C, true)};
            if (kernel) edge.information = kernel.weight(edge.squares(state)) * edge.information;
            out.edges.push_back(edge);
        }
    }
    return true;
}

}  // namespace vmslam::edges
