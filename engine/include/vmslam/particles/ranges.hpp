// Several threads for one kernel: each takes a range of particles, so the result does not depend on their number.
#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

#include "vmslam/parallel.hpp"

namespace vmslam::particles {

/// Threads take ranges of whole chunks, so that no group of particles is divided.
inline constexpr std::size_t chunk = 1024;
/// With fewer particles than this per thread, starting the thread costs more than it saves.
inline constexpr std::size_t least_particles = 4096;

/// The ranges of particles of the threads.
class Ranges {
   public:
    Ranges(std::size_t particles, std::size_t threads) {
        const std::size_t count = std::max<std::size_t>(1, std::min(threads, particles / least_particles));
        const std::size_t chunks = (particles + chunk - 1) / chunk;
        for (std::size_t k = 0; k <= count; ++k) edges_.push_back(std::min(chunks * k / count * chunk, particles));
    }

    std::size_t particles() const { return edges_.back(); }
    std::size_t count() const { return edges_.size() - 1; }
    std::size_t edge(std::size_t k) const { return edges_[k]; }

    /// Call work(lo, hi) for ranges that together cover all particles.
    template <class Work>
    void each(const Work& work) const {
        in_parallel(static_cast<int>(count()), [&](int k) { work(edges_[k], edges_[k + 1]); });
    }

   private:
    std::vector<std::size_t> edges_;
};

}  // namespace vmslam::particles
