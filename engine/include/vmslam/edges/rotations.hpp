// The rotations of a loop over edges or sightings, eight at a time.
#pragma once

#include <array>

#include "vmslam/edges/arithmetic.hpp"
#include "vmslam/numbers/elementary.hpp"

namespace vmslam::edges {

/// Rotations by the angles of a sequence, taken from first to last: the C library computes one cosine and sine at a time,
/// which would be a twelfth of the time of a solve. `angle(k)` is the k-th of `count`.
template <class Angle>
class Rotations {
   public:
    Rotations(std::size_t count, Angle angle) : count_(count), angle_(std::move(angle)) {}

    const Rotation& operator[](std::size_t k) {
        if (k % numbers::lanes == 0) compute(k);
        return block_[k % numbers::lanes];
    }

   private:
    void compute(std::size_t begin) {
        numbers::Lanes angles{};
        for (std::size_t k = 0; k < numbers::lanes && begin + k < count_; ++k) angles[k] = angle_(begin + k);
        const auto [sine, cosine] = numbers::sincos(angles);
        for (std::size_t k = 0; k < numbers::lanes; ++k) block_[k].c = cosine[k], block_[k].s = sine[k];
    }

    std::size_t count_;
    Angle angle_;
    std::array<Rotation, numbers::lanes> block_;
};

}  // namespace vmslam::edges
