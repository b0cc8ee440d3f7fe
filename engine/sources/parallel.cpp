#include "vmslam/parallel.hpp"

#ifndef __wasm__
#include <atomic>
#include <exception>
#include <functional>
#include <thread>
#include <vector>
#endif

namespace vmslam {

void in_parallel(int count, void (*work)(const void* context, int), const void* context) {
#ifdef __wasm__
    for (int k = 0; k < count; ++k) work(context, k);
#else
    // an exception that leaves a thread would end the process: the first one is thrown again here
    std::atomic_flag failed;
    std::exception_ptr failure;
    const auto guarded = [&](int k) noexcept {
        try {
            work(context, k);
        } catch (...) {
            if (!failed.test_and_set()) failure = std::current_exception();
        }
    };
    std::vector<std::thread> threads;
    int started = 1;
    try {
        for (; started < count; ++started) threads.emplace_back(std::cref(guarded), started);
    } catch (...) {
        // no more threads, or no memory for them: the rest is done here
    }
    // nothing throws from here on, so that all threads are joined
    guarded(0);
    for (; started < count; ++started) guarded(started);
    for (std::thread& thread : threads) thread.join();
    if (failure) std::rethrow_exception(failure);
#endif
}

}  // namespace vmslam
