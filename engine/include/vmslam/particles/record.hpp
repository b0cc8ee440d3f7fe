// All weighted particles of all steps of a run, and its sightings, from which trajectories can be drawn backwards.
#pragma once

#include <memory>
#include <span>

#include "vmslam/particles/gaussian.hpp"

namespace vmslam::particles {

/// The particles of a step, before its resampling; `parents` are their indices among those of the step before.
struct RecordedStep {
    std::shared_ptr<const Rows> poses, log_weights;
    std::vector<Index> parents;
};

class Record {
   public:
    Record(std::shared_ptr<const Rows> poses, std::shared_ptr<const Rows> log_weights);

    const std::vector<RecordedStep>& steps() const { return steps_; }

    /// Begin a step.
    void move(std::shared_ptr<const Rows> poses, std::shared_ptr<const Rows> log_weights);
    /// Replace the particles of the last step by those that its sightings have corrected and weighed.
    void observe(std::shared_ptr<const Rows> poses, std::shared_ptr<const Rows> log_weights);
    /// Let particle i descend from particle ancestors[i] from now on.
    void branch(std::span<const Index> ancestors);

   private:
    std::vector<RecordedStep> steps_;
    /// the index of each living particle among the particles of the last step
    std::vector<Index> identity_, living_;
};

}  // namespace vmslam::particles
