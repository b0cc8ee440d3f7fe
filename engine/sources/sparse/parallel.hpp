// Work that several threads do at the same time.
#pragma once

#include <system_error>
#include <vector>
#ifndef __wasm__
#include <thread>
#endif

#include "vmslam/sparse/product.hpp"

namespace vmslam::sparse {

/// The flops from which on a product is shared among threads, and how many node columns one takes at a time.
inline constexpr double shared_flops = 1.0e7;
inline constexpr Step shared_nodes = 32;

/// work(0) to work(count - 1) at the same time; what gets no thread is done here.
template <class Work>
void in_parallel(int count, const Work& work) {
#ifdef __wasm__
    for (int k = 0; k < count; ++k) work(k);
#else
    std::vector<std::jthread> threads;
    int started = 1;
    try {
        for (; started < count; ++started) threads.emplace_back(work, started);
    } catch (const std::system_error&) {
    }
    work(0);
    for (; started < count; ++started) work(started);
#endif
}

/// How many of `most` threads a product of so many rows, depth and columns of `nodes` nodes is worth.
inline int threads_for(std::size_t most, Step nodes, Step rows, Step depth, Step columns) {
    const double flops = 2.0 * static_cast<double>(rows) * static_cast<double>(columns * depth);
    const Step chunks = (nodes + shared_nodes - 1) / shared_nodes;
    return flops < shared_flops ? 1 : static_cast<int>(std::min<Step>(static_cast<Step>(most), chunks));
}

}  // namespace vmslam::sparse
