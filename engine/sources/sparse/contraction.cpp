// Smaller graphs by matching: neighbours become one node, as in multilevel partitioning.
#include <numeric>

#include "vmslam/sparse/ordering.hpp"

namespace vmslam::sparse {
namespace {

/// Pairs of neighbours: each node with the free neighbour of the fewest neighbours. In graphs of poses and landmarks these
/// are consecutive poses, which see nearly the same landmarks, so that most of the edges become multiple and vanish.
struct Matching {
    std::vector<Node> number, first, second;  // the pair of each node; the nodes of each pair, -1 for none

    Matching(const Neighbours& graph, Node limit) : number(graph.size(), -1) {
        for (Node v = 0; v < graph.size(); ++v) {
            if (number[v] >= 0) continue;
            number[v] = static_cast<Node>(first.size());
            Node partner = -1, least = limit + 1;
            if (graph.degree(v) <= limit)
                for (const Node w : graph.of(v))
                    if (number[w] < 0 && graph.degree(w) < least) {
                        least = graph.degree(w);
                        partner = w;
                    }
            if (partner >= 0) number[partner] = number[v];
            first.push_back(v);
            second.push_back(partner);
        }
    }

    Neighbours quotient(const Neighbours& graph) const {
        const auto count = static_cast<Node>(first.size());
        Neighbours result;
        result.start.assign(1, 0);
        result.list.reserve(graph.list.size());
        std::vector<Node> mark(count, -1);
        for (Node c = 0; c < count; ++c) {
            mark[c] = c;
            for (const Node v : {first[c], second[c]}) {
                if (v < 0) continue;
                for (const Node w : graph.of(v))
                    if (mark[number[w]] != c) {
                        mark[number[w]] = c;
                        result.list.push_back(number[w]);
                    }
            }
            result.start.push_back(static_cast<Place>(result.list.size()));
        }
        return result;
    }
};

}  // namespace

Contracted contracted(const Neighbours& graph, int rounds, Node limit) {
    Contracted result{std::vector<Node>(graph.size()), graph};
    std::iota(result.cluster.begin(), result.cluster.end(), 0);
    for (int round = 0; round < rounds; ++round) {
        const Matching matching(result.graph, limit);
        if (static_cast<double>(matching.first.size()) > 0.9 * result.graph.size()) break;
        result.graph = matching.quotient(result.graph);
        for (Node& c : result.cluster) c = matching.number[c];
    }
    return result;
}

}  // namespace vmslam::sparse
