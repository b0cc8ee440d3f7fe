// How often each landmark was in the field of view.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

namespace vmslam::association {

/// Part of the field of view: ranges from `nearest` to `farthest`, and bearings with a cosine of at least `cosine`.
struct FieldLimit {
    double nearest, farthest, cosine;
};

/// Where the sensor is in the axes of the robot.
struct Mounting {
    double x, y;
};

/// Landmarks (L, columns), of which the first two columns are the position.
struct Landmarks {
    std::span<const double> values;
    std::size_t columns;

    std::size_t size() const { return values.size() / columns; }
};

/// For each of the limits, the widest last and each part of the next, from how many of the poses (n, 3) each landmark is
/// within it: (limits, L).
std::vector<std::int64_t> count_views(std::span<const double> poses, const Landmarks& landmarks, const Mounting& sensor,
                                      std::span<const FieldLimit> limits);

}  // namespace vmslam::association
