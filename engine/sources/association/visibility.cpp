#include "vmslam/association/visibility.hpp"

#include <cmath>

namespace vmslam::association {
namespace {

/// Whether a landmark at (x, y) from the sensor, x ahead, is within a limit. A bearing is within it where x / r >= cosine:
/// without a root, where x |x| >= cosine |cosine| r^2.
bool within(const FieldLimit& limit, double squared_range, double ahead) {
    return squared_range >= limit.nearest * limit.nearest && squared_range <= limit.farthest * limit.farthest &&
           ahead >= limit.cosine * std::abs(limit.cosine) * squared_range;
}

}  // namespace

std::vector<std::int64_t> count_views(std::span<const double> poses, std::span<const double> landmarks, std::size_t columns,
                                      const edges::Lever& lever, std::span<const FieldLimit> limits) {
    const std::size_t count = landmarks.size() / columns;
    std::vector<std::int64_t> counts(limits.size() * count, 0);
    if (limits.empty()) return counts;
    const double farthest = limits.back().farthest * limits.back().farthest;
    for (std::size_t t = 0; t < poses.size() / 3; ++t) {
        const double c = std::cos(poses[3 * t + 2]), s = std::sin(poses[3 * t + 2]);
        // the sensor in the world: p + R(theta) o
        const double px = poses[3 * t] + c * lever.x - s * lever.y, py = poses[3 * t + 1] + s * lever.x + c * lever.y;
        for (std::size_t j = 0; j < count; ++j) {
            const double* const mark = landmarks.data() + j * columns;
            const double dx = mark[0] - px, dy = mark[1] - py, squared_range = dx * dx + dy * dy;
            if (squared_range > farthest) continue;
            const double x = c * dx + s * dy;
            for (std::size_t k = limits.size(); k-- > 0 && within(limits[k], squared_range, x * std::abs(x));)
                ++counts[k * count + j];
        }
    }
    return counts;
}

}  // namespace vmslam::association
