// The residuals of pairs of an item (a sighting, or a track of sightings) and a landmark, Gaussian together.
#pragma once

#include <cstdint>
#include <span>

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

}  // namespace vmslam::association
