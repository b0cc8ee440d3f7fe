#include "vmslam/parallel.hpp"

#ifndef __wasm__
#include <algorithm>
#include <atomic>
#include <exception>
#include <functional>
#include <thread>
#include <vector>
#endif

namespace vmslam {

#ifndef __wasm__
namespace {

/// Threads that are joined, whatever happens. (The C++ library of macOS has no std::jthread.)
class Threads {
   public:
    Threads() = default;
    Threads(const Threads&) = delete;
    Threads& operator=(const Threads&) = delete;
    ~Threads() {
        std::for_each(threads_.begin(), threads_.end(), [](std::thread& thread) { thread.join(); });
    }

    template <class Work>
    void start(const Work& work, int k) {
        threads_.emplace_back(std::cref(work), k);
    }

   private:
    std::vector<std::thread> threads_;
};

}  // namespace
#endif

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
    {
        Threads threads;
        int started = 1;
        try {
            for (; started < count; ++started) threads.start(guarded, started);
        } catch (...) {
            // no more threads, or no memory for them: the rest is done here
        }
        guarded(0);
        for (; started < count; ++started) guarded(started);
    }
    if (failure) std::rethrow_exception(failure);
#endif
}

}  // namespace vmslam
