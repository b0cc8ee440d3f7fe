// Which landmarks of the particles exist: evidence against those not seen, and landmarks that are one. See `association`.
#pragma once

#include "vmslam/particles/association.hpp"

namespace vmslam::particles {

/// Limits of range [m] and bearing [rad] within which a sensor sees, or a landmark should be seen.
struct Limits {
    double least_range, most_range, most_bearing;
};

/// Lower the evidence for landmarks that were in view in this step without a sighting, except for permanent ones.
void count_misses(std::span<Blocks* const> landmarks, const Rows& poses, double step, const Limits& view, std::size_t lo,
                  std::size_t hi);

/// How many particles have a landmark, whether any may still drop it, and where it lies: the box holds the means with the
/// margin that `place_of` leaves to it.
struct Extent {
    std::size_t owners = 0;
    bool droppable = false;
    Box box;
    void include(const Extent& other);
};
Extent extent_of(const Blocks& landmark, double gate, std::size_t lo, std::size_t hi);

/// Merge landmarks of a particle that are one: the older takes what the younger knows, and the younger goes.
///
/// They are one where the squared Mahalanobis distance of their means, under S_a + S_b + diag(blur), is at most the gate, and
/// the last scan that saw one of them did not see both. With n classes, 2 log of n sum over c of p(c) p'(c), by which two
/// landmarks of one class are likelier than any two, is subtracted from the distance. The older ones come first.
void merge(std::span<Blocks* const> landmarks, bool oriented, double gate, const Blur& blur, std::size_t classes,
           std::size_t lo, std::size_t hi);

}  // namespace vmslam::particles
