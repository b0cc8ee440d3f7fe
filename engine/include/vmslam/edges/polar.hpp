// Sightings of landmark nodes as range and bearing: e = h(x, m) - z, with the information Q^-1 at the measured range.
#pragma once

#include "vmslam/edges/sightings.hpp"

namespace vmslam::edges {

/// Pose `first` sees landmark `second`.
class PolarEdges : public Family {
   public:
    PolarEdges(std::vector<Index> first, std::vector<Index> second, Sightings sightings)
        : first_(std::move(first)), second_(std::move(second)), seen_(std::move(sightings)) {}

    double accumulate(const State& state, System* system, std::span<const Index> pairs) const override;
    bool curves() const override { return true; }
    std::size_t measurements() const override { return first_.size(); }
    std::unique_ptr<const Family> trusting(std::span<const double> trust) const override {
        auto out = std::make_unique<PolarEdges>(*this);
        out->seen_.trust.assign(trust.begin(), trust.end());
        return out;
    }
    std::unique_ptr<const Family> among(std::span<const Index> number) const override;

   private:
    std::vector<Index> first_, second_;
    Sightings seen_;
};

}  // namespace vmslam::edges
