#include "vmslam/particles/record.hpp"

#include <numeric>

namespace vmslam::particles {

Record::Record(std::shared_ptr<const Rows> poses, std::shared_ptr<const Rows> log_weights) : identity_(poses->particles()) {
    std::iota(identity_.begin(), identity_.end(), Index{0});
    living_ = identity_;
    steps_.push_back({std::move(poses), std::move(log_weights), identity_});
}

void Record::move(std::shared_ptr<const Rows> poses, std::shared_ptr<const Rows> log_weights) {
    steps_.push_back({std::move(poses), std::move(log_weights), living_});
    living_ = identity_;
}

void Record::observe(std::shared_ptr<const Rows> poses, std::shared_ptr<const Rows> log_weights) {
    RecordedStep& step = steps_.back();
    std::vector<Index> parents(identity_.size());
    for (std::size_t i = 0; i < parents.size(); ++i) parents[i] = step.parents[living_[i]];
    step = {std::move(poses), std::move(log_weights), std::move(parents)};
    living_ = identity_;
}

void Record::branch(std::span<const Index> ancestors) {
    std::vector<Index> living(identity_.size());
    for (std::size_t i = 0; i < living.size(); ++i) living[i] = living_[ancestors[i]];
    living_.swap(living);
}

}  // namespace vmslam::particles
