#include "vmslam/edges/inverses.hpp"

#include <array>
#include <cmath>

namespace vmslam::edges {
namespace {

/// The inverse of one matrix by Gauss-Jordan elimination; false where a pivot is not above `least`.
bool invert(const double* matrix, std::size_t d, double least, double* out) {
    std::array<double, 3> size;
    std::array<std::array<double, 3>, 3> unit;
    for (std::size_t k = 0; k < d; ++k) size[k] = std::sqrt(matrix[k * d + k]);
    for (std::size_t i = 0; i < d; ++i)
        for (std::size_t j = 0; j < d; ++j) unit[i][j] = matrix[i * d + j] / size[i] / size[j];
    for (std::size_t k = 0; k < d; ++k) {
        const double pivot = unit[k][k];
        if (!(pivot > least)) return false;
        unit[k][k] = 1.0;
        for (std::size_t j = 0; j < d; ++j) unit[k][j] /= pivot;
        for (std::size_t i = 0; i < d; ++i) {
            if (i == k) continue;
            const double factor = unit[i][k];
            unit[i][k] = 0.0;
            for (std::size_t j = 0; j < d; ++j) unit[i][j] -= factor * unit[k][j];
        }
    }
    bool finite = true;
    for (std::size_t i = 0; i < d; ++i)
        for (std::size_t j = 0; j < d; ++j) {
            out[i * d + j] = (unit[i][j] + unit[j][i]) / 2 / size[i] / size[j];
            finite &= std::isfinite(out[i * d + j]);
        }
    return finite;
}

}  // namespace

Index inverses(std::span<const double> matrices, std::size_t d, double least, std::span<double> out) {
    for (std::size_t k = 0; k < matrices.size() / (d * d); ++k)
        if (!invert(matrices.data() + d * d * k, d, least, out.data() + d * d * k)) return static_cast<Index>(k);
    return -1;
}

}  // namespace vmslam::edges
