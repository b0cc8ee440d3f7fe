// Work that several threads do at the same time.
#pragma once

#include "vmslam/parallel.hpp"
#include "vmslam/sparse/product.hpp"

namespace vmslam::sparse {

/// The flops from which on a product is shared among threads, and how many node columns one takes at a time.
inline constexpr double shared_flops = 1.0e7;
inline constexpr Step shared_nodes = 32;

/// How many of `most` threads a product of so many rows, depth and columns of `nodes` nodes is worth.
inline int threads_for(std::size_t most, Step nodes, Step rows, Step depth, Step columns) {
    const double flops = 2.0 * static_cast<double>(rows) * static_cast<double>(columns * depth);
    const Step chunks = (nodes + shared_nodes - 1) / shared_nodes;
    return flops < shared_flops ? 1 : static_cast<int>(std::min<Step>(static_cast<Step>(most), chunks));
}

}  // namespace vmslam::sparse
