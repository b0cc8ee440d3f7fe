#include "vmslam/sparse/symbolic.hpp"

#include <algorithm>
#include <numeric>

#include "vmslam/sparse/ordering.hpp"
#include "vmslam/sparse/pattern.hpp"

namespace vmslam::sparse {
namespace {

/// The supernode of each column.
std::vector<Node> owners(const SupernodeTree& s) {
    std::vector<Node> owner(s.nodes());
    for (Node t = 0; t < s.supernodes(); ++t) std::fill(owner.begin() + s.first[t], owner.begin() + s.first[t + 1], t);
    return owner;
}

/// The rows of every supernode and the tree, by walking the row subtrees on the tree of supernodes.
void find_rows(SupernodeTree& s, const std::vector<Node>& below, const RowLists& lists) {
    const Node count = s.supernodes();
    const std::vector<Node> owner = owners(s);
    s.row_start.assign(count + 1, 0);
    std::partial_sum(below.begin(), below.end(), s.row_start.begin() + 1, std::plus<Index>());
    s.rows.resize(s.row_start[count]);
    s.parent.assign(count, -1);
    std::vector<Index> fill(s.row_start.begin(), s.row_start.end() - 1);
    std::vector<Node> mark(count, -1);
    for (Node k = 0; k < s.nodes(); ++k) {
        mark[owner[k]] = k;
        for (Index p = lists.start[k]; p < lists.start[k + 1]; ++p)
            for (Node t = owner[lists.columns[p]]; mark[t] != k; t = s.parent[t]) {
                if (s.parent[t] < 0) s.parent[t] = owner[k];
                s.rows[fill[t]++] = k;
                mark[t] = k;
            }
    }
    Sorted by_parent(count + 1, count, [&](Index t) { return s.parent[t] < 0 ? count : s.parent[t]; });
    s.child_start = std::move(by_parent.start), s.children = std::move(by_parent.places);
}

/// Where the rows of every supernode stand in the front of its parent, and their runs.
void relate_to_parents(Symbolic& s) {
    s.relative.assign(s.rows.size(), -1);
    s.run_end.assign(s.rows.size(), 0);
    s.split.assign(s.supernodes(), 0);
    for (Node c = 0; c < s.supernodes(); ++c) {
        const Node t = s.parent[c];
        if (t < 0) continue;
        const Index low = s.row_start[c], high = s.row_start[c + 1];
        const Node w = s.width(t);
        Index q = s.row_start[t];
        for (Index p = low; p < high; ++p) {
            if (s.rows[p] < s.first[t + 1]) {
                s.relative[p] = s.rows[p] - s.first[t];
                ++s.split[c];
                continue;
            }
            while (s.rows[q] != s.rows[p]) ++q;
            s.relative[p] = static_cast<Node>(w + q - s.row_start[t]);
        }
        Index end = high;
        for (Index p = high - 1; p >= low; --p) {
            // with points, numbers may lie between the parent's own ones and those below
            const bool apart = s.points && p + 1 == low + s.split[c];
            if (p + 1 < high && (apart || s.relative[p + 1] != s.relative[p] + 1)) end = p + 1;
            s.run_end[p] = static_cast<Node>(end - low);
        }
    }
}

/// Where the numbers of all nodes stand in fronts and vectors.
void place_numbers(Symbolic& s) {
    const Node count = s.supernodes();
    const int block = s.shape.rows;
    s.wide.resize(count);
    s.tall.resize(count);
    s.head.assign(count + 1, 0);
    if (!s.points || s.shape.point_rows == block) {
        s.begins.clear();
        s.number.clear();
        for (Node t = 0; t < count; ++t) {
            s.wide[t] = s.width(t);
            s.tall[t] = s.height_below(t);
            s.head[t + 1] = block * static_cast<Index>(s.first[t + 1]);
        }
        return;
    }
    s.begins.resize(s.nodes() + s.rows.size() + count);
    s.number.resize(s.nodes());
    Node* at = s.begins.data();
    for (Node t = 0; t < count; ++t) {
        Node end = 0;
        for (Node k = s.first[t]; k < s.first[t + 1]; ++k, ++at) {
            s.number[k] = s.head[t] + end;
            *at = end;
            end += s.size(k);
        }
        s.wide[t] = (end + block - 1) / block;
        s.head[t + 1] = s.head[t] + block * s.wide[t];
        end = block * s.wide[t];
        for (Index q = s.row_start[t]; q < s.row_start[t + 1]; ++q, ++at) {
            *at = end;
            end += s.size(s.rows[q]);
        }
        *at++ = end;
        s.tall[t] = (end + block - 1) / block - s.wide[t];
    }
}

void place_panels(Symbolic& s) {
    s.panel_start.assign(s.supernodes() + 1, 0);
    s.tallest = s.widest = 0;
    for (Node t = 0; t < s.supernodes(); ++t) {
        const Front front = s.front(t);
        s.tallest = std::max(s.tallest, front.height);
        s.widest = std::max(s.widest, front.w);
        s.panel_start[t + 1] = s.panel_start[t] + s.shape.columns * front.w * front.height;
    }
}

/// Where every block of the matrix stands, sorted by supernode.
void place_entries(Symbolic& s, const Pattern& pattern, const std::vector<Node>& owner) {
    s.entry_start.assign(s.supernodes() + 1, 0);
    for (Node j = 0; j < s.nodes(); ++j)
        for (Index p = pattern.start[j]; p < pattern.start[j + 1]; ++p)
            ++s.entry_start[owner[std::min(s.position[pattern.rows[p]], s.position[j])] + 1];
    std::partial_sum(s.entry_start.begin(), s.entry_start.end(), s.entry_start.begin());
    std::vector<Index> fill(s.entry_start.begin(), s.entry_start.end() - 1);
    s.entries.resize(pattern.rows.size());
    for (Node j = 0; j < s.nodes(); ++j)
        for (Index p = pattern.start[j]; p < pattern.start[j + 1]; ++p) {
            const Node a = s.position[pattern.rows[p]], b = s.position[j];
            const auto [column, row] = std::minmax(a, b);
            const Node t = owner[column];
            Node local = row - s.first[t];
            if (row >= s.first[t + 1]) {
                const auto low = s.rows.begin() + s.row_start[t], high = s.rows.begin() + s.row_start[t + 1];
                local = s.width(t) + static_cast<Node>(std::lower_bound(low, high, row) - low);
            }
            // the block has the row node above the column node, and L needs the one whose row is eliminated later
            s.entries[fill[t]++] = {p, a <= b, s.point[row] != 0, s.point[column] != 0, local, column - s.first[t]};
        }
}

/// Update matrices on two stacks for each part of the tree, one for even and one for odd depths.
///
/// With one stack the update matrix of a supernode would have to be moved down over those of its children. The supernodes of
/// one part must be done in order, those of different parts may be done at the same time if neither needs the other. A part
/// that follows all others may take the children of its supernodes from them; they keep their places.
void place_updates(Symbolic& s) {
    const Node count = s.supernodes();
    std::vector<Node> stack(count, 0);
    for (Node t = count - 1; t >= 0; --t) {
        stack[t] += 2 * s.part[t];
        for (Node q = s.child_start[t]; q < s.child_start[t + 1]; ++q) stack[s.children[q]] = 1 - (stack[t] & 1);
    }
    std::vector<Index> top(2 * s.parts, 0), peak(2 * s.parts, 0);
    s.stack_start.assign(count, 0);
    for (Node t = 0; t < count; ++t) {
        const Front front = s.front(t);
        const Node d = stack[t];
        s.stack_start[t] = top[d];
        top[d] += s.shape.columns * front.r * front.update_height;
        peak[d] = std::max(peak[d], top[d]);
        for (Node q = s.child_start[t]; q < s.child_start[t + 1]; ++q)
            if (s.part[s.children[q]] == s.part[t]) {
                top[d ^ 1] = s.stack_start[s.children[q]];
                break;
            }
    }
    std::vector<Index> begin(peak.size());
    std::exclusive_scan(peak.begin(), peak.end(), begin.begin(), Index{0});
    for (Node t = 0; t < count; ++t) s.stack_start[t] += begin[stack[t]];
    s.stack_size = begin.back() + peak.back();
}

}  // namespace

Node SupernodeTree::owner(Node column) const {
    return static_cast<Node>(std::upper_bound(first.begin(), first.end(), column) - first.begin()) - 1;
}

namespace {

/// The supernodes of nodes whose neighbours before each `lists` gives, by the positions of the nodes in an order.
template <class Lists>
SupernodeTree supernodes_by(const Lists& lists, std::span<const Node> order, std::vector<Node> sizes, int planes) {
    const EliminationTree tree(lists(inverse(order)), std::move(sizes));
    const Supernodes groups = amalgamate(tree, planes);
    SupernodeTree s;
    s.blocks = tree.blocks();
    // amalgamation moves the columns of a supernode next to each other
    for (const Node column : groups.columns) {
        s.order.push_back(order[column]);
        s.row_length.push_back(tree.row_length[column]);
    }
    s.position = inverse(s.order);
    s.first = groups.first;
    find_rows(s, groups.below, lists(s.position));
    return s;
}

/// The first node of each group before the others: eliminating it ties these together.
RowLists stars(std::span<const Index> sizes, std::span<const Index> members, std::span<const Node> position) {
    std::vector<Node> first(members.size());
    RowLists lists{std::vector<Index>(position.size() + 1, 0), {}};
    Index begin = 0;
    for (const Index size : sizes) {
        Node lowest = static_cast<Node>(position.size());
        for (Index k = begin; k < begin + size; ++k) lowest = std::min(lowest, position[members[k]]);
        for (Index k = begin; k < begin + size; ++k) {
            first[k] = lowest;
            lists.start[position[members[k]] + 1] += position[members[k]] != lowest;
        }
        begin += size;
    }
    std::partial_sum(lists.start.begin(), lists.start.end(), lists.start.begin());
    lists.columns.resize(lists.start.back());
    std::vector<Index> fill(lists.start.begin(), lists.start.end() - 1);
    for (Index k = 0; k < begin; ++k)
        if (const Node row = position[members[k]]; row != first[k]) lists.columns[fill[row]++] = first[k];
    return lists;
}

}  // namespace

SupernodeTree supernodes_of(std::span<const Index> sizes, std::span<const Index> members, std::span<const Node> order) {
    return supernodes_by([&](const Order& position) { return stars(sizes, members, position); }, order,
                         std::vector<Node>(order.size(), 3), 1);
}

Symbolic analyze(const Pattern& pattern, std::span<const Node> order, BlockShape shape, int threads,
                 std::span<const char> points) {
    const auto is_point = [&](Node node) { return !points.empty() && points[node]; };
    std::vector<Node> sizes;
    for (const Node node : order) sizes.push_back(is_point(node) ? shape.point_rows : shape.rows);
    Symbolic s;
    static_cast<SupernodeTree&>(s) = supernodes_by([&](const Order& position) { return permuted(pattern, position); }, order,
                                                   std::move(sizes), shape.planes());
    s.shape = shape;
    for (const Node node : s.order) s.point.push_back(is_point(node));
    s.points = std::ranges::count(s.point, 1) > 0;
    relate_to_parents(s);
    place_entries(s, pattern, owners(s));
    place_numbers(s);
    place_panels(s);
    divide(s, threads);
    return s;
}

Symbolic analyze(const Pattern& pattern, BlockShape shape, int threads, std::span<const char> points) {
    return analyze(pattern, fill_reducing(pattern), shape, threads, points);
}

Symbolic reshaped(Symbolic symbolic, BlockShape shape) {
    symbolic.shape = shape;
    place_numbers(symbolic);
    place_panels(symbolic);
    divide(symbolic, symbolic.threads);
    return symbolic;
}

namespace {

/// The estimated time of a supernode [ns].
double time_of(const Symbolic& s, Node t) {
    const Front front = s.front(t);
    const double w = s.shape.rows * static_cast<double>(front.w), r = s.shape.rows * static_cast<double>(front.r);
    const double flops = w * w * w / 3.0 + w * w * r + w * r * r;
    const int planes = s.shape.planes();
    return 185.0 + planes * (1.0 * w * (w + r) + 0.3 * r * r) + planes * planes * 0.012 * flops;
}

constexpr double least = 1.0e6;  ///< the estimated time [ns] for which threads are started, which takes some 0.03 ms
constexpr double gain = 0.85;    ///< several threads must take less than this part of the time of one
constexpr int steps = 100;       ///< the most supernodes that are taken from the subtrees and left for the end

/// Give each subtree, one after the other, to the thread with the least work; returns the most work of a thread.
double give(std::span<const Node> subtrees, std::span<const double> work, int threads, std::vector<Node>& given) {
    std::vector<double> load(threads, 0.0);
    given.clear();
    for (const Node t : subtrees) {
        const auto thread = std::min_element(load.begin(), load.end());
        *thread += work[t];
        given.push_back(static_cast<Node>(thread - load.begin()));
    }
    return *std::max_element(load.begin(), load.end());
}

}  // namespace

// Each thread takes whole subtrees, and one does the rest of the tree afterwards. Every supernode is computed from the same
// numbers in the same order as on one thread, so that the factor does not depend on the number of threads, to the last bit.
//
// The tree is cut from the roots down, always in the largest subtree, and the subtrees are given to the threads, the largest
// first, each to the thread with the least work. The cut with the shortest estimated time is used.
void divide(Symbolic& s, int threads) {
    const Node count = s.supernodes();
    std::vector<double> own(count), subtree(count, 0.0);  // the times of a supernode, and of all below it too
    std::vector<Node> size(count, 1), tasks;
    double total = 0.0;
    for (Node t = 0; t < count; ++t) {
        own[t] = time_of(s, t);
        total += own[t];
        subtree[t] += own[t];
        if (s.parent[t] < 0) {
            tasks.push_back(t);
            continue;
        }
        subtree[s.parent[t]] += subtree[t];
        size[s.parent[t]] += size[t];
    }
    s.part.assign(count, 0);
    s.parts = 1;
    s.threads = threads;
    std::vector<Node> chosen, owner, given;
    if (total >= least && threads > 1) {
        double top = 0.0, best = gain * total;
        for (int step = 0; step < steps; ++step) {
            std::stable_sort(tasks.begin(), tasks.end(), [&](Node a, Node b) { return subtree[a] > subtree[b]; });
            if (const double time = top + give(tasks, subtree, threads, given); time < best) {
                best = time;
                chosen = tasks;
                owner = given;
            }
            const Node largest = tasks.front();
            top += own[largest];
            if (top > best || s.child_start[largest] == s.child_start[largest + 1]) break;
            tasks.erase(tasks.begin());
            tasks.insert(tasks.end(), s.children.begin() + s.child_start[largest],
                         s.children.begin() + s.child_start[largest + 1]);
        }
    }
    if (!chosen.empty()) {
        s.parts = threads + 1;
        std::fill(s.part.begin(), s.part.end(), threads);
        for (std::size_t k = 0; k < chosen.size(); ++k)
            std::fill(s.part.begin() + chosen[k] + 1 - size[chosen[k]], s.part.begin() + chosen[k] + 1, owner[k]);
    }
    place_updates(s);
}

}  // namespace vmslam::sparse
