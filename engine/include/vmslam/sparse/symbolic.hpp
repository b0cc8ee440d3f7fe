// Symbolic analysis: the supernodes of L, groups of columns that are factorised together, and where their numbers are stored.
#pragma once

#include <type_traits>
#include <vector>

#include "vmslam/sparse/graph.hpp"

namespace vmslam::sparse {

/// Rows of fronts come in groups of so many numbers, counted from the last row, so that vectors never cross cache lines.
inline constexpr Index group = 8;
constexpr Index grouped(Index rows) { return (rows + group - 1) & ~(group - 1); }

/// The real numbers of a block: `rows` for each of `columns`. A complex column counts as two, its real part first. A point, a
/// node without a heading, has `point_rows` of them, from `point_first` on.
struct BlockShape {
    int rows = 3, columns = 3, point_rows = 2, point_first = 0;
    int planes() const { return columns / rows; }
};

/// One supernode: `w` blocks that are eliminated together, and `r` blocks below, to which they are tied. Without points each
/// node is a block. With points the numbers of the nodes of each of these two parts follow each other, and those of the
/// identity fill the last block.
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

/// A block of the matrix: its number, whether it enters transposed, whether its row and its column are those of points, and
/// its row and column in the front, in nodes.
struct Entry {
    Index code;
    Node row, column;

    Entry() = default;
    Entry(Index block, bool transposed, bool row_point, bool column_point, Node row, Node column)
        : code(8 * block + 4 * column_point + 2 * row_point + transposed), row(row), column(column) {}
    Index block() const { return code >> 3; }
    bool transposed() const { return code & 1; }
    bool row_point() const { return code & 2; }
    bool column_point() const { return code & 4; }
};

/// Where the numbers of nodes begin in a front. Without points they need no list.
template <class Block>
struct Begins {
    const Node* list;
    Node operator[](Index k) const { return list ? list[k] : Block::rows * static_cast<Node>(k); }
};

/// The supernodes in the order of elimination, by which they are numbered, and what L has in each. Columns are nodes in this
/// order.
struct SupernodeTree {
    Order order, position;  ///< the node eliminated k-th, and the inverse
    std::vector<Node> first;  ///< (s+1) the first column of each supernode
    std::vector<Index> row_start;  ///< (s+1) into the next three
    std::vector<Node> rows;  ///< the rows below the diagonal block of each supernode, ascending
    std::vector<Node> relative;  ///< where those rows stand in the front of the parent
    std::vector<Node> run_end;  ///< one past the last row of the run of consecutive `relative` that each belongs to
    std::vector<Node> split;  ///< (s) the first row that is not among the parent's own columns
    std::vector<Node> parent;  ///< (s) -1 for roots
    std::vector<Index> child_start, children;  ///< the roots come last, as the children of none
    std::vector<Node> row_length;  ///< (n) the blocks left of the diagonal in each row of L, without zeros
    Index blocks = 0;  ///< of L, without the zeros that amalgamation adds

    Node nodes() const { return static_cast<Node>(order.size()); }
    Node supernodes() const { return static_cast<Node>(first.size() - 1); }
    Node width(Node s) const { return first[s + 1] - first[s]; }
    Node height_below(Node s) const { return static_cast<Node>(row_start[s + 1] - row_start[s]); }
    /// The supernode of a column.
    Node owner(Node column) const;
};

/// Where the numbers of supernodes stand in fronts, vectors and panels, for blocks of one shape.
struct Layout {
    BlockShape shape;
    std::vector<char> point;  ///< (n) whether the node of each column is a point
    bool points = false;  ///< whether there are any
    std::vector<Node> wide, tall;  ///< (s) the blocks of each supernode, and those below; see `Front`
    Index tallest = 0, widest = 0;  ///< the rows of the tallest front, the most blocks of a supernode
    std::vector<Index> head;  ///< (s+1) where the numbers of each supernode begin in a vector, filled up to blocks
    std::vector<Node> begins;  ///< with points: where those of each node begin in the fronts; see `Symbolic::begin`
    std::vector<Index> number;  ///< with points: (n) where those of each column begin in a vector
    std::vector<Index> panel_start;  ///< (s+1) where the panel of each supernode begins
    std::vector<Index> entry_start;  ///< (s+1) into the blocks of the matrix
    std::vector<Entry> entries;

    Front front(Node s) const { return {shape, wide[s], tall[s]}; }
    int size(Node column) const { return point[column] ? shape.point_rows : shape.rows; }
    /// Of a column, the first number in a block that belongs to its node.
    int first_number(Node column) const { return point[column] ? shape.point_first : 0; }
    /// Where the numbers of a column begin in a vector.
    Index number_of(Node column) const { return number.empty() ? shape.rows * static_cast<Index>(column) : number[column]; }
    /// Whether nodes have blocks of different sizes.
    template <class Block>
    bool mixed() const {
        return Block::point_rows < Block::rows && points;
    }
};

/// Which thread factorises each supernode, and where that puts update matrices; see `divide`.
struct Schedule {
    int parts = 1, threads = 1;
    std::vector<Node> part;  ///< (s) one for each thread, and in the end one for the rest of the tree
    std::vector<Index> stack_start;  ///< (s) where the update matrix of each supernode begins
    Index stack_size = 0;
};

/// The structure of L.
struct Symbolic : SupernodeTree, Layout, Schedule {
    /// Where the numbers of the nodes of supernode s, and of those below, begin in its front; then where the last ones end.
    template <class Block>
    Begins<Block> begin(Node s) const {
        return {mixed<Block>() ? begins.data() + first[s] + row_start[s] + s : nullptr};
    }
};

/// work(i, at, count) for the nodes below supernode s: the first of their `count` numbers is number i of the front, and
/// number `at` of vectors.
template <class Block, class Work>
void each_below(const Symbolic& t, Node s, const Work& work) {
    Index i = Block::rows * static_cast<Index>(t.wide[s]);
    // for real blocks loops whose length the compiler knows; complex ones are solved with seldom
    if constexpr (Block::planes == 1)
        if (!t.mixed<Block>()) {
            for (Index q = t.row_start[s]; q < t.row_start[s + 1]; ++q, i += Block::rows)
                work(i, Block::rows * static_cast<Index>(t.rows[q]), std::integral_constant<int, Block::rows>());
            return;
        }
    if constexpr (Block::point_rows < Block::rows)
        for (Index q = t.row_start[s]; q < t.row_start[s + 1]; ++q) {
            const int count = t.size(t.rows[q]);
            work(i, t.number_of(t.rows[q]), count);
            i += count;
        }
}

/// work(node, at, count) for all columns: the first of the `count` numbers of its node is number `node` of a vector in the
/// order of nodes, which have a block each, and number `at` of one in the order of elimination.
template <class Block, class Work>
void each_column(const Symbolic& t, const Work& work) {
    constexpr Index rows = Block::rows;
    if constexpr (Block::planes == 1)
        if (!t.mixed<Block>()) {
            for (Node k = 0; k < t.nodes(); ++k)
                work(rows * t.order[k], rows * k, std::integral_constant<int, Block::rows>());
            return;
        }
    if constexpr (Block::point_rows < Block::rows)
        for (Node k = 0; k < t.nodes(); ++k) work(rows * t.order[k] + t.first_number(k), t.number_of(k), t.size(k));
}

/// The structure of L for an order of elimination, which amalgamation may change to an equivalent one. `points` (n, or none)
/// says which nodes are points.
Symbolic analyze(const Pattern& pattern, std::span<const Node> order, BlockShape shape, int threads,
                 std::span<const char> points = {});
/// The same for the order that `fill_reducing` finds.
Symbolic analyze(const Pattern& pattern, BlockShape shape, int threads, std::span<const char> points = {});

/// The supernodes alone, without `relative`, `run_end` and `split`, of real blocks of three, where groups of given sizes are
/// tied together, whose members follow each other.
SupernodeTree supernodes_of(std::span<const Index> sizes, std::span<const Index> members, std::span<const Node> order);

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
/// diagonal, and those in each row, without. `sizes` are the numbers of the node of each column, and `numbers` those below.
struct EliminationTree {
    std::vector<Node> parent, count, row_length, sizes, numbers;
    EliminationTree(const RowLists& lists, std::vector<Node> sizes);
    Index blocks() const;
    double flops() const;
};

/// Supernodes by amalgamation wherever the cost model gains: the columns in the new order, the first column of each
/// supernode and its rows below, in nodes.
struct Supernodes {
    std::vector<Node> columns, first, below;
};
Supernodes amalgamate(const EliminationTree& tree, int planes);

}  // namespace vmslam::sparse
