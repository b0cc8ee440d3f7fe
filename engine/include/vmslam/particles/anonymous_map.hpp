// The maps of all particles for sightings without ids: each particle decides which landmark it saw.
//
// Every particle has a map with its own number of landmarks. The maps lie side by side in a pool: place i of slice c is what
// particle i knows of landmark c, if it has that landmark. A scan creates at most one landmark per sighting, common to all
// particles that take the sighting for a new landmark, so only landmarks created by one sighting share a slice. Resampling
// touches nothing; a slice that comes into view is first brought to the current particle indices. Landmarks away from the
// sightings, by the bounding box of their means, cost nothing.
//
// Sources: Montemerlo and Thrun, Simultaneous localization and mapping with unknown data association using FastSLAM, ICRA
// 2003; Probabilistic Robotics, section 13.6 (association per particle, evidence and removal of landmarks).
#pragma once

#include "vmslam/particles/association.hpp"
#include "vmslam/particles/history.hpp"
#include "vmslam/particles/ranges.hpp"

namespace vmslam::particles {

/// When a sighting belongs to a new landmark, and when two landmarks are one.
struct AnonymousOptions {
    /// the squared Mahalanobis distance at the border of the ellipse beyond which a sighting is of a new landmark
    double border;
    /// and that within which two landmarks are one; they are merged after every so many steps with sightings, 0: never
    double merge_gate;
    std::size_t merge_interval;
    /// NaN: to be learned from the sightings
    Limits limits;
};

class AnonymousMap {
   public:
    AnonymousMap(std::size_t particles, bool oriented, const AnonymousOptions& options, Confusion confusion);

    bool oriented() const { return oriented_; }
    const Confusion& confusion() const { return confusion_; }
    double gate() const { return gate_; }

    /// The landmarks that some particle has, numbered in the order of creation.
    std::vector<std::int64_t> ids() const;
    std::size_t slices() const { return slices_.size(); }
    std::int64_t created() const { return created_; }
    LandmarkView view(std::int64_t landmark, History& history) const;

    /// `boxes`: for each sighting the box that holds the means of the landmarks that are hypotheses of some particle, as far
    /// as they are perfectly known; see `place_of`.
    AnonymousScan scan(std::span<const Sighting> sightings, std::span<const std::int64_t> shown, std::span<const Box> boxes,
                       std::int64_t step, History& history);
    /// Record what a scan has written.
    void end_scan(const AnonymousScan& scan, const Ranges& ranges, History& history);

    /// Lower the evidence for landmarks that were in view of these poses but in no scan of the step. This waits for the end
    /// of the step because another scan of the step might still have seen them. Every so many steps, landmarks of a particle
    /// that are one are merged.
    void end_step(const Rows& poses, std::int64_t step, const Ranges& ranges, History& history);

   private:
    struct Slice {
        Blocks rows;
        std::int64_t landmark = -1, level = 0;
        Extent extent = {};
    };

    void learn(std::span<const Sighting> sightings);
    std::vector<std::size_t> within(std::span<const Box> boxes) const;
    void bring_up_to_date(std::span<const std::size_t> slices, History& history);
    std::vector<std::size_t> make_room(std::size_t count, History& history);
    void enlarge(std::size_t more);
    std::vector<Blocks*> rows_of(std::span<const std::size_t> slices);
    void written(std::span<const std::size_t> slices, const Ranges& ranges, History& history);

    std::size_t particles_;
    bool oriented_;
    AnonymousOptions options_;
    Confusion confusion_;
    double gate_;
    Blur blur_{0.0, 0.0};
    std::vector<Slice> slices_;
    Blocks spare_;
    std::int64_t created_ = 0;
    std::size_t steps_ = 0;
    Limits limits_;
};

}  // namespace vmslam::particles
