#include "vmslam/association/growth.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

namespace vmslam::association {
namespace {

constexpr double infinity = std::numeric_limits<double>::infinity();

/// nu' S^-1 nu and the evidence of a pair.
struct Weighed {
    double squares, evidence;
};

class Growth {
   public:
    Growth(std::span<const Number> begin, const Pairs& pairs, std::span<const Number> items, const GrowthRules& rules)
        : pairs_(pairs),
          items_(items),
          rules_(rules),
          d_(pairs.residuals.d),
          count_(pairs.residuals.size()),
          nu_(pairs.residuals.nu.begin(), pairs.residuals.nu.end()),
          white_(nu_.size()),
          L_(nu_.size() * nu_.size()),
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
    double* row(std::size_t c, std::size_t r) { return L_.data() + (c * d_ + r) * nu_.size(); }

    /// S less the product of the rows of L that are there: what belongs to row r of pair c in the column of number q of pair
    /// b.
    double rest(std::size_t c, std::size_t r, std::size_t b, std::size_t q) {
        const double *const L = row(c, r), *const other = row(b, q);
        double value = pairs_.residuals.row(c * d_ + r)[b * d_ + q];
        for (std::size_t i = 0; i < taken_ * d_ + q; ++i) value -= L[i] * other[i];
        return value;
    }

    /// w_c + log N(nu_c; 0, S_cc), both conditioned on the pairs so far, by the rows that L gets if the pair is taken.
    Weighed weigh(std::size_t c) {
        double squares = 0.0, log_determinant = 0.0;
        double* const white = white_.data() + c * d_;
        for (std::size_t j = 0; j < d_; ++j) {
            double* const L = row(c, j) + taken_ * d_;
            white[j] = nu_[c * d_ + j];
            for (std::size_t k = 0; k <= j; ++k) {
                const double value = rest(c, j, c, k);
                if (k == j && !(value > 0)) return {infinity, -infinity};
                L[k] = k == j ? std::sqrt(value) : value / row(c, k)[taken_ * d_ + k];
                if (k < j) white[j] -= L[k] * white[k];
            }
            white[j] /= L[j];
            squares += white[j] * white[j];
            log_determinant += 2 * std::log(L[j]);
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
        for (std::size_t c = 0; c < count_; ++c)
            if (items_[c] == items_[b] || pairs_.landmarks[c] == pairs_.landmarks[b]) free_[c] = false;
        const auto to_come = [&](std::size_t c) {
            return (rules_.grow && free_[c]) ||
                   std::find(given_.begin() + given_from, given_.end(), Number(c)) != given_.end();
        };
        for (std::size_t c = 0; c < count_; ++c)
            if (to_come(c)) condition(c, b);
        ++taken_;
        return true;
    }

    /// The next columns of L, and nu_c given pair b, whose rows `weigh` has computed.
    void condition(std::size_t c, std::size_t b) {
        for (std::size_t r = 0; r < d_; ++r)
            for (std::size_t q = 0, k = taken_ * d_; q < d_; ++q, ++k) {
                row(c, r)[k] = rest(c, r, b, q) / row(b, q)[k];
                nu_[c * d_ + r] -= row(c, r)[k] * white_[b * d_ + q];
            }
    }

    const Pairs& pairs_;
    std::span<const Number> items_;
    const GrowthRules& rules_;
    std::size_t d_, count_, taken_ = 0;
    std::vector<double> nu_, white_;  ///< given the pairs so far; L^-1 of that
    std::vector<double> L_;           ///< by rows, S = L L' of the pairs so far, and the rows of those that may come
    std::vector<char> free_;  ///< which pairs may still be added
    std::vector<Number> given_;
    Grown grown_;
};

}  // namespace

Grown grown_from(std::span<const Number> begin, const Pairs& pairs, std::span<const Number> items, const GrowthRules& rules) {
    return Growth(begin, pairs, items, rules).run();
}

}  // namespace vmslam::association
