// Taking the edges of an old pose out of the graph. Eliminating the increments of its node from Omega d = rhs of its edges
// and priors leaves a prior on its neighbours: dense, and exact for the linearisation that the edges had last.
#include <algorithm>

#include "require.hpp"
#include "vmslam/online/system.hpp"

namespace vmslam::online {
namespace {

/// What edges and priors add to Omega (3k, 3k) and to the right-hand side (3k) of some nodes, which `Node::local` numbers.
struct Dense {
    std::size_t n;
    std::vector<double> information, rhs;

    explicit Dense(std::size_t nodes) : n(3 * nodes), information(n * n, 0.0), rhs(n, 0.0) {}

    double& at(std::size_t i, std::size_t j) { return information[i * n + j]; }

    void add(const Graph& graph, const Edge& edge) {
        const std::size_t a = 3 * graph.nodes[edge.ends[0]].local, b = 3 * graph.nodes[edge.ends[1]].local;
        const auto cross = block_between(edge);
        const Blocks own = diagonal_blocks(edge);
        for (int p = 0; p < 3; ++p)
            for (int q = 0; q < 3; ++q) {
                at(a + p, b + q) += cross[3 * p + q];
                at(b + q, a + p) += cross[3 * p + q];
            }
        for (const auto& [at_node, D] : {std::pair(a, own.first), std::pair(b, own.second)}) {
            const double block[9] = {D.xx, D.xy, D.xt, D.xy, D.yy, D.yt, D.xt, D.yt, D.tt};
            for (int p = 0; p < 3; ++p)
                for (int q = 0; q < 3; ++q) at(at_node + p, at_node + q) += block[3 * p + q];
        }
        const Pulls now = pulls(linearize(graph, edge));
        for (int p = 0; p < 3; ++p) rhs[a + p] += now.ends[0][p], rhs[b + p] += now.ends[1][p];
    }
    void add(const Graph& graph, const Prior& prior) {
        const std::size_t k = prior.members.size();
        for (std::size_t i = 0; i < 3 * k; ++i) {
            const std::size_t row = 3 * graph.nodes[prior.members[i / 3]].local + i % 3;
            for (std::size_t j = 0; j < 3 * k; ++j)
                at(row, 3 * graph.nodes[prior.members[j / 3]].local + j % 3) += prior.linear[i * 3 * k + j];
            rhs[row] += prior.pull[i];
        }
    }
};

/// The nodes that some edges and priors tie to a node, ascending.
std::vector<Id> neighbours(const Graph& graph, Id node, std::span<const Id> edges, std::span<const Prior> priors) {
    std::vector<Id> found;
    for (const Id e : edges) found.insert(found.end(), graph.edges[e].ends, graph.edges[e].ends + 2);
    for (const Prior& prior : priors) found.insert(found.end(), prior.members.begin(), prior.members.end());
    std::sort(found.begin(), found.end());
    found.erase(std::unique(found.begin(), found.end()), found.end());
    std::erase(found, node);
    return found;
}

/// Take an edge out of the graph.
void take_out(Graph& graph, Id number) {
    Edge& edge = graph.edges[number];
    const Blocks own = diagonal_blocks(edge);
    for (int side = 0; side < (edge.one_ended() ? 1 : 2); ++side) {
        Node& node = graph.nodes[edge.ends[side]];
        const Symmetric& part = side == 0 ? own.first : own.second;
        node.diagonal = {node.diagonal[0] - part.xx, node.diagonal[1] - part.yy, node.diagonal[2] - part.tt};
        graph.unlink(number, edge.ends[side]);
    }
    edge.ends[0] = edge.ends[1] = -1;
}

}  // namespace

Triple OnlineSystem::marginalize(Id node, std::span<const Id> newest) {
    require(!graph_.nodes[node].point, "a landmark without heading cannot be marginalised");
    const std::vector<Id> gone = graph_.edges_of(node);
    const auto mine = std::stable_partition(priors_.begin(), priors_.end(), [&](const Prior& prior) {
        return std::find(prior.members.begin(), prior.members.end(), node) == prior.members.end();
    });
    std::vector<Id> removed{graph_.nodes[node].home};
    for (auto prior = mine; prior != priors_.end(); ++prior) removed.push_back(prior->group);
    std::vector<Id> members = neighbours(graph_, node, gone, {mine, priors_.end()});
    require(!members.empty(), "a pose that is tied to no other node cannot be marginalised");
    members.insert(members.begin(), node);
    const bool absolute = std::any_of(mine, priors_.end(), [](const Prior& prior) { return !prior.relative; }) ||
                          std::ranges::any_of(gone, [&](Id e) { return graph_.edges[e].one_ended(); });
    // the others are relative to the oldest one that has a heading
    const auto first = std::find_if(members.begin() + 1, members.end(), [&](Id n) { return !graph_.nodes[n].point; });
    const bool relative = !absolute && first != members.end();
    if (relative) std::rotate(members.begin() + 1, first, first + 1);
    const Triple value = values(members)[0];

    Id local = 0;
    for (const Id member : members) graph_.nodes[member].local = local++;
    Dense dense(members.size());
    for (const Id e : gone) {
        online::relinearize(graph_, graph_.edges[e], Bent::never());
        dense.add(graph_, graph_.edges[e]);
        memory_.cost -= graph_.edges[e].cost;
        take_out(graph_, e);
    }
    for (auto prior = mine; prior != priors_.end(); ++prior) {
        prior->evaluate(graph_, true);
        dense.add(graph_, *prior);
    }
    for (const Id member : members) graph_.nodes[member].local = -1;

    priors_.erase(mine, priors_.end());
    graph_.nodes[node].gone = true;
    Reduced rest = without_first(dense.information, dense.rhs);
    Prior prior;
    prior.members.assign(members.begin() + 1, members.end());
    prior.information = std::move(rest.information);
    prior.rhs = std::move(rest.rhs);
    prior.relative = relative;
    prior.centre = graph_.values(prior.members);
    prior.evaluate(graph_, true);
    hang_prior(prior);
    priors_.push_back(std::move(prior));
    if (relative) memory_.bent = usual_bent();
    if (lost_ || !eliminate({priors_.back().members, {}, newest, removed})) {
        complete();
        begin_at(places(), newest);
    }
    return value;
}

bool OnlineSystem::remove(Id landmark, std::span<const Id> newest) {
    for (const Prior& prior : priors_)
        if (std::ranges::find(prior.members, landmark) != prior.members.end()) return false;
    complete();
    for (const Id e : graph_.edges_of(landmark)) take_out(graph_, e);
    graph_.nodes[landmark].gone = true;
    begin_and_solve(places(), newest);
    return true;
}

bool OnlineSystem::crowded() const {
    const auto gone = std::count_if(graph_.nodes.begin(), graph_.nodes.end(), [](const Node& node) { return node.gone; });
    return graph_.size() > 64 && 2 * gone > graph_.size();
}

std::vector<Id> OnlineSystem::renumber() {
    std::vector<Id> node(graph_.nodes.size(), -1), edge(graph_.edges.size(), -1);
    const auto new_number = [](const std::vector<Id>& of, Id old) { return old < 0 ? old : of[old]; };
    Graph kept{{}, {}, graph_.kernels, graph_.gains, graph_.has_single_numbers};
    for (const Id k : graph_.live_nodes()) {
        node[k] = kept.size();
        kept.nodes.push_back(graph_.nodes[k]);
    }
    for (const Id e : graph_.live_edges()) {
        edge[e] = static_cast<Id>(kept.edges.size());
        kept.edges.push_back(graph_.edges[e]);
    }
    for (Node& k : kept.nodes) k.edges = new_number(edge, k.edges), k.owned = new_number(edge, k.owned);
    for (Edge& e : kept.edges) {
        for (int side = 0; side < 2; ++side) e.ends[side] = node[e.ends[side]], e.next[side] = new_number(edge, e.next[side]);
        e.owner = new_number(node, e.owner);
        e.next_owned = new_number(edge, e.next_owned);
    }
    for (Supernode& group : tree_.groups)
        for (Id& k : group.nodes) k = new_number(node, k);
    for (Prior& prior : priors_)
        for (Id& k : prior.members) k = new_number(node, k);
    graph_ = std::move(kept);
    ordered_ = std::min(ordered_, graph_.size());
    return node;
}

}  // namespace vmslam::online
