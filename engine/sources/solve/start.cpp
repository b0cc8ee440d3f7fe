#include "vmslam/solve/start.hpp"

#include <algorithm>
#include <cmath>

#include "vmslam/edges/rotations.hpp"

namespace vmslam::solve {
namespace {

using namespace edges;

/// The relations of all families, and the block between the nodes of each.
template <class Relation>
struct Related {
    std::vector<Relation> relations;
    std::vector<Index> pairs;
    Index unlisted = -1;  ///< the first node of a pair without a block

    template <class Relations>
    Related(const GraphObjective& graph, Relations of) {
        const System& system = graph.system();
        for (const GraphObjective::Member& m : graph.families()) {
            std::vector<Relation> found = of(*m.family);
            if (m.pairs.size() == found.size())
                pairs.insert(pairs.end(), m.pairs.begin(), m.pairs.end());
            else
                for (const Relation& r : found) {
                    pairs.push_back(sparse::block_or_none(system, r.first, r.second));
                    if (pairs.back() < 0 && unlisted < 0) unlisted = r.first;
                }
            if (relations.empty())
                relations = std::move(found);
            else
                relations.insert(relations.end(), found.begin(), found.end());
        }
    }
};

/// Omega and xi of two coordinates of each node, on the pattern of a graph.
class StartSystem {
   public:
    explicit StartSystem(const GraphObjective& graph, std::span<const Index> held)
        : start_(graph.system().start),
          values_(4 * start_.back()),
          xi_(2 * (start_.size() - 1)),
          held_(held),
          held_blocks_(sparse::blocks_of_nodes(graph.system(), held)),
          factor_(reshaped(graph.symbolic(), sparse::shape_of<sparse::Real2>)) {}

    /// Add an edge with the residual R(value) r_first - r_second, where r = (cos theta, sin theta) is `unit` of nodes, and
    /// `turn` the rotation by its value.
    void add(const HeadingRelation& edge, Index pair, const Rotation& turn, std::span<const double> unit) {
        const auto& [i, j, value, w] = edge;
        const double c = w * turn.c, s = w * turn.s;
        for (const Index node : {i, j}) {
            diagonal(node)[0] += w;
            diagonal(node)[3] += w;
        }
        // the block of first and second is -w R', transposed where second < first
        double* const V = block(pair);
        const double q = i < j ? s : -s;
        V[0] -= c;
        V[1] -= q;
        V[2] += q;
        V[3] -= c;
        const double *const a = unit.data() + 2 * i, *const b = unit.data() + 2 * j;
        xi_[2 * i] += c * b[0] + s * b[1] - w * a[0];
        xi_[2 * i + 1] += c * b[1] - s * b[0] - w * a[1];
        xi_[2 * j] += c * a[0] - s * a[1] - w * b[0];
        xi_[2 * j + 1] += s * a[0] + c * a[1] - w * b[1];
    }

    /// Add an edge with the residual p_second - p_first - value, where p is `position` of nodes.
    void add(const PositionRelation& edge, Index pair, std::span<const double> position) {
        const auto& [i, j, x, y, xx, xy, yy] = edge;
        const double W[4] = {xx, xy, xy, yy};
        const double *const a = position.data() + 2 * i, *const b = position.data() + 2 * j;
        const double ex = b[0] - a[0] - x, ey = b[1] - a[1] - y;
        const double fx = xx * ex + xy * ey, fy = xy * ex + yy * ey;
        for (int r = 0; r < 4; ++r) {
            diagonal(i)[r] += W[r];
            diagonal(j)[r] += W[r];
            block(pair)[r] -= W[r];
        }
        xi_[2 * i] += fx;
        xi_[2 * i + 1] += fy;
        xi_[2 * j] -= fx;
        xi_[2 * j + 1] -= fy;
    }

    /// Add Omega^-1 xi to two coordinates of all nodes but those held, and `untied` ones, which no edge ties; then Omega and xi
    /// are zero again. Returns a node that the edges do not determine, or -1.
    Index solve(std::span<double> coordinates, std::span<const Index> untied) {
        for (const Index k : held_blocks_) std::fill_n(block(k), 4, 0.0);
        for (const Index node : held_) xi_[2 * node] = xi_[2 * node + 1] = 0.0;
        for (const auto rest : {held_, untied})
            for (const Index node : rest) diagonal(node)[0] = diagonal(node)[3] = 1.0;
        if (const Index bad = factor_.factorize(values_); bad >= 0) return factor_.symbolic().order[bad / 2];
        std::vector<double> correction(xi_.size());
        if (!factor_.solve(xi_, correction)) return 0;
        for (std::size_t k = 0; k < correction.size(); ++k) coordinates[k] += correction[k];
        std::fill(values_.begin(), values_.end(), 0.0);
        std::fill(xi_.begin(), xi_.end(), 0.0);
        return -1;
    }

   private:
    double* block(Index k) { return values_.data() + 4 * k; }
    double* diagonal(Index node) { return block(start_[node + 1] - 1); }

    std::span<const Index> start_;
    std::vector<double> values_, xi_;
    std::span<const Index> held_;
    std::vector<Index> held_blocks_;
    sparse::Factor<sparse::Real2> factor_;
};

/// Write the headings along edges between a known node and another one, which is known then; false at any other edge. Without
/// loops the headings of all nodes can be met in this way.
bool follow_headings(std::span<const HeadingRelation> edges, std::span<double> state, std::span<char> known) {
    for (const auto& [i, j, value, information] : edges) {
        if (known[i] == known[j] || !(information > 0)) return false;
        double &a = state[3 * i + 2], &b = state[3 * j + 2];
        if (known[i])
            b = wrap(a + value);
        else
            a = wrap(b - value);
        known[i] = known[j] = 1;
    }
    return true;
}

/// Headings by least squares on unit vectors.
void solve_headings(const Related<HeadingRelation>& edges, StartSystem& system, std::span<const Index> held, Index poses,
                    Start& start) {
    const std::size_t nodes = start.state.size() / 3;
    // linear, so it does not matter where the others start
    std::vector<double> unit(2 * nodes, 0.0);
    std::vector<char> tied(nodes, 0);
    for (const Index node : held) {
        const Rotation r(start.state[3 * node + 2]);
        unit[2 * node] = r.c, unit[2 * node + 1] = r.s;
    }
    Rotations turns(edges.relations.size(), [&](std::size_t k) { return edges.relations[k].value; });
    for (std::size_t k = 0; k < edges.relations.size(); ++k) {
        const HeadingRelation& edge = edges.relations[k];
        system.add(edge, edges.pairs[k], turns[k], unit);
        tied[edge.first] = tied[edge.second] = 1;
    }
    std::vector<Index> untied;
    for (Index k = 0; k < static_cast<Index>(nodes); ++k) {
        if (!tied[k]) untied.push_back(k);
        if (!tied[k] && k < poses) start.unturned.push_back(k);
    }
    if (!start.unturned.empty()) return;
    start.untied = system.solve(unit, untied);
    // a held heading keeps its own value, with its full turns
    for (const Index node : held) tied[node] = 0;
    for (std::size_t k = 0; k < nodes; ++k)
        if (tied[k] && (unit[2 * k] != 0 || unit[2 * k + 1] != 0))
            start.state[3 * k + 2] = std::atan2(unit[2 * k + 1], unit[2 * k]);
}

/// Positions by least squares, with the headings of the state.
void solve_positions(const Related<PositionRelation>& edges, StartSystem& system, std::span<const Index> held, Start& start) {
    std::vector<double> position(2 * start.state.size() / 3, 0.0);
    for (const Index node : held) std::copy_n(start.state.begin() + 3 * node, 2, position.begin() + 2 * node);
    for (std::size_t k = 0; k < edges.relations.size(); ++k) system.add(edges.relations[k], edges.pairs[k], position);
    start.untied = system.solve(position, {});
    for (std::size_t k = 0; k < position.size() / 2; ++k)
        std::copy_n(position.begin() + 2 * k, 2, start.state.begin() + 3 * k);
}

}  // namespace

Start rotation_first(const GraphObjective& graph, std::vector<double> state, std::span<const Index> held, Index poses) {
    Start start{std::move(state), {}};
    StartSystem system(graph, held);
    const Related<HeadingRelation> turns(graph, [](const Family& family) { return family.headings(); });
    start.unlisted = turns.unlisted;
    if (!start.found()) return start;
    std::vector<char> known(start.state.size() / 3, 0);
    for (const Index node : held) known[node] = 1;
    std::vector<double> followed = start.state;
    if (follow_headings(turns.relations, followed, known) &&
        std::all_of(known.begin(), known.begin() + poses, [](char each) { return each; }))
        start.state = std::move(followed);
    else
        solve_headings(turns, system, held, poses, start);
    if (!start.found()) return start;
    const Related<PositionRelation> offsets(graph, [&](const Family& f) { return f.positions(start.state.data()); });
    start.unlisted = offsets.unlisted;
    if (start.found()) solve_positions(offsets, system, held, start);
    return start;
}

}  // namespace vmslam::solve
