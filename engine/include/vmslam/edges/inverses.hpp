// Inverses of covariances.
#pragma once

#include "vmslam/edges/system.hpp"

namespace vmslam::edges {

/// Write the inverses of positive definite matrices (n, d, d), d at most 3; that they are symmetric is not checked. They are
/// scaled to a diagonal of ones first, so that metres and radians of different size lose no digits. Returns the first matrix
/// that, or whose inverse, is not finite, or of which elimination leaves no more than `least` of a diagonal entry; -1 for
/// none.
Index inverses(std::span<const double> matrices, std::size_t d, double least, std::span<double> out);

}  // namespace vmslam::edges
