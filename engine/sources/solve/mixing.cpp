#include "vmslam/solve/mixing.hpp"

#include <algorithm>
#include <cmath>

namespace vmslam::solve {
namespace {

constexpr std::size_t depth = 8;      ///< so many differences are mixed
constexpr double begin_below = 0.1;   ///< the root mean square of f from which on g is nearly linear
constexpr double negligible = 1e-10;  ///< a difference with no more than this part of its own counts as spanned by newer ones

using Column = std::vector<double>;

double dot(const Column& a, const Column& b) {
    double total = 0.0;
    for (std::size_t k = 0; k < a.size(); ++k) total += a[k] * b[k];
    return total;
}

double root_mean_square(std::span<const double> f) {
    double total = 0.0;
    for (const double value : f) total += value * value;
    return std::sqrt(total / static_cast<double>(f.size()));
}

/// The c that minimises |b - A c|, A given by its columns, by modified Gram-Schmidt orthogonalisation from the last column to
/// the first; c is 0 for columns that those after them span.
std::vector<double> least_squares(std::vector<Column> A, Column b) {
    const std::size_t m = A.size();
    std::vector<Column> R(m, Column(m, 0.0));
    const auto subtract = [](Column& y, double part, const Column& q) {
        for (std::size_t k = 0; k < y.size(); ++k) y[k] -= part * q[k];
    };
    std::vector<double> c(m, 0.0);
    for (std::size_t j = m; j-- > 0;) {
        const double size = std::sqrt(dot(A[j], A[j]));
        for (std::size_t i = m; --i > j;)
            if (R[i][i] > 0) subtract(A[j], R[i][j] = dot(A[i], A[j]), A[i]);
        const double rest = std::sqrt(dot(A[j], A[j]));
        if (!(rest > negligible * size)) continue;
        R[j][j] = rest;
        for (double& value : A[j]) value /= rest;
        subtract(b, c[j] = dot(A[j], b), A[j]);
    }
    for (std::size_t j = 0; j < m; ++j) {
        for (std::size_t i = 0; i < j; ++i) c[j] -= R[j][i] * c[i];
        c[j] = R[j][j] > 0 ? c[j] / R[j][j] : 0.0;
    }
    return c;
}

}  // namespace

std::vector<double> AndersonMixing::next(std::span<const double> x, std::span<const double> f) {
    std::vector<double> moved(x.begin(), x.end());
    for (std::size_t k = 0; k < moved.size(); ++k) moved[k] += f[k];
    const double size = root_mean_square(f);
    if (size > begin_below || (!kept_.empty() && size > 2 * root_mean_square(kept_.back().f))) {
        kept_.clear();
        return moved;
    }
    kept_.push_back({{x.begin(), x.end()}, {f.begin(), f.end()}});
    if (kept_.size() > depth + 1) kept_.pop_front();
    if (kept_.size() < 2) return moved;
    const auto difference = [](const Column& later, const Column& earlier) {
        Column out(later.size());
        for (std::size_t k = 0; k < out.size(); ++k) out[k] = later[k] - earlier[k];
        return out;
    };
    std::vector<Column> dx, df;
    for (std::size_t k = 1; k < kept_.size(); ++k) {
        dx.push_back(difference(kept_[k].x, kept_[k - 1].x));
        df.push_back(difference(kept_[k].f, kept_[k - 1].f));
    }
    const std::vector<double> gamma = least_squares(df, {f.begin(), f.end()});
    for (std::size_t j = 0; j < gamma.size(); ++j)
        for (std::size_t k = 0; k < moved.size(); ++k) moved[k] -= (dx[j][k] + df[j][k]) * gamma[j];
    return moved;
}

}  // namespace vmslam::solve
