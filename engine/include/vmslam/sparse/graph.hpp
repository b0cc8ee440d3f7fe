// Patterns of sparse symmetric matrices, as graphs of nodes: two nodes are neighbours where the matrix has a block.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

namespace vmslam::sparse {

using Node = std::int32_t;
using Index = std::int64_t;  ///< into arrays of entries or nodes

/// The upper triangle by columns: column j has the rows `rows[start[j]]` to `rows[start[j + 1] - 1]`, ascending, j last.
struct Pattern {
    std::span<const Index> start, rows;

    Node size() const { return static_cast<Node>(start.size() - 1); }

    /// The first column whose rows do not ascend to the diagonal, or -1.
    Node fault() const;
};

/// Neighbours of every node, without the node itself: those of v are `list[start[v]]` to `list[start[v + 1] - 1]`.
struct Neighbours {
    std::vector<Index> start;
    std::vector<Node> list;

    Node size() const { return static_cast<Node>(start.size() - 1); }
    std::span<const Node> of(Node v) const {
        return {list.data() + start[v], static_cast<std::size_t>(start[v + 1] - start[v])};
    }
    Node degree(Node v) const { return static_cast<Node>(start[v + 1] - start[v]); }
};

/// An order of elimination: the node that is eliminated k-th.
using Order = std::vector<Node>;

/// The place of every node in an order.
Order inverse(std::span<const Node> order);

}  // namespace vmslam::sparse
