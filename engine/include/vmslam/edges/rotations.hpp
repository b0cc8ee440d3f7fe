// The rotations of a loop over edges or sightings, eight at a time.
#pragma once

#include <array>

#include "vmslam/edges/arithmetic.hpp"
#include "vmslam/numbers/lanes.hpp"

namespace vmslam::edges {

using RotationsOfLanes = std::array<Rotation, numbers::lanes>;

/// The rotations by some angles.
RotationsOfLanes rotations(const std::array<double, numbers::lanes>& angles);

/// Rotations by the angles of a sequence, taken from first to last: the C library computes one cosine and sine at a time,
/// which was a twelfth of the time of a solve. `angle(k)` is the k-th of `count`.
template <class Angle>
class Rotations {
   public:
    Rotations(std::size_t count, Angle angle) : count_(count), angle_(std::move(angle)) {}

    const Rotation& operator[](std::size_t k) {
        if (k % numbers::lanes == 0) {
            std::array<double, numbers::lanes> angles{};
            for (std::size_t i = 0; i < angles.size() && k + i < count_; ++i) angles[i] = angle_(k + i);
            block_ = rotations(angles);
        }
        return block_[k % numbers::lanes];
    }

   private:
    std::size_t count_;
    Angle angle_;
    RotationsOfLanes block_;
};

}  // namespace vmslam::edges
