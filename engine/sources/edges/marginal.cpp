#include "vmslam/edges/marginal.hpp"

#include "robust_mean.hpp"

namespace vmslam::edges {
namespace {

/// The plain mean, in one pass over the sightings; fills their e. `wrapped` where a heading wraps on the way.
struct PlainMean {
    Vector at;
    double cost = 0.0;
    bool wrapped = false;

    PlainMean(const Cluster& cluster, std::span<AroundMean> sightings) {
        const double begin = cluster.oriented ? start_heading(cluster, sightings) : 0.0;
        Symmetric S{0.0, 0.0, 0.0, 0.0, 0.0, cluster.filling()};
        Vector b{0.0, 0.0, 0.0};
        for (std::size_t k = 0; k < sightings.size(); ++k) {
            const Vector d{cluster.places[k].x, cluster.places[k].y, wrap(cluster.places[k].t - begin)};
            sightings[k].e.t = d.t;
            const Symmetric weighted = cluster.trust[k] * sightings[k].W;
            S = S + weighted;
            const Vector pull = weighted * d;
            b = {b.x + pull.x, b.y + pull.y, b.t + pull.t};
        }
        const Vector m = inverse(S, true) * b;
        at = {m.x, m.y, begin + m.t};
        for (std::size_t k = 0; k < sightings.size(); ++k) {
            Vector& e = sightings[k].e;
            e = {m.x - cluster.places[k].x, m.y - cluster.places[k].y, m.t - e.t};
            wrapped = wrapped || std::abs(e.t) > std::numbers::pi;
            cost += cluster.trust[k] * dot(sightings[k].W * e, e);
        }
    }
};

/// A block of three rows.
using Block = double[9];

/// block -= A B'
void subtract_product(double* block, const Block& A, const Block& B) {
    for (int r = 0; r < 3; ++r)
        for (int c = 0; c < 3; ++c)
            block[3 * r + c] -= A[3 * r] * B[3 * c] + A[3 * r + 1] * B[3 * c + 1] + A[3 * r + 2] * B[3 * c + 2];
}

/// V = U L^-T with L L' = S and U = B' W, so that the block between two sightings is -V_a V_b'.
void divide(const LowerRoot& L, const Symmetric& W, const Lever& t, Block& V) {
    // the rows of U without its sign: the first two of W, and t' W + the third
    const Vector rows[3] = {{W.xx, W.xy, W.xt}, {W.xy, W.yy, W.yt}, W * Vector{t.x, t.y, 1.0}};
    for (int r = 0; r < 3; ++r) {
        const Vector v = L.whitened(rows[r]);
        V[3 * r] = v.x, V[3 * r + 1] = v.y, V[3 * r + 2] = v.t;
    }
}

}  // namespace

AroundMeans MarginalEdges::around_means(const State& state, std::span<const double> trust) const {
    const State at{state.at, body_ ? state.at : state.reference};
    const std::vector<Placed> places = placed(at, Covariance::reference);
    AroundMeans out{std::vector<AroundMean>(places.size()), std::vector<Vector>(landmarks())};
    for (std::size_t k = 0; k < places.size(); ++k)
        out.sightings[k] = {{}, inverse(places[k].C, seen_.oriented), trust[k], places[k].lever};
    std::vector<Vector> relative;
    for (Index g = 0; g < landmarks(); ++g) {
        const Index first = starts_[g], count = starts_[g + 1] - first;
        // positions and headings as differences from the first sighting's: no cancellation
        const Vector origin = count ? places[first].y : Vector{};
        relative.clear();
        for (Index k = first; k < first + count; ++k)
            relative.push_back({places[k].y.x - origin.x, places[k].y.y - origin.y, places[k].y.t - origin.t});
        const Cluster cluster{relative, trust.subspan(first, count), seen_.kernel, seen_.oriented};
        const std::span<AroundMean> sightings = std::span(out.sightings).subspan(first, count);
        const PlainMean plain(cluster, sightings);
        Mean mean{plain.at, plain.cost};
        if (seen_.kernel || plain.wrapped) mean = robust_mean(cluster, plain.at, sightings);
        out.cost += mean.cost;
        out.means[g] = {origin.x + mean.at.x, origin.y + mean.at.y, wrap(origin.t + mean.at.t)};
    }
    return out;
}

std::vector<double> MarginalEdges::squares(const double* state, std::span<const double> trust) const {
    std::vector<double> out;
    for (const AroundMean& s : around_means({state, state}, trust).sightings) out.push_back(dot(s.W * s.e, s.e));
    return out;
}

double MarginalEdges::accumulate(const State& state, System* system, std::span<const Index>) const {
    AroundMeans around = around_means(state);
    if (!system) return around.cost;
    struct Sized {
        Block V;
    };
    std::vector<Sized> roots(around.sightings.size());
    for (Index g = 0; g < landmarks(); ++g) {
        Symmetric S{0.0, 0.0, 0.0, 0.0, 0.0, seen_.oriented ? 0.0 : 1.0};
        for (Index k = starts_[g]; k < starts_[g + 1]; ++k) {
            AroundMean& s = around.sightings[k];
            s.W = s.factor * s.W;
            if (body_) s.lever = {s.lever.x - s.e.y, s.lever.y + s.e.x};
            S = S + s.W;
        }
        const LowerRoot L(S);
        for (Index k = starts_[g]; k < starts_[g + 1]; ++k)
            divide(L, around.sightings[k].W, around.sightings[k].lever, roots[k].V);
    }
    std::vector<Index> slot_of(system->size());
    for (Index j = 0; j <= last_node(); ++j) {
        if (from(j).empty()) continue;
        system->open(j, slot_of);
        double* const diagonal = system->diagonal(j);
        for (const Index b : from(j)) {
            const AroundMean& s = around.sightings[b];
            add_block(diagonal, s.W, s.lever);
            add_gradient(system->xi + 3 * j, 1.0, s.W * s.e, s.lever);
            for (Index a = starts_[groups_[b]]; a <= b; ++a) {
                subtract_product(system->block(slot_of[nodes_[a]]), roots[a].V, roots[b].V);
                // two sightings from one pose: the block below the diagonal, too
                if (a < b && nodes_[a] == j) subtract_product(diagonal, roots[b].V, roots[a].V);
            }
        }
    }
    return around.cost;
}

// The sightings one by one, as edges to landmark nodes: the marginal cost is the minimum over these nodes.
bool MarginalEdges::constant(const double* state, Index nodes, ConstantEdges& out) const {
    if (!body_) return false;
    const AroundMeans around = around_means({state, state});
    const std::vector<Placed> seen = from_robot(Covariance::reference);
    for (std::size_t k = 0; k < seen.size(); ++k) {
        const Vector& y = seen[k].y;
        const Symmetric W = around.sightings[k].factor * inverse(seen[k].C, seen_.oriented);
        out.edges.push_back({nodes_[k], nodes + groups_[k], {y.x, y.y}, {}, y.t, seen_.oriented, W});
    }
    for (const Vector& m : around.means) out.landmarks.push_back({m.x, m.y, seen_.oriented ? m.t : 0.0});
    return true;
}

}  // namespace vmslam::edges
