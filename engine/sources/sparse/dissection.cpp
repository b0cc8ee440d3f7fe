// Nested dissection: few nodes separate the others into two parts of similar size, and each part again (George 1973).
#include <algorithm>
#include <array>
#include <cstdlib>
#include <limits>

#include "vmslam/sparse/ordering.hpp"

namespace vmslam::sparse {
namespace {

/// The share of the nodes that a cut puts on each side before the separator, which may take some of them, is sought.
constexpr double least_share = 0.4;
constexpr std::size_t most_bins = 65'536;

/// Separates regions of a graph. A node v has two states, in and out (2 v and 2 v + 1), between which at most one path
/// passes, so that the most paths are as many as the fewest nodes that cut them all (Menger 1927). The flow is kept as the
/// node before and the node after each node on its path; a further path may take others back. Paths are sought depth first,
/// many in one sweep (Pothen and Fan, Computing the block triangular form of a sparse matrix, 1990):
/// Dinic's shortest paths took 50 to 90 sweeps for the first separator of 120,000 nodes.
class Separator {
   public:
    explicit Separator(const Neighbours& graph)
        : side(graph.size(), -1),
          graph_(graph),
          part_(graph.size()),
          before_(graph.size()),
          after_(graph.size()),
          seen_(2 * graph.size(), 0),
          queue_(2 * graph.size() + 1),
          arc_(2 * graph.size() + 1),
          ranks_(graph.size()),
          profile_(2 * graph.size() + 2),
          bins_(most_bins) {
        for (auto& axis : axes_) axis.resize(graph.size());
    }

    /// The sides 0, 1 (between) and 2 of the nodes of a region; other nodes have -1.
    std::vector<signed char> side;

    /// A smallest set of `nodes`, a region, that separates those of side 0 from those of side 2; its size.
    ///
    /// Afterwards `side` is 0 and 2 of the nodes on the two sides, and 1 of the separator, which may have taken nodes of
    /// both sides. Of the smallest separators it is the one next to side 0 or the one next to side 2, whichever divides the
    /// nodes more evenly.
    Node separate(std::span<const Node> nodes) {
        for (const Node v : nodes) before_[v] = after_[v] = none;
        const std::vector<Node> sources = ends(nodes, 0);
        Node size = 0;
        while (const Node found = sweep(sources, 0, before_, after_)) size += found;
        Index uneven = std::numeric_limits<Index>::max();
        for (const int source : {0, 2}) {
            if (source == 2) sweep(ends(nodes, 2), 2, after_, before_);
            const Index number = std::count_if(nodes.begin(), nodes.end(), [&](Node v) { return inside(v, source); });
            const Index difference = std::abs(2 * number + size - static_cast<Index>(nodes.size()));
            if (difference >= uneven) continue;
            uneven = difference;
            for (const Node v : nodes) {
                const bool reached = seen_[2 * v] == stamp_ || side[v] == source;
                part_[v] = static_cast<signed char>(inside(v, source)               ? source
                                                    : before_[v] != none && reached ? 1
                                                                                    : 2 - source);
            }
        }
        for (const Node v : nodes) side[v] = part_[v];
        return size;
    }

    /// Divide a region in the middle, across the axis with the narrowest cut; `side` as after `separate`. Returns the size of
    /// the separator. The coordinates of a node on the axes are its distance from a minus that from b, a and b far apart, the
    /// same for two nodes far from both, and the sum and the difference of these two.
    Node cut(std::span<const Node> nodes) {
        const auto m = static_cast<Node>(nodes.size());
        for (const Node v : nodes) side[v] = 1;
        auto& [first, second, third, fourth] = axes_;
        const Node a = measure_distances(nodes, nodes[0], first);
        const Node b = measure_distances(nodes, a, first);
        measure_distances(nodes, b, second);
        Node c = a, farthest = -1;
        for (const Node v : nodes)
            if (const Node distance = std::min(first[v], second[v]); distance > farthest) {
                c = v;
                farthest = distance;
            }
        const Node d = measure_distances(nodes, c, third);
        measure_distances(nodes, d, fourth);
        for (const Node v : nodes) {
            const Node across = first[v] - second[v], along = third[v] - fourth[v];
            first[v] = across;
            second[v] = along;
            third[v] = across + along;
            fourth[v] = across - along;
        }
        const auto begin = static_cast<Node>(least_share * m);
        Node width = m + 1;
        std::vector<Node> order(m), chosen;
        for (const auto& axis : axes_) {
            rank(nodes, axis, order);
            const Node here = narrowest(order, begin, m - begin);
            if (here >= width) continue;
            width = here;
            chosen = order;
        }
        for (Node k = 0; k < begin; ++k) {
            side[chosen[k]] = 0;
            side[chosen[m - 1 - k]] = 2;
        }
        return separate(nodes);
    }

   private:
    static constexpr Node none = -1, end = -2;  // of `before_` and `after_`: on no path; a path begins or ends here

    /// The nodes of a side with a neighbour elsewhere in the region.
    std::vector<Node> ends(std::span<const Node> nodes, int source) const {
        std::vector<Node> result;
        for (const Node v : nodes) {
            if (side[v] != source) continue;
            const auto list = graph_.of(v);
            if (std::any_of(list.begin(), list.end(), [&](Node w) { return side[w] >= 0 && side[w] != source; }))
                result.push_back(v);
        }
        return result;
    }

    /// The next state after the last one of the path through the residual network, or -1; `end` where the path is complete.
    Node next_state(std::size_t depth, int source, std::span<const Node> before, std::span<const Node> after) {
        const Node state = queue_[depth], v = state >> 1;
        if (state & 1) {
            while (arc_[depth] < graph_.start[v + 1]) {
                const Node w = graph_.list[arc_[depth]++];
                if (side[w] >= 0 && side[w] != source && seen_[2 * w] != stamp_ && w != after[v]) return 2 * w;
            }
            return before[v] >= 0 && seen_[2 * v] != stamp_ ? 2 * v : -1;
        }
        if (before[v] == none) {
            if (side[v] == 2 - source) return end;
            return seen_[2 * v + 1] != stamp_ ? 2 * v + 1 : -1;
        }
        return before[v] >= 0 && seen_[2 * before[v] + 1] != stamp_ ? 2 * before[v] + 1 : -1;
    }

    /// Paths from side `source` to the opposite side through the residual network, each state visited once; how many.
    ///
    /// If there is none, the states that can be reached are those that were seen now.
    Node sweep(std::span<const Node> ends, int source, std::vector<Node>& before, std::vector<Node>& after) {
        ++stamp_;
        Node found = 0;
        for (const Node first : ends) {
            if (before[first] != none) continue;
            queue_[0] = 2 * first + 1;
            arc_[0] = graph_.start[first];
            seen_[2 * first] = seen_[2 * first + 1] = stamp_;
            for (Index depth = 0; depth >= 0;) {
                const Node state = next_state(depth, source, before, after);
                if (state == end) {
                    augment(depth, before, after);
                    ++found;
                    break;
                }
                if (state < 0) {
                    --depth;
                    continue;
                }
                seen_[state] = stamp_;
                ++depth;
                queue_[depth] = state;
                arc_[depth] = graph_.start[state >> 1];
            }
        }
        return found;
    }

    /// Send one more path along the states of the queue, some of which take others back.
    void augment(std::size_t depth, std::vector<Node>& before, std::vector<Node>& after) {
        for (std::size_t k = 0; k < depth; ++k) {
            const Node v = queue_[k] >> 1, w = queue_[k + 1] >> 1;
            if (!(queue_[k] & 1)) continue;
            if (v != w) {
                after[v] = w;
                before[w] = v;
            } else {
                after[v] = before[v] = none;
            }
        }
        before[queue_[0] >> 1] = end;
        after[queue_[depth] >> 1] = end;
    }

    /// Whether a path from this side could still leave a node, or it lies without paths behind the ends.
    bool inside(Node v, int source) const { return seen_[2 * v + 1] == stamp_ || (side[v] == source && before_[v] == none); }

    /// The numbers of edges from a node to the others of the region, -1 where there is no path; the last node reached.
    Node measure_distances(std::span<const Node> nodes, Node first, std::vector<Node>& distance) {
        for (const Node v : nodes) distance[v] = -1;
        distance[first] = 0;
        queue_[0] = first;
        std::size_t last = 1;
        for (std::size_t next = 0; next < last; ++next)
            for (const Node w : graph_.of(queue_[next]))
                if (side[w] >= 0 && distance[w] < 0) {
                    distance[w] = distance[queue_[next]] + 1;
                    queue_[last++] = w;
                }
        return queue_[last - 1];
    }

    /// The nodes by value, by a counting sort.
    void rank(std::span<const Node> nodes, std::span<const Node> values, std::vector<Node>& order) {
        Node low = std::numeric_limits<Node>::max(), high = std::numeric_limits<Node>::min();
        for (const Node v : nodes) {
            low = std::min(low, values[v]);
            high = std::max(high, values[v]);
        }
        const auto bins = static_cast<Node>(std::min<Index>(most_bins - 1, Index{high} - low + 1));
        std::fill_n(bins_.begin(), bins + 1, 0);
        for (const Node v : nodes) ++bins_[std::min(values[v] - low, bins - 1) + 1];
        for (Node b = 0; b < bins; ++b) bins_[b + 1] += bins_[b];
        for (const Node v : nodes) order[bins_[std::min(values[v] - low, bins - 1)]++] = v;
    }

    /// The fewest nodes before a cut of the order at `begin` to `stop` with a neighbour behind it, or the reverse.
    Node narrowest(std::span<const Node> order, Node begin, Node stop) {
        const auto m = static_cast<Node>(order.size());
        for (Node k = 0; k < m; ++k) ranks_[order[k]] = k;
        std::fill_n(profile_.begin(), 2 * m + 2, 0);
        for (Node k = 0; k < m; ++k) {
            Node least = k, most = k;
            for (const Node w : graph_.of(order[k])) {
                if (side[w] < 0) continue;
                least = std::min(least, ranks_[w]);
                most = std::max(most, ranks_[w]);
            }
            ++profile_[k];
            --profile_[most];
            ++profile_[m + least];
            --profile_[m + k];
        }
        Node best = m, left = 0, right = 0;
        for (Node k = 0; k < stop; ++k) {
            left += profile_[k];
            right += profile_[m + k];
            if (k >= begin) best = std::min({best, left, right});
        }
        return best;
    }

    const Neighbours& graph_;
    std::vector<signed char> part_;  ///< the sides to come
    std::vector<Node> before_, after_;  ///< of each node on its path
    std::vector<Node> seen_;  ///< stamp of the last sweep that visited each state
    Node stamp_ = 0;
    std::vector<Node> queue_;  ///< of nodes in breadth-first order; in `sweep` the stack of the states of a path
    std::vector<Index> arc_;  ///< of each state on the path: where to go on in its list
    std::array<std::vector<Node>, 4> axes_;
    std::vector<Node> ranks_, profile_;
    std::vector<Index> bins_;
};

constexpr std::size_t leaf = 400;     ///< regions of up to so many nodes are not dissected
/// A region whose separator would have more than this part of the nodes of the smaller side stays whole.
constexpr double thick = 0.5;

struct Region {
    std::size_t low, high;
    Node depth;
};

/// Move the nodes of side 0 to the front, then those of side 2, then the separator; how many have side 0, and 2.
std::pair<std::size_t, std::size_t> divide(std::span<Node> nodes, const Separator& separator) {
    const auto right = std::stable_partition(nodes.begin(), nodes.end(), [&](Node v) { return separator.side[v] == 0; });
    const auto end = std::stable_partition(right, nodes.end(), [&](Node v) { return separator.side[v] == 2; });
    return {right - nodes.begin(), end - right};
}

}  // namespace

// Nodes with more than `limit` neighbours are left out: they would be in every separator.
std::vector<Node> separator_depths(const Neighbours& graph, Node limit) {
    std::vector<Node> depth_of(graph.size(), -1);
    Separator separator(graph);
    std::vector<Node> nodes;
    for (Node v = 0; v < graph.size(); ++v)
        if (graph.degree(v) <= limit) nodes.push_back(v);
    std::vector<Region> todo{{0, nodes.size(), 0}};
    while (!todo.empty()) {
        const auto [low, high, depth] = todo.back();
        todo.pop_back();
        const std::span<Node> region(nodes.data() + low, high - low);
        if (region.size() <= leaf) continue;
        const Node size = separator.cut(region);
        const auto [left, right] = divide(region, separator);
        const bool thin = size <= thick * static_cast<double>(std::min(left, right));
        for (const Node v : region) {
            if (separator.side[v] == 1 && thin) depth_of[v] = depth;
            separator.side[v] = -1;
        }
        if (!thin) continue;
        todo.push_back({low, low + left, depth + 1});
        todo.push_back({low + left, low + left + right, depth + 1});
    }
    return depth_of;
}

Node separate(const Neighbours& graph, std::span<signed char> side) {
    Separator separator(graph);
    std::copy(side.begin(), side.end(), separator.side.begin());
    std::vector<Node> nodes;
    for (Node v = 0; v < graph.size(); ++v)
        if (side[v] >= 0) nodes.push_back(v);
    const Node size = separator.separate(nodes);
    std::copy(separator.side.begin(), separator.side.end(), side.begin());
    return size;
}

}  // namespace vmslam::sparse
