#include "vmslam/particles/filter.hpp"

#include <algorithm>
#include <atomic>
#include <cmath>

#include "require.hpp"

namespace vmslam::particles {

/// Where the poses of a step with sightings come from.
class Proposal {
   public:
    /// FastSLAM 1.0 and Monte Carlo localisation: the poses are those of the motion.
    explicit Proposal(const Rows& poses) : poses_(poses) {}
    /// FastSLAM 2.0: the poses are drawn from the motion, corrected by the sightings, with exact or with linearised weights.
    Proposal(const Rows& starts, const Motion& motion, bool exact)
        : poses_(starts), key_(motion.key), prediction_(particles::predict(motion, exact)) {
        if (exact) weighted_.emplace(motion);
    }

    bool corrects() const { return prediction_.has_value(); }
    Weighed weighed() const { return !corrects() || weighted_ ? Weighed::at_pose : Weighed::at_prediction; }
    Gaussian predict(std::size_t first) const {
        const Pose x = read_pose(poses_, first);
        return prediction_ ? prediction_->of(x) : certain(x);
    }
    Drawn draw(std::size_t first, const Gaussian& belief) const {
        if (!corrects()) return {belief.mean(), Lanes{}};
        const numbers::Bits particles = particles_of(first);
        if (weighted_) return (*weighted_)(read_pose(poses_, first), belief, particles);
        const auto [n0, n1] = numbers::normal_pair<Lanes>(key_, particles, 0);
        return {drawn(belief, n0, n1, numbers::normal_pair<Lanes>(key_, particles, 1).first), Lanes{}};
    }

   private:
    const Rows& poses_;
    std::uint64_t key_ = 0;
    std::optional<Prediction> prediction_;
    std::optional<WeightedDraw> weighted_;
};

namespace {

/// For each sighting the box that holds the mean of each landmark that is a hypothesis of a particle; see `place_of`.
std::vector<Box> boxes_of(const Proposal& proposal, std::span<const Sighting> sightings, double gate, const Ranges& ranges) {
    std::vector<std::vector<Box>> parts(ranges.count(), std::vector<Box>(sightings.size()));
    in_parallel(static_cast<int>(ranges.count()), [&](int part) {
        const std::size_t hi = ranges.edge(part + 1);
        for (std::size_t i = ranges.edge(part); i < hi; i += lanes) {
            const Gaussian belief = proposal.predict(i);
            for (std::size_t k = 0; k < sightings.size(); ++k) {
                const Place place = place_of(belief, sightings[k], gate);
                for (int lane = 0; lane < lanes && i + lane < hi; ++lane)
                    parts[part][k].include(place.x[lane], place.y[lane], place.wide[lane]);
            }
        }
    });
    for (std::size_t part = 1; part < parts.size(); ++part)
        for (std::size_t k = 0; k < sightings.size(); ++k) parts[0][k].include(parts[part][k]);
    return parts[0];
}

}  // namespace

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
    if (records) record_.emplace(poses_, log_weights_);
}

std::shared_ptr<Rows> Filter::fresh(int rows) {
    for (const auto& buffer : buffers_.all) {
        if (buffer.use_count() != 1 || buffer->rows() != rows) continue;
        // `use_count` does not order memory: what the last other owner read must be read before it is overwritten
        std::atomic_thread_fence(std::memory_order_acquire);
        return buffer;
    }
    auto buffer = std::make_shared<Rows>(rows, particles_);
    // buffers of a record are never free again
    if (!record_ && buffers_.all.size() < 16) buffers_.all.push_back(buffer);
    return buffer;
}

void Filter::use_ids(bool oriented, std::size_t jointly, std::optional<RangeNoise> range_noise) {
    require(jointly <= most_sightings, "at most 16 sightings are weighed together");
    identified_.emplace(particles_, oriented, jointly, range_noise);
}

void Filter::use_no_ids(bool oriented, const AnonymousOptions& options, Confusion confusion) {
    anonymous_.emplace(particles_, oriented, options, std::move(confusion));
}

std::vector<LandmarkId> Filter::landmarks() const {
    if (identified_) return identified_->ids();
    return anonymous_ ? anonymous_->ids() : std::vector<LandmarkId>{};
}

LandmarkView Filter::view(LandmarkId landmark) {
    if (identified_) return identified_->view(landmark, history_);
    return anonymous_ ? anonymous_->view(landmark, history_) : LandmarkView{};
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
    if (anonymous_) anonymous_->end_step(*poses_, step_, ranges_, history_);
}

Proposal Filter::proposal(Version version) const {
    if (version == Version::motion || !motion_) return Proposal(*poses_);
    return Proposal(*starts_, *motion_, version == Version::corrected_exact);
}

/// Predict, associate, correct, draw, weigh, update the map; see `Weighed`.
template <class Scan>
void Filter::weigh(const Proposal& proposal, const Scan& scan) {
    const auto poses = proposal.corrects() ? fresh(3) : nullptr;
    ranges_.each([&](std::size_t lo, std::size_t hi) {
        typename Scan::Group group(scan);
        for (std::size_t i = lo; i < hi; i += lanes) {
            Gaussian belief = proposal.predict(i);
            Lanes log_likelihood = group.begin(i, belief);
            if (poses) log_likelihood += group.correct(belief, proposal.weighed());
            const auto [pose, log_ratio] = proposal.draw(i, belief);
            // log p(x) - log q(x), and log p(z | x)
            log_likelihood += log_ratio;
            log_likelihood += group.update(pose, proposal.weighed());
            numbers::store(log_likelihoods_.row(0) + i, log_likelihood);
            if (poses) write_pose(*poses, i, pose);
        }
        if (poses) history_.amend(*poses, lo, hi);
    });
    if (poses) poses_ = poses;
    // the poses now depend on the sightings: later sightings of this step must not correct the motion again
    motion_.reset();
}

void Filter::weigh_known(std::span<const KnownSighting> sightings) {
    ranges_.each([&](std::size_t lo, std::size_t hi) {
        for (std::size_t i = lo; i < hi; i += lanes) {
            const Pose pose = read_pose(*poses_, i);
            Lanes value{};
            // N(z; h(x, m), Q + H S H')
            for (const KnownSighting& k : sightings)
                value += k.exact()
                             ? known_likelihood(pose, k.landmark, k.sighting, k.oriented)
                             : predicted_likelihood(certain(pose), common(k.landmark, k.covariance), k.sighting, k.oriented);
            numbers::store(log_likelihoods_.row(0) + i, value);
        }
    });
    motion_.reset();
}

bool Filter::weigh_identified(std::span<const LandmarkId> ids, std::span<const Sighting> sightings, Version version) {
    const auto known = [&](LandmarkId id) { return identified_->has(id); };
    // steps without sightings of known landmarks move as in 1.0, without linearisation
    if (std::none_of(ids.begin(), ids.end(), known)) version = Version::motion;
    const auto scan = identified_->scan(ids, sightings, history_);
    weigh(proposal(version), scan);
    identified_->end_scan();
    return scan.weighs();
}

void Filter::weigh_anonymous(std::span<const Sighting> sightings, std::span<const std::int64_t> shown, Version version) {
    const Proposal from = proposal(version);
    const std::vector<Box> boxes = boxes_of(from, sightings, anonymous_->gate(), ranges_);
    const AnonymousScan scan = anonymous_->scan(sightings, shown, boxes, step_, history_);
    weigh(from, scan);
    anonymous_->end_scan(scan, ranges_, history_);
}

void Filter::weigh_by(std::span<const double> log_likelihoods) {
    std::copy(log_likelihoods.begin(), log_likelihoods.end(), log_likelihoods_.row(0));
    // the weights now depend on the poses: later sightings of this step must not correct these
    motion_.reset();
}

Filter::Reweighed Filter::reweigh() {
    const auto updated = fresh(1);
    double* const log_weights = updated->row(0);
    for (std::size_t i = 0; i < particles_; ++i) log_weights[i] = log_likelihoods_.row(0)[i] + log_weights_->row(0)[i];
    const auto place = static_cast<std::size_t>(std::max_element(log_weights, log_weights + particles_) - log_weights);
    const double highest = log_weights[place];
    if (!(highest > -std::numeric_limits<double>::infinity())) return {false, 0.0, 0.0};
    const WeightSums sums = normalize({log_weights, particles_}, highest, weights_.row(0));
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
