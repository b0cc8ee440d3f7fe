#include "vmslam/solve/anderson.hpp"

#include <algorithm>
#include <cmath>

#include "vmslam/solve/run.hpp"

namespace vmslam::solve {
namespace {

constexpr std::size_t depth = 8;      ///< so many differences are mixed
constexpr double begin_below = 0.1;   ///< the root mean square of f from which on g is nearly linear
constexpr double negligible = 1e-10;  ///< smaller singular values, relative to the largest, count as zero
constexpr int most_sweeps = 30;

using Column = std::vector<double>;

double root_mean_square(std::span<const double> f) { return std::sqrt(inner(f, f) / static_cast<double>(f.size())); }

/// Turn the columns a and b, and those of V, so that a' b = 0 (one-sided Jacobi rotation); false where they were orthogonal.
bool orthogonalise(Column& a, Column& b, Column& va, Column& vb) {
    const double aa = inner(a, a), bb = inner(b, b), ab = inner(a, b);
    if (!(std::abs(ab) > 1e-15 * std::sqrt(aa * bb))) return false;
    const double zeta = (bb - aa) / (2 * ab);
    const double t = (zeta >= 0 ? 1.0 : -1.0) / (std::abs(zeta) + std::sqrt(1 + zeta * zeta));
    const double c = 1 / std::sqrt(1 + t * t), s = c * t;
    const auto turn = [&](Column& p, Column& q) {
        for (std::size_t k = 0; k < p.size(); ++k) {
            const double first = p[k], second = q[k];
            p[k] = c * first - s * second;
            q[k] = s * first + c * second;
        }
    };
    turn(a, b);
    turn(va, vb);
    return true;
}

/// The shortest c that minimises |b - A c|, A given by its columns; singular values below 1e-10 of the largest count as 0.
///
/// The columns are reduced to a triangle by Householder reflections, whose singular value decomposition U S V' follows from
/// Jacobi rotations; the result is V S^-1 U' b.
std::vector<double> least_squares(std::vector<Column> A, Column b) {
    const std::size_t m = A.size(), rows = b.size(), r = std::min(m, rows);
    for (std::size_t j = 0; j < r; ++j) {
        Column v(A[j].begin() + j, A[j].end());
        const double norm = std::sqrt(inner(v, v));
        if (norm == 0) continue;
        v[0] += std::copysign(norm, v[0]);
        const double half = norm * std::abs(v[0]);
        const auto reflect = [&](Column& y) {
            const double total = inner(v, std::span(y).subspan(j));
            for (std::size_t k = j; k < rows; ++k) y[k] -= total / half * v[k - j];
        };
        for (std::size_t c = j; c < m; ++c) reflect(A[c]);
        reflect(b);
    }
    std::vector<Column> V(m, Column(m, 0.0));
    for (std::size_t j = 0; j < m; ++j) {
        A[j].resize(r);
        for (std::size_t k = j + 1; k < r; ++k) A[j][k] = 0.0;
        V[j][j] = 1.0;
    }
    b.resize(r);
    bool turned = true;
    for (int sweep = 0; turned && sweep < most_sweeps; ++sweep) {
        turned = false;
        for (std::size_t i = 0; i < m; ++i)
            for (std::size_t j = i + 1; j < m; ++j) turned |= orthogonalise(A[i], A[j], V[i], V[j]);
    }
    double largest = 0.0;
    for (const Column& a : A) largest = std::max(largest, std::sqrt(inner(a, a)));
    std::vector<double> out(m, 0.0);
    for (std::size_t j = 0; j < m; ++j) {
        const double square = inner(A[j], A[j]);
        if (!(std::sqrt(square) > negligible * largest)) continue;
        const double part = inner(A[j], b) / square;
        for (std::size_t k = 0; k < m; ++k) out[k] += part * V[j][k];
    }
    return out;
}

}  // namespace

std::vector<double> AndersonAcceleration::next(std::span<const double> x, std::span<const double> f) {
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
