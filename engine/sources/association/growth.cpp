#include "vmslam/association/growth.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "joint_factor.hpp"

namespace vmslam::association {
namespace {

class Growth {
   public:
    Growth(std::span<const Number> begin, const Pairs& pairs, std::span<const Number> items, const GrowthRules& rules)
        : pairs_(pairs),
          items_(items),
          rules_(rules),
          count_(pairs.residuals.size()),
          // pairs that are given more than once have columns for each
          factor_(pairs, count_ + begin.size()),
          free_(pairs.allowed.begin(), pairs.allowed.end()) {
        std::copy_if(begin.begin(), begin.end(), std::back_inserter(given_), [](Number c) { return c >= 0; });
        grown_.members.assign(count_, 0);
        grown_.second.fill(-1);
    }

    Grown run() {
        for (std::size_t next = 0; next < given_.size(); ++next) {
            const auto [squares, evidence] = factor_.weigh(given_[next], taken_);
            const double worst = -std::numeric_limits<double>::infinity();
            if (!take(given_[next], squares <= rules_.gate_of_given ? evidence : worst, next + 1)) return std::move(grown_);
        }
        while (rules_.grow) {
            const auto [best, evidence] = most_evident();
            if (best < 0 || !take(best, evidence, given_.size())) break;
        }
        return std::move(grown_);
    }

   private:
    /// The free pair with the most evidence, if that is above zero. After the first pair, keep the best second ones.
    std::pair<Number, double> most_evident() {
        Number best = -1;
        double most = 0.0;
        for (std::size_t c = 0; c < count_; ++c) {
            if (!free_[c]) continue;
            const auto [squares, evidence] = factor_.weigh(c, taken_);
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
            const double its = factor_.weigh(other, taken_).evidence;
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
            if (to_come(c)) factor_.condition(c, b, taken_);
        ++taken_;
        return true;
    }

    const Pairs& pairs_;
    std::span<const Number> items_;
    const GrowthRules& rules_;
    std::size_t count_, taken_ = 0;
    JointFactor factor_;  ///< of the pairs so far, and the rows of those that may come
    std::vector<char> free_;  ///< which pairs may still be added
    std::vector<Number> given_;
    Grown grown_;
};

}  // namespace

Grown grown_from(std::span<const Number> begin, const Pairs& pairs, std::span<const Number> items, const GrowthRules& rules) {
    return Growth(begin, pairs, items, rules).run();
}

}  // namespace vmslam::association
