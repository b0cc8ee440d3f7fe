// Dense work on the panels of a supernode, stored by columns. Rows come in groups of eight that begin at cache lines.
#pragma once

#include <algorithm>
#include <cstring>

#include "vmslam/parallel.hpp"
#include "vmslam/sparse/block.hpp"

namespace vmslam::sparse {

/// Numbers by columns: the first one, and the step from column to column.
struct Columns {
    double* at;
    Step step;
};
struct ConstColumns {
    const double* at;
    Step step;
};
/// A right factor: the first number, the steps from row to row and from column to column.
struct Right {
    const double* at;
    Step down, across;
};

/// C = [C] - A B for `V` vectors of rows and `J` columns.
template <int N, int V, int J, bool add>
inline void product_tile(Columns c, ConstColumns a, Right b, Step depth) {
    Vector<N> total[J][V];
#pragma GCC unroll 8
    for (int j = 0; j < J; ++j)
#pragma GCC unroll 4
        for (int v = 0; v < V; ++v) total[j][v] = add ? load<N>(c.at + j * c.step + v * N) : Vector<N>{};
    for (Step k = 0; k < depth; ++k, a.at += a.step, b.at += b.down) {
        Vector<N> left[V];
#pragma GCC unroll 4
        for (int v = 0; v < V; ++v) left[v] = load<N>(a.at + v * N);
#pragma GCC unroll 8
        for (int j = 0; j < J; ++j) {
            const double right = b.at[j * b.across];
#pragma GCC unroll 4
            for (int v = 0; v < V; ++v) total[j][v] -= left[v] * right;
        }
    }
#pragma GCC unroll 8
    for (int j = 0; j < J; ++j)
#pragma GCC unroll 4
        for (int v = 0; v < V; ++v) store<N>(c.at + j * c.step + v * N, total[j][v]);
}

/// C = [C] - A B for `J` columns; `rows` is a multiple of 8.
template <int J, bool add>
inline void product_columns(Columns c, ConstColumns a, Right b, Step rows, Step depth) {
    constexpr int tall = 2 * lanes;
    Step i = 0;
    for (; i + tall <= rows; i += tall) product_tile<lanes, 2, J, add>({c.at + i, c.step}, {a.at + i, a.step}, b, depth);
    if (i < rows) product_tile<lanes, 1, J, add>({c.at + i, c.step}, {a.at + i, a.step}, b, depth);
}

constexpr Step group_of(Step row) { return row & ~(group - 1); }

/// The rows and columns of the blocks of A that are copied: they take a third of a second-level cache of 1 MB.
inline constexpr Step pack_rows = 240, pack_depth = 192;
/// Numbers that `product` needs for packing.
template <class Block>
constexpr Step packing(Step widest, Step tallest) {
    const Step depth = Block::columns * widest, right = Block::planes == 2 ? 4 * depth : 6 * pack_depth;
    return tallest * depth > 2 * pack_rows * pack_depth ? std::max(right, 6 * pack_depth) + pack_rows * pack_depth : right;
}

/// The rows of a right factor for one or two node columns, side by side, so that they lie in few cache lines.
template <class Block>
inline Right pack(Right b, Step depth, int few, double* packed) {
    if constexpr (Block::planes == 2) {
        for (Step k = 0; k < depth; k += 2) {
            const double *re = b.at + k * b.down, *im = re + b.down;
            double* t = packed + 4 * k;
            for (int c = 0; c < 2; ++c) {
                t[2 * c] = re[c];
                t[2 * c + 1] = -im[c];
                t[2 * c + 4] = im[c];
                t[2 * c + 5] = re[c];
            }
        }
        return {packed, 4, 1};
    } else {
        constexpr int both = 2 * Block::columns;
        for (Step k = 0; k < depth; ++k)
            for (int c = 0; c < Block::columns * few; ++c) packed[both * k + c] = b.at[k * b.down + c * b.across];
        return {packed, both, 1};
    }
}

/// C = [C] - A B^H for `few` node columns.
template <class Block, bool add>
inline void product_nodes(Columns c, ConstColumns a, Right b, Step rows, int few, Step depth) {
    if constexpr (Block::planes == 1)
        if (few == 2) return product_columns<2 * Block::columns, add>(c, a, b, rows, depth);
    product_columns<Block::columns, add>(c, a, b, rows, depth);
}

/// C = [C] - A B^H for `nodes` node columns. The rows of B begin at `b`; for complex blocks they are those of a panel. With
/// `diagonal` >= 0, the row of C in which the diagonal of its first node is, only the lower triangle.
template <class Block, bool add>
void product(Columns c, ConstColumns a, Right b, Step rows, Step nodes, Step depth, Step diagonal, double* packed) {
    constexpr int pair = Block::planes == 2 ? 1 : 2;
    const auto skipped = [&](Step j) { return diagonal < 0 ? Step{0} : group_of(diagonal + Block::rows * j); };
    // for few columns A is read once only
    if (rows * depth <= 2 * pack_rows * pack_depth || nodes <= pair) {
        for (Step j = 0; j < nodes; j += pair) {
            const int few = static_cast<int>(std::min<Step>(pair, nodes - j));
            const Step skip = skipped(j);
            const Right own{b.at + Block::rows * j * b.across, b.down, b.across};
            const Right right = Block::planes == 2 ? pack<Block>(own, depth, few, packed) : own;
            product_nodes<Block, add>({c.at + Block::columns * j * c.step + skip, c.step}, {a.at + skip, a.step}, right,
                                      rows - skip, few, depth);
        }
        return;
    }
    // blocks of A are copied to where they stay in the second-level cache and span few memory pages
    double* const left = packed;
    double* const right_at = packed + pack_rows * pack_depth;
    for (Step k = 0; k < depth; k += pack_depth) {
        const Step deep = std::min(pack_depth, depth - k);
        for (Step i = 0; i < rows; i += pack_rows) {
            const Step high = std::min(pack_rows, rows - i);
            for (Step q = 0; q < deep; ++q)
                std::memcpy(left + q * pack_rows, a.at + i + (k + q) * a.step, high * sizeof(double));
            for (Step j = 0; j < nodes; j += pair) {
                const Step skip = std::max<Step>(0, skipped(j) - i);
                if (skip >= high) break;
                const int few = static_cast<int>(std::min<Step>(pair, nodes - j));
                const Right right =
                    pack<Block>({b.at + Block::rows * j * b.across + k * b.down, b.down, b.across}, deep, few, right_at);
                const Columns target{c.at + Block::columns * j * c.step + i + skip, c.step};
                const ConstColumns source{left + skip, pack_rows};
                if (add || k > 0)
                    product_nodes<Block, true>(target, source, right, high - skip, few, deep);
                else
                    product_nodes<Block, false>(target, source, right, high - skip, few, deep);
            }
        }
    }
}

/// Add `n` numbers to each of `count` columns.
template <int count>
inline void add_rows(Columns t, ConstColumns s, Step n) {
    const auto add = [&]<Step width>(std::integral_constant<Step, width>) {
#pragma GCC unroll 4
        for (int k = 0; k < count; ++k)
            store<width>(t.at + k * t.step, load<width>(t.at + k * t.step) + load<width>(s.at + k * s.step));
        t.at += width, s.at += width, n -= width;
    };
    while (n >= 4) add(std::integral_constant<Step, 4>());
    if (n >= 2) add(std::integral_constant<Step, 2>());
    if (n > 0) {
#pragma GCC unroll 4
        for (int k = 0; k < count; ++k) t.at[k * t.step] += s.at[k * s.step];
    }
}

/// The flops from which on a product is shared among threads, and how many node columns one takes at a time.
inline constexpr double shared_flops = 1.0e7;
inline constexpr Step shared_nodes = 32;

/// How many of `most` threads a product of so many rows, depth and columns of `nodes` nodes is worth.
inline int threads_for(std::size_t most, Step nodes, Step rows, Step depth, Step columns) {
    const double flops = 2.0 * static_cast<double>(rows) * static_cast<double>(columns * depth);
    const Step chunks = (nodes + shared_nodes - 1) / shared_nodes;
    return flops < shared_flops ? 1 : static_cast<int>(std::min<Step>(static_cast<Step>(most), chunks));
}

}  // namespace vmslam::sparse
