// Joint hypotheses that are grown from seeds, for prior covariances so large that single pairs have no evidence.
//
// A hypothesis begins with given pairs. Then the pair with the most evidence given all pairs so far is added, while the
// evidence rises. Given a pair, residuals and covariance of the others are conditioned on it, by a Cholesky factor of which
// each pair that may come keeps its rows.
//
// The sum of the steps is the joint evidence E of search.hpp.
#pragma once

#include <array>
#include <vector>

#include "vmslam/association/search.hpp"

namespace vmslam::association {

/// The number of second pairs that are returned for each seed.
inline constexpr std::size_t second_pairs = 3;

/// A hypothesis: which pairs it has, E, and the pairs with the most evidence given its first one (-1 for none).
struct Grown {
    std::vector<char> members;
    double evidence = 0.0;
    std::array<Number, second_pairs> second;
};

struct GrowthRules {
    double gate_of_given;  ///< the most nu' S^-1 nu of a pair with which a hypothesis begins, given those before
    double gate;           ///< the same of one that is added
    bool grow;             ///< whether pairs are added
};

/// The hypothesis that begins with some pairs (-1 stands for none) and grows; `items` (C) are those of the pairs.
Grown grown_from(std::span<const Number> begin, const Pairs& pairs, std::span<const Number> items, const GrowthRules& rules);

}  // namespace vmslam::association
