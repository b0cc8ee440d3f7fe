// Weights as logarithms, and how many copies each particle gets when they are resampled.
#pragma once

#include <span>

#include "vmslam/particles/rows.hpp"

namespace vmslam::particles {

/// The sums of w and of w², w = exp(log weight - highest).
struct WeightSums {
    double total, squares;
};

/// Write w = exp(log weight - highest), and subtract highest + log of the sum of w from the logarithms, so that their
/// exponentials sum to 1. Weights, and logarithms, are filled up to whole groups.
WeightSums normalize(std::span<double> log_weights, double highest, double* weights);

/// The first k with cumulative[k] > position * total for each of the ascending positions in [0, 1). A particle of weight zero
/// is never chosen: where rounding puts a position at the very end, the last particle with a weight is taken.
std::vector<Index> at_positions(std::span<const double> cumulative, std::span<const double> positions);

/// The same for the positions (offset + 0, 1, 2, ...) / N, without branches that cannot be predicted.
std::vector<Index> evenly_spaced(std::span<const double> cumulative, double offset);

}  // namespace vmslam::particles
