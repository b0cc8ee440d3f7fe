// How often each landmark was in the field of view.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "vmslam/edges/arithmetic.hpp"

namespace vmslam::association {

/// Part of the field of view: ranges from `nearest` to `farthest`, and bearings with a cosine of at least `cosine`.
struct FieldLimit {
    double nearest, farthest, cosine;
};

/// For each of the limits, the widest last and each part of the next, from how many of the poses (n, 3) each landmark is
/// within it: (limits, L). Landmarks (L, columns) begin with their position; the sensor is at `lever` in the axes of the robot.
std::vector<std::int64_t> count_views(std::span<const double> poses, std::span<const double> landmarks, std::size_t columns,
                                      const edges::Lever& lever, std::span<const FieldLimit> limits);

}  // namespace vmslam::association
