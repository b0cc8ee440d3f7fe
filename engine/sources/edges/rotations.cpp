#include "vmslam/edges/rotations.hpp"

#include "vmslam/numbers/elementary.hpp"

namespace vmslam::edges {

RotationsOfLanes rotations(const std::array<double, numbers::lanes>& angles) {
    const auto [sine, cosine] = numbers::sincos(numbers::load(angles.data()));
    RotationsOfLanes out;
    for (std::size_t k = 0; k < out.size(); ++k) out[k].c = cosine[k], out[k].s = sine[k];
    return out;
}

}  // namespace vmslam::edges
