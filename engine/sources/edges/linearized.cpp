#include "vmslam/edges/linearized.hpp"

#include <algorithm>
#include <array>

namespace vmslam::edges {
namespace {

/// C += sign A' B for A (rows, across) and B (rows, columns), by rows.
inline void add_product(double* C, double sign, const double* A, std::size_t across, const double* B, std::size_t columns,
                        std::size_t rows) {
    for (std::size_t r = 0; r < rows; ++r)
        for (std::size_t i = 0; i < across; ++i) {
            const double a = sign * A[r * across + i];
            for (std::size_t j = 0; j < columns; ++j) C[i * columns + j] += a * B[r * columns + j];
        }
}

/// W B for W (rows, rows), which is symmetric, and B (rows, columns).
inline void times(double* out, const double* W, const double* B, std::size_t columns, std::size_t rows) {
    std::fill_n(out, rows * columns, 0.0);
    add_product(out, 1.0, W, rows, B, columns, rows);
}

/// `add` for residuals of `d` numbers.
template <std::size_t d>
void add_rows(const Linearized& edges, System& system, const Border& border) {
    const std::size_t K = edges.parameters;
    std::array<double, 3 * d> WA, WB;
    std::array<double, d> We;
    std::vector<double> WP(d * K);
    for (std::size_t k = 0; k < edges.first.size(); ++k) {
        const Index i = edges.first[k], j = edges.second[k];
        const double *const W = edges.W + d * d * k, *const A = edges.A + 3 * d * k, *const B = edges.B + 3 * d * k;
        const double* const P = edges.P + d * K * k;
        times(WA.data(), W, A, 3, d);
        times(WB.data(), W, B, 3, d);
        times(We.data(), W, edges.e + d * k, 1, d);
        times(WP.data(), W, P, K, d);
        add_product(system.diagonal(i), 1.0, A, 3, WA.data(), 3, d);
        add_product(system.diagonal(j), 1.0, B, 3, WB.data(), 3, d);
        // only the upper triangle is stored, in which the first node of a block is the lower one
        if (i < j)
            add_product(system.block(edges.pairs[k]), 1.0, A, 3, WB.data(), 3, d);
        else
            add_product(system.block(edges.pairs[k]), 1.0, B, 3, WA.data(), 3, d);
        add_product(system.xi + 3 * i, -1.0, A, 3, We.data(), 1, d);
        add_product(system.xi + 3 * j, -1.0, B, 3, We.data(), 1, d);
        add_product(border.mixed + 3 * K * i, 1.0, A, 3, WP.data(), K, d);
        add_product(border.mixed + 3 * K * j, 1.0, B, 3, WP.data(), K, d);
        add_product(border.own, 1.0, P, K, WP.data(), K, d);
        add_product(border.gradient, -1.0, P, K, We.data(), 1, d);
    }
}

}  // namespace

void add(const Linearized& edges, System& system, const Border& border) {
    edges.rows == 3 ? add_rows<3>(edges, system, border) : add_rows<2>(edges, system, border);
}

}  // namespace vmslam::edges
