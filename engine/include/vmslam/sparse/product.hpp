// Products of dense panels, stored by columns. Rows come in groups of eight that begin at cache lines.
#pragma once

#include <algorithm>
#include <cstdint>

#include "vmslam/sparse/simd.hpp"

namespace vmslam::sparse {

using Step = std::int64_t;

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

}  // namespace vmslam::sparse
