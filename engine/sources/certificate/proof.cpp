#include "vmslam/certificate/proof.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace vmslam::certificate {

bool take_upper(std::span<const double> matrices, Place count, int d, double tolerance, std::span<double> rows) {
    for (Place e = 0; e < count; ++e) {
        const double* const W = matrices.data() + e * d * d;
        for (int j = 0, k = 0; j < d; ++j)
            for (int i = 0; i <= j; ++i, ++k) {
                const double apart = std::abs(W[i * d + j] - W[j * d + i]);
                if (apart > tolerance * (std::abs(W[i * d + i]) + std::abs(W[j * d + j]))) return false;
                rows[6 * e + k] = W[i * d + j];
            }
    }
    return true;
}

std::vector<Place> hold_roots(std::span<const Place> first, std::span<const Place> second, std::span<bool> free) {
    const auto n = static_cast<Place>(free.size());
    std::vector<Place> ends(n, 0), parent(n + 1);
    // node n is the world, which is also every node that is held
    std::iota(parent.begin(), parent.end(), 0);
    const auto root = [&](Place a) {
        for (; parent[a] != a; a = parent[a]) parent[a] = parent[parent[a]];
        return a;
    };
    // the lower number becomes the root, so that the first pose of a piece is held
    const auto join = [&](Place a, Place b) {
        a = root(a), b = root(b);
        if (a != b) parent[std::max(a, b)] = std::min(a, b);
    };
    for (std::size_t e = 0; e < first.size(); ++e) {
        if (first[e] >= 0) ++ends[first[e]];
        ++ends[second[e]];
        join(first[e] >= 0 ? first[e] : n, second[e]);
    }
    for (Place k = 0; k < n; ++k)
        if (!free[k]) join(n, k);
    const Place world = root(n);
    for (Place k = 0; k < n; ++k)
        if (parent[k] == k && k != world) free[k] = false;
    return ends;
}

Margins margins(std::span<const double> scale, std::span<const double> shifts, std::span<const double> summation,
                std::span<const double> rounding, std::span<const Node> order) {
    Margins out{std::vector<double>(scale.size()), std::vector<double>(scale.size(), 1.0)};
    const double largest = rounding.empty() ? 0.0 : *std::max_element(rounding.begin(), rounding.end());
    for (std::size_t k = 0; k < order.size(); ++k)
        for (int c = 0; c < 2; ++c) {
            const Place i = order[k], at = 2 * i + c;
            const double size = scale[at] + (c == 0 ? shifts[i] : 0.0);
            out.assembled[at] = summation[i] * size;
            if (scale[at] > 0) out.margin[at] = out.assembled[at] + 2 * std::sqrt(rounding[k] * largest) * size;
        }
    return out;
}

std::vector<std::complex<double>> changed(std::span<const std::complex<double>> values, std::span<const Place> column_start,
                                          std::span<const double> scale, std::span<const double> shifts,
                                          std::span<const double> assembled, std::span<const double> margin) {
    std::vector<std::complex<double>> out(values.begin(), values.end());
    for (std::size_t j = 0; j + 1 < column_start.size(); ++j)
        for (int c = 0; c < 2; ++c) {
            const std::size_t at = 2 * j + c;
            const double change = (c == 0 ? shifts[j] : 0.0) - assembled[at] - 2 * margin[at];
            out[4 * (column_start[j + 1] - 1) + 3 * c] += scale[at] > 0 ? change : 1.0;
        }
    return out;
}

}  // namespace vmslam::certificate
