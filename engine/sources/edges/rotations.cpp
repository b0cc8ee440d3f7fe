#include "vmslam/edges/rotations.hpp"

#include "vmslam/numbers/elementary.hpp"

namespace vmslam::edges {

/// Larger angles [rad] are left to the C library.
constexpr double largest = 1e6;

RotationsOfLanes rotations(const std::array<double, numbers::lanes>& angles) {
    RotationsOfLanes out;
    const numbers::Lanes x = numbers::load(angles.data());
    if (numbers::any(numbers::magnitude(x) > largest)) {
        for (std::size_t k = 0; k < out.size(); ++k) out[k] = Rotation(angles[k]);
        return out;
    }
    const auto [sine, cosine] = numbers::sincos(x);
    for (std::size_t k = 0; k < out.size(); ++k) out[k] = {cosine[k], sine[k]};
    return out;
}

}  // namespace vmslam::edges
