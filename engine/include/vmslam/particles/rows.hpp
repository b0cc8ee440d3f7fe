// Numbers of all particles as a structure of arrays, and the groups of eight particles in which the kernels compute.
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include "vmslam/numbers/lanes.hpp"
#include "vmslam/sparse/simd.hpp"

namespace vmslam::particles {

using numbers::Lanes;
using numbers::lanes;
using Index = std::int32_t;

/// The number of particles, filled up to whole groups.
inline std::size_t padded(std::size_t particles) { return (particles + lanes - 1) / lanes * lanes; }

/// Some numbers of each particle, one row per number. Every row is filled up to whole groups, so that no loop has a rest.
class Rows {
   public:
    Rows() = default;
    Rows(int rows, std::size_t particles)
        : rows_(rows),
          particles_(particles),
          stride_(padded(particles)),
          numbers_(static_cast<std::ptrdiff_t>(rows * stride_)) {
        for (int k = 0; k < rows; ++k) std::fill(row(k) + particles, row(k) + stride_, 0.0);
    }

    int rows() const { return rows_; }
    std::size_t particles() const { return particles_; }
    std::size_t stride() const { return stride_; }
    double* row(int k) { return numbers_.data() + static_cast<std::size_t>(k) * stride_; }
    const double* row(int k) const { return numbers_.data() + static_cast<std::size_t>(k) * stride_; }
    void fill(double value) { std::fill_n(numbers_.data(), numbers_.size(), value); }

   private:
    int rows_ = 0;
    std::size_t particles_ = 0, stride_ = 0;
    sparse::Numbers numbers_;
};

/// Some numbers of each particle, in blocks of one group: all numbers of eight particles lie side by side. This is for
/// numbers that are used together, as those of a landmark are: memory is then read and written in few streams.
class Blocks {
   public:
    Blocks() = default;
    Blocks(int rows, std::size_t particles)
        : rows_(rows), particles_(particles), numbers_(static_cast<std::ptrdiff_t>(rows * padded(particles))) {
        if (particles % lanes != 0) std::fill_n(group(0, particles / lanes * lanes), rows * lanes, 0.0);
    }

    int rows() const { return rows_; }
    std::size_t particles() const { return particles_; }
    /// A number of the group that begins with particle `first`.
    double* group(int row, std::size_t first) { return numbers_.data() + first * rows_ + row * lanes; }
    const double* group(int row, std::size_t first) const { return numbers_.data() + first * rows_ + row * lanes; }
    double& at(int row, std::size_t particle) { return group(row, particle / lanes * lanes)[particle % lanes]; }
    double at(int row, std::size_t particle) const { return group(row, particle / lanes * lanes)[particle % lanes]; }

   private:
    int rows_ = 0;
    std::size_t particles_ = 0;
    sparse::Numbers numbers_;
};

/// Which particle of an earlier level each particle descends from, filled up to whole groups; empty: itself.
using Ancestry = std::vector<Index>;

/// The numbers of a group in one row, or those of its ancestors if there are any.
inline Lanes read(const double* row, std::size_t first, const Index* ancestors) {
    return ancestors ? numbers::gather(row, ancestors + first) : numbers::load(row + first);
}

inline Lanes read(const Blocks& blocks, int row, std::size_t first, const Index* ancestors) {
    if (!ancestors) return numbers::load(blocks.group(row, first));
    Lanes out;
    for (int k = 0; k < lanes; ++k) out[k] = blocks.at(row, static_cast<std::size_t>(ancestors[first + k]));
    return out;
}

}  // namespace vmslam::particles
