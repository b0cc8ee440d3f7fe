// Symbolic analysis: the supernodes of L, which columns are factorised together, and where their numbers are stored.
#pragma once

#include <vector>

#include "vmslam/sparse/graph.hpp"

namespace vmslam::sparse {

/// Rows of fronts come in groups of so many numbers, counted from the last row, so that vectors never cross cache lines.
inline constexpr Index group = 8;
constexpr Index grouped(Index rows) { return (rows + group - 1) & ~(group - 1); }

/// The real numbers of a block: `rows` for each of `columns`. A complex column counts as two, its real part first.
struct BlockShape {
    int rows = 3, columns = 3;
};

/// One supernode: `w` nodes that are eliminated together, and `r` nodes below, to which they are tied.
///
/// Its panel holds the w columns of L, with `pad` unused rows on top; its update matrix what it adds to Omega of the nodes
/// below, with `update_pad` rows on top.
struct Front {
    Index w, r;
    Index pad, height, update_pad, update_height;

    Front(const BlockShape& shape, Index w, Index r)
        : w(w), r(r), height(grouped(shape.rows * (w + r))), update_height(grouped(shape.rows * r)) {
        pad = height - shape.rows * (w + r);
        update_pad = update_height - shape.rows * r;
    }
};

/// A block of the matrix: its number, whether it enters transposed, and its row and column in the front, in nodes.
struct Entry {
    Index block_and_transposed;
    Node row, column;
    Index block() const { return block_and_transposed >> 1; }
    bool transposed() const { return block_and_transposed & 1; }
};

/// The structure of L in the order of elimination, for blocks of one shape. Supernodes are numbered in that order.
struct Symbolic {
    BlockShape shape;
    Order order, position;         ///< the node eliminated k-th, and the inverse
    std::vector<Node> first;       ///< (s+1) the first column of each supernode
    std::vector<Index> row_start;  ///< (s+1) into the next three
    std::vector<Node> rows;        ///< the rows below the diagonal block of each supernode, ascending
    std::vector<Node> relative;    ///< where those rows stand in the front of the parent
    std::vector<Node> run_end;     ///< one past the last row of the run of consecutive `relative` that each belongs to
    std::vector<Node> split;       ///< (s) the first row that is not among the parent's own columns
    std::vector<Node> parent;      ///< (s) -1 for roots
    std::vector<Node> child_start, children;
    std::vector<Index> panel_start;  ///< (s+1) where the panel of each supernode begins
    std::vector<Index> stack_start;  ///< (s) where its update matrix does
    Index stack_size = 0;
    std::vector<Index> entry_start;  ///< (s+1) into the entries
    std::vector<Entry> entries;
    std::vector<Node> row_length;  ///< (n) the blocks left of the diagonal in each row of L, without zeros
    std::vector<Node> part;        ///< (s) the thread of each supernode; see `divide`
    int parts = 1, threads = 1;
    Index tallest = 0;   ///< the rows of the tallest front
    Index widest = 0;    ///< the most nodes of a supernode
    Index blocks = 0;    ///< of L, without the zeros that amalgamation adds

    Node nodes() const { return static_cast<Node>(order.size()); }
    Node supernodes() const { return static_cast<Node>(first.size() - 1); }
    Front front(Node s) const { return {shape, first[s + 1] - first[s], row_start[s + 1] - row_start[s]}; }
    /// The supernode of a column.
    Node owner(Node column) const;
};

/// The structure of L for an order of elimination, which amalgamation may change to an equivalent one.
Symbolic analyze(const Pattern& pattern, std::span<const Node> order, BlockShape shape, int threads);

/// The same structure for blocks of another shape.
Symbolic reshaped(Symbolic symbolic, BlockShape shape);

/// The same structure with its supernodes given to another number of threads.
void divide(Symbolic& symbolic, int threads);

// --- the steps of which these are made

/// For each row k in the order of elimination its columns before k.
struct RowLists {
    std::vector<Index> start;
    std::vector<Node> columns;
};
RowLists permuted(const Pattern& pattern, std::span<const Node> position);

/// The elimination tree (Liu 1990): the parent of each column, -1 for roots; the blocks of L in each column, with the
/// diagonal, and those in each row, without.
struct EliminationTree {
    std::vector<Node> parent, count, row_length;
    explicit EliminationTree(const RowLists& lists);
    Index blocks() const;
    double flops(int rows) const;
};

/// Supernodes by amalgamation wherever the cost model gains: the columns in the new order, the first column of each
/// supernode and its rows below, in nodes.
struct Supernodes {
    std::vector<Node> columns, first, below;
};
Supernodes amalgamate(const EliminationTree& tree, const BlockShape& shape);

}  // namespace vmslam::sparse
