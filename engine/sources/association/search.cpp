#include "vmslam/association/search.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace vmslam::association {
namespace {

/// A hypothesis on the items so far.
struct Partial {
    double evidence = 0.0, squares = 0.0;  ///< E and nu' S^-1 nu
    std::size_t pairs = 0;
};

/// S_hh = L L' and L^-1 nu_h of the pairs of a hypothesis, extended pair by pair; an earlier state is the first rows.
class JointFactor {
   public:
    struct Added {
        double squares = 0.0, half_log_determinant = 0.0;
        bool positive = true;
    };

    explicit JointFactor(const Residuals& residuals) : residuals_(residuals) {}

    /// Candidate c as pair number n: d more rows of L.
    Added add(std::size_t n, Number c) {
        const std::size_t d = residuals_.d;
        members_.resize(n);
        members_.push_back(c);
        rows_.resize((n + 1) * d * ((n + 1) * d + 1) / 2);
        white_.resize((n + 1) * d);
        Added added;
        for (std::size_t r = 0; r < d; ++r) add_row(n * d + r, d * c + r, added);
        return added;
    }

   private:
    double* row(std::size_t r) { return rows_.data() + r * (r + 1) / 2; }

    /// L_rk = (S_rk - sum_i L_ri L_ki) / L_kk, L_rr = sqrt(S_rr - sum_i L_ri^2), and likewise for L^-1 nu.
    void add_row(std::size_t r, std::size_t scalar, Added& added) {
        const std::size_t d = residuals_.d;
        const double* const S = residuals_.row(scalar);
        double* const L = row(r);
        for (std::size_t k = 0; k <= r; ++k) {
            const double* const other = row(k);
            double value = S[d * members_[k / d] + k % d];
            for (std::size_t i = 0; i < k; ++i) value -= L[i] * other[i];
            if (k < r) {
                L[k] = value / other[k];
            } else {
                added.positive &= value > 0;
                L[r] = value > 0 ? std::sqrt(value) : 1.0;
            }
        }
        double value = residuals_.nu[scalar];
        for (std::size_t i = 0; i < r; ++i) value -= L[i] * white_[i];
        white_[r] = value / L[r];
        added.squares += white_[r] * white_[r];
        added.half_log_determinant += std::log(L[r]);
    }

    const Residuals& residuals_;
    std::vector<Number> members_;
    std::vector<double> rows_, white_;  ///< the lower triangle of L by rows
};

class Search {
   public:
    Search(const Pairs& candidates, std::span<const Number> start, std::span<const double> bounds,
           std::span<const double> gates, Number most)
        : candidates_(candidates), start_(start), gates_(gates), most_(most), factor_(candidates.residuals) {
        const std::size_t items = start.size() - 1;
        rest_.assign(items + 1, 0.0);
        for (std::size_t i = items; i-- > 0;) {
            double top = 0.0;
            for (Number c = start[i]; c < start[i + 1]; ++c)
                if (candidates.allowed[c]) top = std::max(top, bounds[c]);
            rest_[i] = rest_[i + 1] + top;
        }
        const auto& landmarks = candidates.landmarks;
        used_.assign(landmarks.empty() ? 0 : *std::max_element(landmarks.begin(), landmarks.end()) + 1, false);
        taken_.assign(items, -1);
        best_.chosen = taken_;
    }

    BestHypothesis run() {
        decide(0, {});
        return std::move(best_);
    }

   private:
    /// Try the candidates of an item, and that it is new, each with all that may follow.
    void decide(std::size_t item, const Partial& so_far) {
        if (item == taken_.size()) {
            if (so_far.evidence > best_.evidence) best_ = {taken_, so_far.evidence};
            return;
        }
        for (Number c = start_[item]; c < start_[item + 1]; ++c) {
            if (hopeless(item, so_far)) return;
            const auto landmark = static_cast<std::size_t>(candidates_.landmarks[c]);
            if (!candidates_.allowed[c] || used_[landmark]) continue;
            Partial extended = so_far;
            if (!extend(extended, c)) continue;
            used_[landmark] = true;
            taken_[item] = c;
            decide(item + 1, extended);
            used_[landmark] = false;
            taken_[item] = -1;
        }
        if (!hopeless(item, so_far)) decide(item + 1, so_far);
    }

    /// Whether no hypothesis that begins like this can be the best, or the search has taken long enough.
    bool hopeless(std::size_t item, const Partial& so_far) const {
        return so_far.evidence + rest_[item] <= best_.evidence || tried_ > most_;
    }

    /// Add a pair; false where the hypothesis then leaves the gate.
    bool extend(Partial& h, Number c) {
        ++tried_;
        const JointFactor::Added added = factor_.add(h.pairs, c);
        h.squares += added.squares;
        ++h.pairs;
        if (!added.positive || h.squares > gates_[h.pairs]) return false;
        // log N(nu_c; given the pairs before) = -(squares + log det S_c + d log 2 pi) / 2
        const double half_log = 0.5 * static_cast<double>(candidates_.residuals.d) * std::log(2 * std::numbers::pi);
        h.evidence += candidates_.weights[c] - 0.5 * added.squares - added.half_log_determinant - half_log;
        return true;
    }

    const Pairs& candidates_;
    std::span<const Number> start_;
    std::span<const double> gates_;
    Number most_, tried_ = 0;
    JointFactor factor_;
    std::vector<double> rest_;  ///< the most that the items from each on can add
    std::vector<bool> used_;
    std::vector<Number> taken_;
    BestHypothesis best_;
};

}  // namespace

BestHypothesis best_hypothesis(const Pairs& candidates, std::span<const Number> start, std::span<const double> bounds,
                               std::span<const double> gates, Number most) {
    return Search(candidates, start, bounds, gates, most).run();
}

}  // namespace vmslam::association
