#include "vmslam/particles/filter.hpp"

#include <algorithm>
#include <atomic>
#include <cmath>

#include "require.hpp"
#include "step.hpp"

namespace vmslam::particles {

Filter::Filter(Rows poses, std::size_t threads, bool records)
    : particles_(poses.particles()),
      ranges_(particles_, threads),
      history_(particles_),
      poses_(std::make_shared<Rows>(std::move(poses))),
      log_likelihoods_(1, particles_),
      weights_(1, particles_) {
    auto uniform = std::make_shared<Rows>(1, particles_);
    uniform->fill(-numbers::log(static_cast<double>(particles_)));
    uniform_ = log_weights_ = std::move(uniform);
    log_likelihoods_.fill(0.0);
    weights_.fill(1.0);
    history_.open_level();
    history_.write(*poses_, 0, particles_);
    if (records) record_ = std::make_shared<Record>(poses_, log_weights_);
}

// nobody writes into poses and weights that two filters share: `fresh` gives away only buffers without another owner
Filter::Filter(const Filter& other)
    : particles_(other.particles_),
      ranges_(other.ranges_),
      history_(other.history_),
      poses_(other.poses_),
      starts_(other.starts_),
      log_weights_(other.log_weights_),
      uniform_(other.uniform_),
      log_likelihoods_(other.log_likelihoods_),
      weights_(other.weights_),
      best_(other.best_),
      step_(other.step_),
      motion_(other.motion_) {
    if (other.identified_) identified_ = std::make_unique<IdentifiedMap>(*other.identified_, history_);
    if (other.anonymous_) anonymous_ = std::make_unique<AnonymousMap>(*other.anonymous_, history_);
    if (other.record_) record_ = std::make_shared<Record>(*other.record_);
}

std::shared_ptr<Rows> Filter::fresh(int rows) {
    for (const auto& buffer : buffers_) {
        if (buffer.use_count() != 1 || buffer->rows() != rows) continue;
        // `use_count` does not order memory: what the last other owner read must be read before it is overwritten
        std::atomic_thread_fence(std::memory_order_acquire);
        return buffer;
    }
    auto buffer = std::make_shared<Rows>(rows, particles_);
    // buffers of a record are never free again
    if (!record_ && buffers_.size() < 16) buffers_.push_back(buffer);
    return buffer;
}

void Filter::use_ids(bool oriented, std::size_t jointly, std::optional<RangeNoise> range_noise) {
    require(jointly <= most_sightings, "at most 16 sightings are weighed together");
    identified_ = std::make_unique<IdentifiedMap>(history_, particles_, oriented, jointly, range_noise);
}

void Filter::use_no_ids(bool oriented, const AnonymousOptions& options, Confusion confusion) {
    anonymous_ = std::make_unique<AnonymousMap>(history_, particles_, oriented, options, std::move(confusion));
}

void Filter::move(const Motion& motion, bool corrects) {
    const auto moved = fresh(3);
    history_.open_level();
    ranges_.each([&](std::size_t lo, std::size_t hi) {
        move_poses(motion, *poses_, *moved, lo, hi);
        history_.write(*moved, lo, hi);
    });
    starts_ = std::move(poses_);
    poses_ = moved;
    motion_.reset();
    if (corrects) motion_ = motion;
    ++step_;
    if (record_) record_->move(poses_, log_weights_);
}

void Filter::end_step() {
    if (anonymous_) anonymous_->end_step(*poses_, step_, ranges_);
}

template <class Proposal, class Scan>
void Filter::weigh(const Proposal& proposal, const Scan& scan, const std::shared_ptr<Rows>& drawn) {
    ranges_.each([&](std::size_t lo, std::size_t hi) {
        weigh_particles(proposal, scan, drawn.get(), log_likelihoods_.row(0), lo, hi);
        if (drawn) history_.amend(*drawn, lo, hi);
    });
    if (drawn) poses_ = drawn;
    // the poses now depend on the sightings: later sightings of this step must not correct the motion again
    motion_.reset();
}

void Filter::weigh_known(std::span<const KnownSighting> sightings) { weigh(Given(*poses_), KnownScan(sightings), nullptr); }

bool Filter::weigh_identified(std::span<const LandmarkId> ids, std::span<const Sighting> sightings, Version version) {
    const auto known = [&](LandmarkId id) { return identified_->has(id); };
    // steps without sightings of known landmarks move as in 1.0, without linearisation
    const bool corrects = version != Version::motion && motion_ && std::any_of(ids.begin(), ids.end(), known);
    const auto drawn = corrects ? fresh(3) : nullptr;
    const auto scan = identified_->scan(ids, sightings, corrects ? drawn : poses_);
    if (corrects)
        weigh(Corrected(*starts_, *motion_, version == Version::corrected_exact), scan, drawn);
    else
        weigh(Given(*poses_), scan, nullptr);
    identified_->end_scan();
    return scan.weighs();
}

void Filter::weigh_by(std::span<const double> log_likelihoods) {
    std::copy(log_likelihoods.begin(), log_likelihoods.end(), log_likelihoods_.row(0));
    // the weights now depend on the poses: later sightings of this step must not correct these
    motion_.reset();
}

template <class Proposal>
void Filter::weigh_anonymous_from(const Proposal& proposal, std::span<const Sighting> sightings,
                                  std::span<const std::int64_t> shown, const std::shared_ptr<Rows>& drawn) {
    const std::vector<Box> boxes = boxes_of(proposal, sightings, anonymous_->gate(), ranges_);
    const AnonymousScan scan = anonymous_->scan(sightings, shown, boxes, step_);
    weigh(proposal, scan, drawn);
    anonymous_->end_scan(scan, ranges_);
}

void Filter::weigh_anonymous(std::span<const Sighting> sightings, std::span<const std::int64_t> shown, Version version) {
    if (version == Version::motion || !motion_) {
        weigh_anonymous_from(Given(*poses_), sightings, shown, nullptr);
    } else {
        const Corrected proposal(*starts_, *motion_, version == Version::corrected_exact);
        weigh_anonymous_from(proposal, sightings, shown, fresh(3));
    }
}

Filter::Reweighed Filter::reweigh() {
    const auto updated = fresh(1);
    double* const log_weights = updated->row(0);
    for (std::size_t i = 0; i < particles_; ++i) log_weights[i] = log_likelihoods_.row(0)[i] + log_weights_->row(0)[i];
    const auto [highest, place] = highest_of({log_weights, particles_});
    if (!(highest > -std::numeric_limits<double>::infinity())) return {false, 0.0, 0.0};
    const WeightSums sums = normalize(ranges_, log_weights, highest, weights_.row(0));
    log_weights_ = updated;
    best_ = place;
    const double ess = std::fmin(sums.total * sums.total / sums.squares, static_cast<double>(particles_));
    return {true, highest + numbers::log(sums.total), ess};
}

void Filter::branch(std::span<const Index> ancestors) {
    const auto copy = std::lower_bound(ancestors.begin(), ancestors.end(), static_cast<Index>(best_));
    if (copy != ancestors.end() && static_cast<std::size_t>(*copy) == best_) {
        best_ = static_cast<std::size_t>(copy - ancestors.begin());
    } else {
        // only where copies are drawn at random can the heaviest particle be left without one
        const double* const weights = log_weights_->row(0);
        const auto heaviest =
            std::max_element(ancestors.begin(), ancestors.end(), [&](Index a, Index b) { return weights[a] < weights[b]; });
        best_ = static_cast<std::size_t>(heaviest - ancestors.begin());
    }
    history_.branch(ancestors);
    if (record_) record_->branch(ancestors);
    // a motion belongs to the particles from which it started
    motion_.reset();
    const auto poses = fresh(3);
    for (int row = 0; row < 3; ++row)
        for (std::size_t i = 0; i < particles_; ++i) poses->row(row)[i] = poses_->row(row)[ancestors[i]];
    poses_ = poses;
    log_weights_ = uniform_;
}

void Filter::remember() {
    if (record_) record_->observe(poses_, log_weights_);
}

}  // namespace vmslam::particles
