// Elimination of the nodes of degree two and less, ahead of minimum degree.
#include <algorithm>
#include <numeric>

#include "vmslam/sparse/ordering.hpp"

namespace vmslam::sparse {
namespace {

/// Longer lists are not searched, so that a node with 10^5 neighbours costs nothing extra: its neighbours are left.
constexpr Node longest = 256;

/// Neighbours of every node, lists that only become shorter.
struct Lists : Neighbours {
    std::vector<Node> length;

    explicit Lists(const Pattern& pattern) : Neighbours{std::vector<Index>(pattern.size() + 1, 0), {}} {
        const auto for_each = [&](const auto& use) {
            for (Node j = 0; j < pattern.size(); ++j)
                for (Index p = pattern.start[j]; p < pattern.start[j + 1] - 1; ++p)
                    use(static_cast<Node>(pattern.rows[p]), j);
        };
        for_each([&](Node i, Node j) { ++start[i + 1], ++start[j + 1]; });
        std::partial_sum(start.begin(), start.end(), start.begin());
        list.resize(start.back());
        length.assign(pattern.size(), 0);
        for_each([&](Node i, Node j) { list[start[i] + length[i]++] = j, list[start[j] + length[j]++] = i; });
    }

    std::span<Node> now(Node v) { return {list.data() + start[v], static_cast<std::size_t>(length[v])}; }

    /// Put b in the place of v in the list of a, where b is another node that is not there yet.
    void replace(Node a, Node v, Node b) {
        const auto own = now(a);
        const auto place = std::find(own.begin(), own.end(), v);
        if (a != b && std::find(own.begin(), own.end(), b) == own.end())
            *place = b;
        else
            *place = own[--length[a]];
    }

    /// Take a node of degree one or two out and tie its neighbours together; returns them, the longer list last.
    std::pair<Node, Node> eliminate(Node v) {
        auto [a, b] = std::pair(now(v).front(), now(v).back());
        if (length[b] < length[a]) std::swap(a, b);
        replace(a, v, b);
        if (a != b) replace(b, v, a);
        return {a, b};
    }
};

}  // namespace

// Minimum degree would begin with the same nodes, but each would cost an update of the quotient graph. Most poses of a
// trajectory are of this kind, and here each costs a few places of lists.
Reduced without_low_degrees(const Pattern& pattern) {
    Lists lists(pattern);
    const Node n = pattern.size();
    Reduced reduced;
    std::vector<char> gone(n, 0);
    std::vector<Node> stack;
    for (Node next = 0; next < n; ++next) {
        if (!gone[next] && lists.length[next] <= 2) stack.push_back(next);
        while (!stack.empty()) {
            const Node v = stack.back();
            stack.pop_back();
            const auto around = lists.now(v);
            if (gone[v] || std::ranges::any_of(around, [&](Node w) { return lists.length[w] > longest; })) continue;
            gone[v] = 1;
            reduced.head.push_back(v);
            if (around.empty()) continue;
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
        for (const Node w : lists.now(v)) rest.list.push_back(number[w]);
        rest.start.push_back(static_cast<Index>(rest.list.size()));
    }
    return reduced;
}

}  // namespace vmslam::sparse
