// Work that several threads do at the same time. The threads end with the work, so that a process can fork afterwards.
#pragma once

#include <system_error>
#include <vector>
#ifndef __wasm__
#include <thread>
#endif

namespace vmslam {

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

}  // namespace vmslam
