// Elimination of the nodes of degree two and less, ahead of minimum degree.
#include "vmslam/sparse/ordering.hpp"

namespace vmslam::sparse {
namespace {

/// Neighbours of every node; `twin[p]` is the same edge seen from its far end, so that every change is local and a node
/// with 10^5 neighbours costs nothing extra.
struct TwinLists {
    std::vector<Index> start;
    std::vector<Node> list;
    std::vector<Index> twin;
    std::vector<Node> length;

    explicit TwinLists(const Pattern& pattern) {
        const Node n = pattern.size();
        start.assign(n + 1, 0);
        for (Node j = 0; j < n; ++j)
            for (Index p = pattern.start[j]; p < pattern.start[j + 1] - 1; ++p) {
                ++start[pattern.rows[p] + 1];
                ++start[j + 1];
            }
        for (Node j = 0; j < n; ++j) start[j + 1] += start[j];
        list.resize(start[n]);
        twin.resize(start[n]);
        length.assign(n, 0);
        for (Node j = 0; j < n; ++j)
            for (Index p = pattern.start[j]; p < pattern.start[j + 1] - 1; ++p) {
                const Node i = pattern.rows[p];
                const Index a = start[i] + length[i]++, b = start[j] + length[j]++;
                list[a] = j;
                list[b] = i;
                twin[a] = b;
                twin[b] = a;
            }
    }

    /// Remove place p from the list of its owner by moving the last place there.
    void drop(Index p, Node owner) {
        const Index last = start[owner] + --length[owner];
        if (last == p) return;
        list[p] = list[last];
        twin[p] = twin[last];
        twin[twin[p]] = p;
    }

    bool are_neighbours(Node a, Node b) const {
        for (Index q = start[a]; q < start[a] + length[a]; ++q)
            if (list[q] == b) return true;
        return false;
    }

    /// Take a node of degree one or two out and tie its neighbours together; returns them.
    std::pair<Node, Node> eliminate(Node v) {
        Index p = start[v];
        Node a = list[p];
        if (length[v] == 1) {
            drop(twin[p], a);
            return {a, a};
        }
        Node b = list[p + 1];
        if (length[b] < length[a]) {
            std::swap(a, b);
            ++p;
        }
        const Index at_a = twin[p], at_b = twin[2 * start[v] + 1 - p];
        if (are_neighbours(a, b)) {
            drop(at_a, a);
            drop(at_b, b);
        } else {
            list[at_a] = b;
            list[at_b] = a;
            twin[at_a] = at_b;
            twin[at_b] = at_a;
        }
        return {a, b};
    }
};

}  // namespace

// Minimum degree would begin with the same nodes, but each would cost an update of the quotient graph. Most poses of a
// trajectory are of this kind, and here each costs a few places of lists.
Reduced without_low_degrees(const Pattern& pattern) {
    TwinLists lists(pattern);
    const Node n = pattern.size();
    Reduced reduced;
    std::vector<char> gone(n, 0);
    std::vector<Node> stack;
    for (Node next = 0; next < n; ++next) {
        if (!gone[next] && lists.length[next] <= 2) stack.push_back(next);
        while (!stack.empty()) {
            const Node v = stack.back();
            stack.pop_back();
            if (gone[v]) continue;
            gone[v] = 1;
            reduced.head.push_back(v);
            if (lists.length[v] == 0) continue;
            const auto [a, b] = lists.eliminate(v);
            // the loop reaches later nodes by itself; earlier ones go onto the stack
            if (lists.length[b] <= 2 && b < next && !gone[b]) stack.push_back(b);
            if (a != b && lists.length[a] <= 2 && a < next && !gone[a]) stack.push_back(a);
        }
    }
    std::vector<Node> number(n, -1);
    for (Node v = 0; v < n; ++v)
        if (!gone[v]) {
            number[v] = static_cast<Node>(reduced.nodes.size());
            reduced.nodes.push_back(v);
        }
    Neighbours& rest = reduced.rest;
    rest.start.push_back(0);
    for (const Node v : reduced.nodes) {
        for (Index p = lists.start[v]; p < lists.start[v] + lists.length[v]; ++p) rest.list.push_back(number[lists.list[p]]);
        rest.start.push_back(static_cast<Index>(rest.list.size()));
    }
    return reduced;
}

}  // namespace vmslam::sparse
