// A particle filter that several Python threads may use.
#pragma once

#include <mutex>
#include <new>
#include <type_traits>

#include "arrays.hpp"
#include "vmslam/particles/filter.hpp"

namespace vmslam::python {

/// A filter that one Python thread uses at a time, while the others run.
class SharedFilter {
   public:
    SharedFilter(const In<double>& poses, std::size_t threads, bool records)
        : filter_(first_poses(poses), threads, records) {}
    explicit SharedFilter(const particles::Filter& filter) : filter_(filter) {}

    /// What `work` does with the filter; it changes nothing there if it takes a constant one.
    template <class Work>
    auto with(const Work& work) {
        const nb::gil_scoped_release release;
        const std::lock_guard lock(mutex_);
        require(!incomplete_, "an earlier step of this filter ran out of memory: make a new one with fewer particles");
        try {
            return work(filter_);
        } catch (const std::bad_alloc&) {
            incomplete_ = !std::is_invocable_v<Work, const particles::Filter&>;
            throw;
        }
    }

   private:
    static particles::Rows first_poses(const In<double>& poses) {
        require(poses.ndim() == 2 && poses.shape(1) == 3 && poses.shape(0) > 0 && poses.shape(0) < (1u << 30),
                "poses (N, 3)");
        particles::Rows rows(3, poses.shape(0));
        for (std::size_t i = 0; i < rows.particles(); ++i)
            for (int k = 0; k < 3; ++k) rows.row(k)[i] = poses.data()[3 * i + k];
        return rows;
    }

    std::mutex mutex_;
    bool incomplete_ = false;  ///< whether a step ended halfway
    particles::Filter filter_;
};

}  // namespace vmslam::python
