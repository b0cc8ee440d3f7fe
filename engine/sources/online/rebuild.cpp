// Eliminate the top of the tree again, in a new order.
#include <algorithm>

#include "vmslam/online/edge.hpp"
#include "vmslam/online/tree.hpp"
#include "vmslam/sparse/ordering.hpp"

namespace vmslam::online {
namespace {

using sparse::Index;
using sparse::SupernodeTree;

/// The top: its supernodes, nodes and edges, and the supernodes that hang below it. Its nodes are numbered by `Node::local`.
struct Top {
    std::vector<Id> removed, nodes, edges, below;
    std::size_t fresh;  ///< the first edges are new

    Top(Graph& graph, Tree& tree, const Changes& changes) {
        // a new prior hangs below supernode 0, and ties nodes that may not be touched where an elimination with it has failed
        std::vector<Id> touched(changes.touched.begin(), changes.touched.end());
        for (Id c = tree.groups[0].child; c > 0; c = tree.groups[c].sibling)
            if (const Supernode& group = tree.groups[c]; group.w == 0 && std::ranges::count(changes.gone, c) == 0) {
                below.push_back(c);
                touched.insert(touched.end(), group.nodes.begin(), group.nodes.end());
            }
        for (const Id node : touched) remove_from(tree, graph.nodes[node].home);
        for (const Id s : changes.gone) remove_from(tree, s);
        for (const Id s : removed)
            for (const Id node : tree.groups[s].columns())
                if (!graph.nodes[node].gone) add(graph, node);
        for (const Id node : touched)
            if (graph.nodes[node].local < 0) add(graph, node);
        edges.assign(changes.fresh.begin(), changes.fresh.end());
        fresh = edges.size();
        for (const Id node : nodes) each_owned(graph, node, [&](Id e, const Edge&, int) { edges.push_back(e); });
        find_below(tree);
    }

   private:
    void remove_from(Tree& tree, Id s) {
        for (; s > 0 && !tree.groups[s].marked; s = tree.groups[s].parent) {
            tree.groups[s].marked = true;
            removed.push_back(s);
        }
    }
    void add(Graph& graph, Id node) {
        graph.nodes[node].local = static_cast<Id>(nodes.size());
        nodes.push_back(node);
    }
    void find_below(Tree& tree) {
        for (const Id s : removed)
            for (Id c = tree.groups[s].child; c > 0; c = tree.groups[c].sibling)
                if (!tree.groups[c].marked) below.push_back(c);
        for (const Id s : removed) tree.groups[s].marked = false;
    }
};

/// The structure of L for the groups of nodes that edges and supernodes below tie together. What a step ties is late in the
/// order, because the next step probably ties the same; then poses that are held, so that few subtrees are absolute; and the
/// nodes `newest` last.
SupernodeTree analyze_top(const Graph& graph, const Tree& tree, const Top& top, std::span<const Id> newest) {
    std::vector<Index> sizes, members;
    const auto n = static_cast<Id>(top.nodes.size());
    const auto local = [&](Id node) { return static_cast<Index>(graph.nodes[node].local); };
    const auto tie = [&](std::span<const Id> nodes) {
        sizes.push_back(static_cast<Index>(nodes.size()));
        for (const Id node : nodes) members.push_back(local(node));
    };
    for (const Id e : top.edges)
        if (!graph.edges[e].one_ended()) tie(graph.edges[e].ends);
    for (const Id s : top.below) tie(tree.groups[s].separator());
    sparse::Order order = sparse::minimum_degree(n, sizes, members);
    std::vector<char> last(n, 0);
    for (std::size_t k = 0; k < top.fresh; ++k)
        for (const Id end : graph.edges[top.edges[k]].ends) last[local(end)] = 1;
    for (Id k = 0; k < n; ++k)
        if (graph.nodes[top.nodes[k]].held) last[k] = 2;
    for (const Id node : newest)
        if (const Id k = graph.nodes[node].local; k >= 0) last[k] = 3;
    std::ranges::stable_sort(order, {}, [&](Id k) { return last[k]; });
    return sparse::supernodes_of(sizes, members, order);
}

/// What an elimination changes in the graph and below the top, to put it back.
class Kept {
   public:
    Kept(const Graph& graph, Tree& tree, const Top& top) : top_(top), root_(tree.groups[0].child) {
        nodes_.reserve(top.nodes.size());
        edges_.reserve(top.edges.size());
        places_.reserve(top.below.size());
        for (const Id node : top.nodes) nodes_.push_back(graph.nodes[node]);
        for (const Id e : top.edges) edges_.push_back(graph.edges[e]);
        for (const Id s : top.below) {
            Supernode& group = tree.groups[s];
            places_.emplace_back(group, std::vector<double>(group.pull_now(), group.pull_now() + 3 * group.tall));
        }
        for (Id c = root_; c > 0; c = tree.groups[c].sibling) roots_.push_back(c);
    }
    void put_back(Graph& graph, Tree& tree) {
        for (std::size_t k = 0; k < nodes_.size(); ++k) {
            graph.nodes[top_.nodes[k]] = nodes_[k];
            graph.nodes[top_.nodes[k]].local = -1;
        }
        for (std::size_t k = 0; k < edges_.size(); ++k) graph.edges[top_.edges[k]] = edges_[k];
        for (std::size_t k = 0; k < places_.size(); ++k) {
            Supernode& group = tree.groups[top_.below[k]];
            static_cast<Hanging&>(group) = std::move(places_[k].first);
            std::ranges::copy(places_[k].second, group.pull_now());
        }
        tree.groups[0].child = root_;
        for (std::size_t k = 0; k < roots_.size(); ++k)
            tree.groups[roots_[k]].sibling = k + 1 < roots_.size() ? roots_[k + 1] : 0;
    }

   private:
    const Top& top_;
    Id root_;
    std::vector<Node> nodes_;
    std::vector<Edge> edges_;
    std::vector<std::pair<Hanging, std::vector<double>>> places_;  ///< of the supernodes below, and their `pull_now`
    std::vector<Id> roots_;
};

/// New supernodes in the tree in the place of those removed, which stay for now.
std::vector<Id> link(Graph& graph, Tree& tree, const Top& top, const SupernodeTree& structure) {
    const auto node_at = [&](Id column) { return top.nodes[structure.order[column]]; };
    std::vector<Id> created;
    for (Id k = 0; k < structure.supernodes(); ++k) {
        const Id w = structure.width(k), r = structure.height_below(k);
        std::vector<Id> nodes;
        nodes.reserve(w + r);
        for (Id q = 0; q < w; ++q) nodes.push_back(node_at(structure.first[k] + q));
        for (Id q = 0; q < r; ++q) nodes.push_back(node_at(structure.rows[structure.row_start[k] + q]));
        const Id s = tree.create(graph, std::move(nodes), w);
        created.push_back(s);
        for (const Id node : tree.groups[s].columns()) graph.nodes[node].home = s, graph.nodes[node].owned = -1;
    }
    // roots that are neither removed nor below stay
    for (const Id s : top.removed) tree.groups[s].marked = true;
    for (const Id s : top.below) tree.groups[s].marked = true;
    std::vector<Id> roots;
    for (Id c = tree.groups[0].child; c > 0; c = tree.groups[c].sibling)
        if (!tree.groups[c].marked) roots.push_back(c);
    for (const Id s : top.removed) tree.groups[s].marked = false;
    for (const Id s : top.below) tree.groups[s].marked = false;
    tree.groups[0].child = 0;
    for (const Id s : roots) tree.hang(s, 0);
    for (Id k = 0; k < structure.supernodes(); ++k)
        tree.hang(created[k], structure.parent[k] < 0 ? 0 : created[structure.parent[k]]);
    const auto place = [&](Id node) { return structure.position[graph.nodes[node].local]; };
    for (const Id s : top.below) {
        const auto separator = tree.groups[s].separator();
        const auto lowest =
            std::min_element(separator.begin(), separator.end(), [&](Id a, Id b) { return place(a) < place(b); });
        tree.hang(s, lowest == separator.end() ? 0 : graph.nodes[*lowest].home);
    }
    for (const Id e : top.edges) {
        Edge& edge = graph.edges[e];
        edge.owner = edge.ends[place(edge.ends[0]) < place(edge.ends[1]) ? 0 : 1];
        edge.next_owned = graph.nodes[edge.owner].owned;
        graph.nodes[edge.owner].owned = e;
    }
    for (const Id node : top.nodes) graph.nodes[node].local = -1;
    return created;
}

}  // namespace

bool rebuild(Graph& graph, Tree& tree, const Changes& changes, Evaluation& found) {
    const Top top(graph, tree, changes);
    const SupernodeTree structure = analyze_top(graph, tree, top, changes.newest);
    Kept before(graph, tree, top);
    const std::size_t size_before = tree.groups.size();
    const std::vector<Id> created = link(graph, tree, top, structure);
    for (std::size_t k = 0; k < top.edges.size(); ++k) {
        // far from the minimum second derivatives mislead: new edges are without, unless all are new
        const bool without = k < top.fresh && top.fresh < top.edges.size();
        relinearize(graph, graph.edges[top.edges[k]], without ? Bent::never() : found.bent);
    }
    for (const Id s : top.below) tree.follow(graph, s);
    for (const Id s : created) {
        tree.relate_children(graph, s);
        if (tree.factorize(graph, s)) continue;
        before.put_back(graph, tree);
        tree.take_back(created, size_before);
        return false;
    }
    for (const Id s : top.removed) tree.release(s);
    for (const Id s : created) tree.evaluate(graph, s, found);
    return true;
}

}  // namespace vmslam::online
