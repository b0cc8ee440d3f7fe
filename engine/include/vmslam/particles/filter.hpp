// A particle filter: N weighted particles that move, are weighed by sightings and are resampled.
//
// With a known map it is Monte Carlo localisation. With a map of its own for each particle it is FastSLAM: in 1.0 the poses
// are drawn from the motion, in 2.0 from the motion corrected by the sightings.
#pragma once

#include <memory>
#include <optional>

#include "vmslam/particles/anonymous_map.hpp"
#include "vmslam/particles/identified_map.hpp"
#include "vmslam/particles/proposal.hpp"
#include "vmslam/particles/record.hpp"
#include "vmslam/particles/weights.hpp"

namespace vmslam::particles {

/// Which poses are weighed: those drawn from the motion (1.0), or from the corrected motion (2.0) with its exact weight or
/// with that of the lectures, as if h and f were linear.
enum class Version { motion, corrected_exact, corrected_linearised };

/// A sighting of a landmark on a known map, with the covariance S of its place; `oriented`: psi is used.
struct KnownSighting {
    Vector landmark;
    Symmetric covariance;
    Sighting sighting;
    bool oriented;

    bool exact() const { return covariance.xx == 0.0 && covariance.yy == 0.0 && covariance.tt == 0.0; }
};

class Proposal;

/// A copy continues with the same numbers.
class Filter {
   public:
    /// `poses`: the first poses; `records`: whether all particles of all steps are kept, for backward simulation.
    Filter(Rows poses, std::size_t threads, bool records);

    std::size_t particles() const { return particles_; }
    const Ranges& ranges() const { return ranges_; }
    History& history() { return history_; }
    const std::optional<Record>& record() const { return record_; }
    std::shared_ptr<const Rows> poses() const { return poses_; }
    std::shared_ptr<const Rows> log_weights() const { return log_weights_; }
    /// The log likelihoods of the last `weigh`, and the weights of the last `reweigh`, of which the largest is 1.
    std::span<const double> log_likelihoods() const { return {log_likelihoods_.row(0), particles_}; }
    std::span<const double> weights() const { return {weights_.row(0), particles_}; }
    /// The particle of the largest weight, as of the last sightings.
    std::size_t best() const { return best_; }

    /// Go to the next step: every particle draws its own motion. `corrects`: sightings may still correct it.
    void move(const Motion& motion, bool corrects);

    /// Maps of sightings with ids, or without; the arguments are those of `IdentifiedMap` and `AnonymousMap`.
    void use_ids(bool oriented, std::size_t jointly, std::optional<RangeNoise> range_noise);
    void use_no_ids(bool oriented, const AnonymousOptions& options, Confusion confusion);
    const std::optional<IdentifiedMap>& identified() const { return identified_; }
    const std::optional<AnonymousMap>& anonymous() const { return anonymous_; }
    /// Give all particles the same Gaussian of a landmark with an id.
    void place(LandmarkId id, const Vector& mean, const Symmetric& covariance) {
        identified_->place(id, mean, covariance, history_);
    }
    std::vector<LandmarkId> landmarks() const;
    LandmarkView view(LandmarkId landmark);

    /// Write the log likelihoods of sightings, and update the maps; returns whether any sighting was weighed.
    void weigh_known(std::span<const KnownSighting> sightings);
    bool weigh_identified(std::span<const LandmarkId> ids, std::span<const Sighting> sightings, Version version);
    void weigh_anonymous(std::span<const Sighting> sightings, std::span<const std::int64_t> shown, Version version);
    /// Take log likelihoods of the present poses that were computed elsewhere, as those of the last `weigh`.
    void weigh_by(std::span<const double> log_likelihoods);
    /// Do what has to wait until an observed step is over.
    void end_step();

    /// Multiply the weights by the likelihoods of the last `weigh` and normalise them. Where the sightings are impossible for
    /// all particles, the weights from before are kept.
    struct Reweighed {
        bool possible;
        /// the log of the sum of (weight before * likelihood), and the effective sample size
        double log_evidence, ess;
    };
    Reweighed reweigh();
    /// Let particle i descend from particle ancestors[i], ascending; all weights are then the same.
    void branch(std::span<const Index> ancestors);
    /// Remember the particles that the sightings of this step have corrected and weighed, for backward simulation.
    void remember();

   private:
    /// Buffers of poses and of weights, which are used again when nobody looks at them any more. A copy begins without any:
    /// nobody writes into those that two filters share.
    struct Buffers {
        std::vector<std::shared_ptr<Rows>> all;
        Buffers() = default;
        Buffers(const Buffers&) {}
    };

    template <class Scan>
    void weigh(const Proposal& proposal, const Scan& scan);
    Proposal proposal(Version version) const;
    std::shared_ptr<Rows> fresh(int rows);

    std::size_t particles_;
    Ranges ranges_;
    History history_;
    std::shared_ptr<const Rows> poses_, starts_, log_weights_, uniform_;
    Buffers buffers_;
    Rows log_likelihoods_, weights_;
    std::size_t best_ = 0;
    std::int64_t step_ = 0;
    /// the motion of this step, as long as sightings may correct it
    std::optional<Motion> motion_;
    std::optional<IdentifiedMap> identified_;
    std::optional<AnonymousMap> anonymous_;
    std::optional<Record> record_;
};

}  // namespace vmslam::particles
