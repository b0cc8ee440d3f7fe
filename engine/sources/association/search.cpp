#include "vmslam/association/search.hpp"

#include <algorithm>
#include <cmath>

#include "joint_factor.hpp"

namespace vmslam::association {
namespace {

/// A hypothesis on the items so far.
struct Partial {
    double evidence = 0.0, squares = 0.0;  ///< E and nu' S^-1 nu
    std::size_t pairs = 0;
};

class Search {
   public:
    Search(const Pairs& candidates, std::span<const Number> start, std::span<const double> bounds,
           std::span<const double> gates, Number most)
        : candidates_(candidates), start_(start), gates_(gates), most_(most), factor_(candidates, start.size() - 1) {
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
        factor_.begin(c);
        members_.resize(h.pairs);
        for (std::size_t n = 0; n < h.pairs; ++n) factor_.condition(c, members_[n], n);
        members_.push_back(c);
        const auto [squares, evidence] = factor_.weigh(c, h.pairs++);
        h.squares += squares;
        h.evidence += evidence;
        return std::isfinite(evidence) && h.squares <= gates_[h.pairs];
    }

    const Pairs& candidates_;
    std::span<const Number> start_;
    std::span<const double> gates_;
    Number most_, tried_ = 0;
    JointFactor factor_;
    std::vector<Number> members_;  ///< the pairs of the hypothesis
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
