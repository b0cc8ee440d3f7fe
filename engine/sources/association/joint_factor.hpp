// The evidence of pairs that join a hypothesis one after the other, each given the ones before it.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <vector>

#include "vmslam/association/search.hpp"

namespace vmslam::association {

/// nu' S^-1 nu and the evidence of a pair given the pairs before it.
struct Weighed {
    double squares, evidence;
};

/// S = L L' of the pairs of a hypothesis. Every pair has its own rows of L, so that pairs that may join next can be conditioned
/// on the ones that are there, and compared: `condition` in the order of these, then `weigh`.
class JointFactor {
   public:
    /// Of hypotheses with at most `most` pairs.
    JointFactor(const Pairs& pairs, std::size_t most)
        : pairs_(pairs),
          d_(pairs.residuals.d),
          columns_(most * d_),
          nu_(pairs.residuals.nu.begin(), pairs.residuals.nu.end()),
          white_(nu_.size()),
          L_(nu_.size() * columns_) {}

    /// Pair c given no other pair.
    void begin(std::size_t c) { std::copy_n(pairs_.residuals.nu.begin() + c * d_, d_, nu_.begin() + c * d_); }

    /// Pair c given pair b, too, which is number n of the hypothesis and has been weighed: the next columns of its rows, and nu.
    void condition(std::size_t c, std::size_t b, std::size_t n) {
        for (std::size_t r = 0; r < d_; ++r)
            for (std::size_t q = 0, k = n * d_; q < d_; ++q, ++k) {
                row(c, r)[k] = rest(c, r, b, q, n) / row(b, q)[k];
                nu_[c * d_ + r] -= row(c, r)[k] * white_[b * d_ + q];
            }
    }

    /// w_c + log N(nu_c; 0, S_cc) of pair c as number n, given the ones before it, and the last columns of its rows.
    Weighed weigh(std::size_t c, std::size_t n) {
        double squares = 0.0, log_determinant = 0.0;
        double* const white = white_.data() + c * d_;
        for (std::size_t j = 0; j < d_; ++j) {
            double* const L = row(c, j) + n * d_;
            white[j] = nu_[c * d_ + j];
            for (std::size_t k = 0; k <= j; ++k) {
                const double value = rest(c, j, c, k, n);
                if (k == j && !(value > 0)) return {infinity, -infinity};
                L[k] = k == j ? std::sqrt(value) : value / row(c, k)[n * d_ + k];
                if (k < j) white[j] -= L[k] * white[k];
            }
            white[j] /= L[j];
            squares += white[j] * white[j];
            log_determinant += 2 * std::log(L[j]);
        }
        const double constant = 0.5 * static_cast<double>(d_) * std::log(2 * std::numbers::pi);
        return {squares, pairs_.weights[c] - 0.5 * (squares + log_determinant) - constant};
    }

   private:
    static constexpr double infinity = std::numeric_limits<double>::infinity();

    double* row(std::size_t c, std::size_t r) { return L_.data() + (c * d_ + r) * columns_; }

    /// S less the product of the columns of L before number q of pair b, which is number n: what belongs to row r of pair c.
    double rest(std::size_t c, std::size_t r, std::size_t b, std::size_t q, std::size_t n) {
        const double *const L = row(c, r), *const other = row(b, q);
        double value = pairs_.residuals.row(c * d_ + r)[b * d_ + q];
        for (std::size_t i = 0; i < n * d_ + q; ++i) value -= L[i] * other[i];
        return value;
    }

    const Pairs& pairs_;
    std::size_t d_, columns_;
    std::vector<double> nu_, white_;  ///< given the pairs before; L^-1 of that
    std::vector<double> L_;           ///< (C d, columns) by rows
};

}  // namespace vmslam::association
