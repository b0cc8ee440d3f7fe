#include "vmslam/sparse/separator.hpp"

#include <algorithm>
#include <cstdlib>
#include <limits>

namespace vmslam::sparse {
namespace {

/// The share of the nodes that a cut leaves on each side at least, but for the part of a contracted separator.
constexpr double least_share = 0.4;
constexpr std::size_t most_bins = 65'536;
constexpr Node far = Node{1} << 30;

}  // namespace

Separator::Separator(const Neighbours& graph)
    : side(graph.size(), -1),
      graph_(graph),
      part_(graph.size()),
      before_(graph.size()),
      after_(graph.size()),
      hops_(graph.size()),
      seen_(2 * graph.size(), 0),
      queue_(2 * graph.size() + 1),
      arc_(2 * graph.size() + 1),
      turn_(2 * graph.size() + 1),
      ranks_(graph.size()),
      profile_(2 * graph.size() + 2),
      bins_(most_bins) {
    for (auto& axis : axes_) axis.resize(graph.size());
}

/// The numbers of edges from each node to side 2; nodes of side 0 are reached, but not passed through.
void Separator::measure_hops(std::span<const Node> nodes) {
    std::size_t last = 0;
    for (const Node v : nodes) {
        hops_[v] = side[v] == 2 ? 0 : far;
        if (side[v] == 2) queue_[last++] = v;
    }
    for (std::size_t next = 0; next < last; ++next) {
        const Node v = queue_[next];
        for (const Node w : graph_.of(v)) {
            if (side[w] < 0 || side[w] == 2 || hops_[w] != far) continue;
            hops_[w] = hops_[v] + 1;
            if (side[w] == 1) queue_[last++] = w;
        }
    }
}

/// The nodes of a side with a neighbour elsewhere in the region.
std::vector<Node> Separator::ends(std::span<const Node> nodes, int source) const {
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
Node Separator::next_state(std::size_t depth, int source, std::span<const Node> before, std::span<const Node> after) {
    const Node state = queue_[depth], v = state >> 1;
    if (state & 1) {
        // straight ahead through free nodes, then sideways, then back or through other paths
        for (; turn_[depth] < 3; ++turn_[depth], arc_[depth] = graph_.start[v])
            while (arc_[depth] < graph_.start[v + 1]) {
                const Node w = graph_.list[arc_[depth]++];
                if (side[w] < 0 || side[w] == source || seen_[2 * w] == stamp_ || w == after[v]) continue;
                const bool free = before[w] == none;
                const int kind = free && hops_[w] < hops_[v] ? 0 : free && hops_[w] == hops_[v] ? 1 : 2;
                if (kind == turn_[depth]) return 2 * w;
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
Node Separator::sweep(std::span<const Node> ends, int source, std::vector<Node>& before, std::vector<Node>& after) {
    ++stamp_;
    Node found = 0;
    for (const Node first : ends) {
        if (before[first] != none) continue;
        queue_[0] = 2 * first + 1;
        arc_[0] = graph_.start[first];
        turn_[0] = 0;
        seen_[2 * first] = seen_[2 * first + 1] = stamp_;
        for (Place depth = 0; depth >= 0;) {
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
            turn_[depth] = 0;
        }
    }
    return found;
}

/// Send one more path along the states of the queue, some of which take others back.
void Separator::augment(std::size_t depth, std::vector<Node>& before, std::vector<Node>& after) {
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
bool Separator::inside(Node v, int source) const {
    return seen_[2 * v + 1] == stamp_ || (side[v] == source && before_[v] == none);
}

Node Separator::separate(std::span<const Node> nodes) {
    for (const Node v : nodes) before_[v] = after_[v] = none;
    measure_hops(nodes);
    const std::vector<Node> sources = ends(nodes, 0);
    Node size = 0;
    while (const Node found = sweep(sources, 0, before_, after_)) size += found;
    Place uneven = std::numeric_limits<Place>::max();
    for (const int source : {0, 2}) {
        if (source == 2) sweep(ends(nodes, 2), 2, after_, before_);
        const Place number = std::count_if(nodes.begin(), nodes.end(), [&](Node v) { return inside(v, source); });
        const Place difference = std::abs(2 * number + size - static_cast<Place>(nodes.size()));
        if (difference >= uneven) continue;
        uneven = difference;
        for (const Node v : nodes) {
            const bool reached = seen_[2 * v] == stamp_ || side[v] == source;
            part_[v] = static_cast<signed char>(inside(v, source) ? source : before_[v] != none && reached ? 1 : 2 - source);
        }
    }
    for (const Node v : nodes) side[v] = part_[v];
    return size;
}

/// The numbers of edges from a node to the others of the region, -1 where there is no path; the last node reached.
Node Separator::measure_distances(std::span<const Node> nodes, Node first, std::vector<Node>& distance) {
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
void Separator::rank(std::span<const Node> nodes, std::span<const Node> values, std::vector<Node>& order) {
    Node low = std::numeric_limits<Node>::max(), high = std::numeric_limits<Node>::min();
    for (const Node v : nodes) {
        low = std::min(low, values[v]);
        high = std::max(high, values[v]);
    }
    const auto bins = static_cast<Node>(std::min<Place>(most_bins - 1, Place{high} - low + 1));
    std::fill_n(bins_.begin(), bins + 1, 0);
    for (const Node v : nodes) ++bins_[std::min(values[v] - low, bins - 1) + 1];
    for (Node b = 0; b < bins; ++b) bins_[b + 1] += bins_[b];
    for (const Node v : nodes) order[bins_[std::min(values[v] - low, bins - 1)]++] = v;
}

/// The fewest nodes before a cut of the order at `begin` to `stop` with a neighbour behind it, or the reverse.
Node Separator::narrowest(std::span<const Node> order, Node begin, Node stop) {
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

Node Separator::cut(std::span<const Node> nodes) {
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

void Separator::widen(std::span<const Node> nodes) {
    for (const Node v : nodes) part_[v] = side[v];
    for (const Node v : nodes) {
        if (part_[v] != 1) continue;
        for (const Node w : graph_.of(v))
            if (side[w] >= 0) side[w] = 1;
    }
}

}  // namespace vmslam::sparse
