// The best joint hypothesis: which item is which landmark.
//
// Every candidate c pairs an item with a landmark. A hypothesis h chooses at most one candidate for each item and uses no
// landmark twice. Its evidence, over that of the hypothesis that all items are new, is
//
//     E(h) = sum of w_c + log N(nu_h; 0, S_hh).
//
// Only hypotheses with nu_h' S_hh^-1 nu_h within the gate count, and with all their parts in the order of the search.
//
// Source: Neira and Tardos, Data association in stochastic mapping using the joint compatibility test, T-RA 2001.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

namespace vmslam::association {

using Number = std::int64_t;

/// Coordinates of a residual: position, or position and heading.
inline constexpr std::size_t most_coordinates = 3;

/// nu (C, d) and its covariance S (C d, C d) if all pairs are right. A view.
struct Residuals {
    std::span<const double> nu, covariance;
    std::size_t d;

    std::size_t size() const { return nu.size() / d; }
    const double* row(std::size_t r) const { return covariance.data() + r * nu.size(); }
};

/// Candidates (C): pairs of an item and a landmark. A view.
struct Pairs {
    std::span<const Number> landmarks;
    Residuals residuals;
    std::span<const double> weights;  ///< w_c: what the evidence for each has beside log N
    std::span<const bool> allowed;    ///< which may be used
};

/// The candidate of each item, -1 for none, and E.
struct BestHypothesis {
    std::vector<Number> chosen;
    double evidence = 0.0;
};

/// Depth-first branch and bound. The candidates of item i are start[i] to start[i + 1] - 1, their landmarks are numbered from
/// 0, and `bounds` (C) has the most that each can add to E. `gates` has the most nu' S^-1 nu of 0 to I pairs. After `most`
/// extended hypotheses the best one so far is the result.
BestHypothesis best_hypothesis(const Pairs& candidates, std::span<const Number> start, std::span<const double> bounds,
                               std::span<const double> gates, Number most);

}  // namespace vmslam::association
