// Nested dissection: few nodes separate the others into two parts of similar size, and each part again (George 1973).
#include <algorithm>
#include <tuple>

#include "vmslam/sparse/ordering.hpp"
#include "vmslam/sparse/separator.hpp"

namespace vmslam::sparse {
namespace {

constexpr std::size_t leaf = 400;     ///< regions of up to so many nodes are not dissected
constexpr std::size_t large = 2'000;  ///< regions of more nodes are cut in the contracted graph first
constexpr int rounds = 3;             ///< its clusters have up to 2^rounds nodes
/// A region whose separator would have more than this part of the nodes of the smaller side stays whole.
constexpr double thick = 0.5;

struct Region {
    std::size_t low, high;
    Node depth;
};

/// The clusters of nodes, marked as a region of the contracted graph.
std::vector<Node> clusters_of(std::span<const Node> nodes, const std::vector<Node>& cluster, Separator& coarse) {
    std::vector<Node> clusters;
    for (const Node v : nodes)
        if (coarse.side[cluster[v]] < 0) {
            coarse.side[cluster[v]] = 1;
            clusters.push_back(cluster[v]);
        }
    return clusters;
}

/// Move the nodes of side 0 to the front, then those of side 2, then the separator; how many have side 0, and 2.
std::pair<std::size_t, std::size_t> divide(std::span<Node> nodes, const Separator& fine) {
    std::vector<Node> order;
    order.reserve(nodes.size());
    std::size_t size[3] = {};
    for (const int wanted : {0, 2, 1})
        for (const Node v : nodes)
            if (fine.side[v] == wanted) {
                order.push_back(v);
                ++size[wanted];
            }
    std::copy(order.begin(), order.end(), nodes.begin());
    return {size[0], size[2]};
}

}  // namespace

// Nodes with more than `limit` neighbours are left out: they would be in every separator.
std::vector<Node> separator_depths(const Neighbours& graph, Node limit) {
    const auto n = static_cast<std::size_t>(graph.size());
    std::vector<Node> depth_of(n, -1);
    const Contracted small = contracted(graph, n > large ? rounds : 0, limit);
    Separator fine(graph), coarse(small.graph);
    std::vector<Node> nodes;
    for (Node v = 0; v < graph.size(); ++v)
        if (graph.degree(v) <= limit) nodes.push_back(v);
    std::vector<Region> todo{{0, nodes.size(), 0}};
    while (!todo.empty()) {
        const auto [low, high, depth] = todo.back();
        todo.pop_back();
        const std::span<Node> region(nodes.data() + low, high - low);
        if (region.size() <= leaf) continue;
        std::size_t left = 0, right = 0;
        bool thin = false;
        for (int contract = region.size() > large ? 1 : 0; contract >= 0 && !thin; --contract) {
            Node size = 0;
            if (contract) {
                // the nodes of the clusters that separate the contracted region are cut in the graph itself
                const std::vector<Node> clusters = clusters_of(region, small.cluster, coarse);
                coarse.cut(clusters);
                coarse.widen(clusters);
                for (const Node v : region) fine.side[v] = coarse.side[small.cluster[v]];
                for (const Node c : clusters) coarse.side[c] = -1;
                size = fine.separate(region);
            } else {
                size = fine.cut(region);
            }
            std::tie(left, right) = divide(region, fine);
            thin = size <= thick * static_cast<double>(std::min(left, right));
        }
        for (const Node v : region) {
            if (fine.side[v] == 1 && thin) depth_of[v] = depth;
            fine.side[v] = -1;
        }
        if (!thin) continue;
        todo.push_back({low, low + left, depth + 1});
        todo.push_back({low + left, low + left + right, depth + 1});
    }
    return depth_of;
}

}  // namespace vmslam::sparse
