#include "vmslam/parallel.hpp"

#ifndef __wasm__
#include <system_error>
#include <thread>
#include <vector>
#endif

namespace vmslam {

void in_parallel(int count, void (*work)(const void* context, int), const void* context) {
#ifdef __wasm__
    for (int k = 0; k < count; ++k) work(context, k);
#else
    std::vector<std::jthread> threads;
    int started = 1;
    try {
        for (; started < count; ++started) threads.emplace_back(work, context, started);
    } catch (const std::system_error&) {
    }
    work(context, 0);
    for (; started < count; ++started) work(context, started);
#endif
}

}  // namespace vmslam
