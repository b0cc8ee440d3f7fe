#include "vmslam/association/growth.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

namespace vmslam::association {
namespace {

using Small = std::array<double, most_coordinates * most_coordinates>;
constexpr double infinity = std::numeric_limits<double>::infinity();

/// nu' S^-1 nu and the evidence of a pair.
struct Weighed {
    double squares, evidence;
};

class Growth {
   public:
    Growth(std::span<const Number> begin, const Pairs& pairs, const GrowthRules& rules)
        : pairs_(pairs),
          rules_(rules),
          d_(pairs.residuals.d),
          count_(pairs.residuals.size()),
          width_(count_ * d_),
          nu_(pairs.residuals.nu.begin(), pairs.residuals.nu.end()),
          S_(pairs.residuals.covariance.begin(), pairs.residuals.covariance.end()),
          free_(pairs.allowed.begin(), pairs.allowed.end()) {
        std::copy_if(begin.begin(), begin.end(), std::back_inserter(given_), [](Number c) { return c >= 0; });
        grown_.members.assign(count_, 0);
        grown_.second.fill(-1);
    }

    Grown run() {
        for (std::size_t next = 0; next < given_.size(); ++next) {
            const Weighed weighed = weigh(given_[next]);
            if (!take(given_[next], weighed.squares <= rules_.gate_of_given ? weighed.evidence : -infinity, next + 1))
                return std::move(grown_);
        }
        while (rules_.grow) {
            const auto [best, evidence] = most_evident();
            if (best < 0 || !take(best, evidence, given_.size())) break;
        }
        return std::move(grown_);
    }

   private:
    /// w_c + log N(nu_c; 0, S_cc), both conditioned on the pairs so far, by the Cholesky factor of S_cc.
    Weighed weigh(Number c) const {
        Small L;
        std::array<double, most_coordinates> white;
        double squares = 0.0, log_determinant = 0.0;
        for (std::size_t j = 0; j < d_; ++j) {
            const double* const S = row(c, j) + c * d_;
            white[j] = nu_[c * d_ + j];
            for (std::size_t k = 0; k <= j; ++k) {
                double value = S[k];
                for (std::size_t i = 0; i < k; ++i) value -= L[j * d_ + i] * L[k * d_ + i];
                if (k == j && !(value > 0)) return {infinity, -infinity};
                L[j * d_ + k] = k == j ? std::sqrt(value) : value / L[k * d_ + k];
            }
            for (std::size_t k = 0; k < j; ++k) white[j] -= L[j * d_ + k] * white[k];
            white[j] /= L[j * d_ + j];
            squares += white[j] * white[j];
            log_determinant += 2 * std::log(L[j * d_ + j]);
        }
        const double constant = 0.5 * static_cast<double>(d_) * std::log(2 * std::numbers::pi);
        return {squares, pairs_.weights[c] - 0.5 * (squares + log_determinant) - constant};
    }

    /// The free pair with the most evidence, if that is above zero. After the first pair, keep the best second ones.
    std::pair<Number, double> most_evident() {
        Number best = -1;
        double most = 0.0;
        for (std::size_t c = 0; c < count_; ++c) {
            if (!free_[c]) continue;
            const auto [squares, evidence] = weigh(c);
            if (squares > rules_.gate) continue;
            if (taken_ == 1) keep_second(c, evidence);
            if (evidence > most) best = c, most = evidence;
        }
        return {best, most};
    }

    /// Keep the pairs with the most evidence, in no order.
    void keep_second(Number c, double evidence) {
        Number* worst = nullptr;
        double least = evidence;
        for (Number& other : grown_.second) {
            if (other < 0) {
                other = c;
                return;
            }
            const double its = weigh(other).evidence;
            if (its < least) worst = &other, least = its;
        }
        if (worst) *worst = c;
    }

    /// Add a pair, and condition the pairs that may still come on it. False where the evidence is not finite.
    bool take(Number b, double evidence, std::size_t given_from) {
        grown_.evidence += evidence;
        if (!std::isfinite(grown_.evidence)) return false;
        grown_.members[b] = 1;
        ++taken_;
        for (std::size_t c = 0; c < count_; ++c)
            if (pairs_.items[c] == pairs_.items[b] || pairs_.landmarks[c] == pairs_.landmarks[b]) free_[c] = false;
        const Small inverse = inverse_of(b);
        const auto to_come = [&](std::size_t c) {
            return (rules_.grow && free_[c]) ||
                   std::find(given_.begin() + given_from, given_.end(), Number(c)) != given_.end();
        };
        for (std::size_t c = 0; c < count_; ++c)
            if (to_come(c)) condition(c, b, inverse);
        return true;
    }

    /// nu_c - G nu_b and S_c - G S_b with the gain G = S_cb S_bb^-1.
    void condition(std::size_t c, std::size_t b, const Small& inverse) {
        Small gain{};
        for (std::size_t r = 0; r < d_; ++r)
            for (std::size_t q = 0; q < d_; ++q)
                for (std::size_t s = 0; s < d_; ++s) gain[r * d_ + q] += row(c, r)[b * d_ + s] * inverse[s * d_ + q];
        for (std::size_t r = 0; r < d_; ++r)
            for (std::size_t q = 0; q < d_; ++q) {
                const double g = gain[r * d_ + q];
                nu_[c * d_ + r] -= g * nu_[b * d_ + q];
                double* const to = row(c, r);
                const double* const from = row(b, q);
                for (std::size_t column = 0; column < width_; ++column) to[column] -= g * from[column];
            }
    }

    /// S_bb^-1 by elimination without pivoting: `weigh` has found S_bb positive definite.
    Small inverse_of(std::size_t b) const {
        Small A, X{};
        for (std::size_t r = 0; r < d_; ++r) {
            for (std::size_t q = 0; q < d_; ++q) A[r * d_ + q] = row(b, r)[b * d_ + q];
            X[r * d_ + r] = 1.0;
        }
        for (std::size_t p = 0; p < d_; ++p) {
            const double pivot = 1.0 / A[p * d_ + p];
            for (std::size_t q = 0; q < d_; ++q) A[p * d_ + q] *= pivot, X[p * d_ + q] *= pivot;
            for (std::size_t r = 0; r < d_; ++r) {
                if (r == p) continue;
                const double f = A[r * d_ + p];
                for (std::size_t q = 0; q < d_; ++q) A[r * d_ + q] -= f * A[p * d_ + q], X[r * d_ + q] -= f * X[p * d_ + q];
            }
        }
        return X;
    }

    double* row(std::size_t c, std::size_t r) { return S_.data() + (c * d_ + r) * width_; }
    const double* row(std::size_t c, std::size_t r) const { return S_.data() + (c * d_ + r) * width_; }

    const Pairs& pairs_;
    const GrowthRules& rules_;
    std::size_t d_, count_, width_, taken_ = 0;
    std::vector<double> nu_, S_;
    std::vector<char> free_;  ///< which pairs may still be added
    std::vector<Number> given_;
    Grown grown_;
};

}  // namespace

Grown grown_from(std::span<const Number> begin, const Pairs& pairs, const GrowthRules& rules) {
    return Growth(begin, pairs, rules).run();
}

}  // namespace vmslam::association
