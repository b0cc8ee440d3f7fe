// The maps of all particles for sightings with ids: one column per landmark, never copied at resampling.
//
// A column holds one landmark's Gaussian for each particle of the level at which it was last seen. Resampling does not touch
// columns. When the landmark is seen again, each particle reads what its ancestor wrote and writes its own Gaussian into
// another column. A step therefore costs what is in view, whatever the size of the map, and no two particles share a place
// that one of them could change.
//
// Rejected: copying maps at resampling (N times the landmarks at each resampling), and the literature's balanced tree per
// particle (Montemerlo et al. 2002), whose log(landmarks) pointers per particle cost more cache misses than this takes in
// total.
#pragma once

#include <list>
#include <map>
#include <optional>

#include "vmslam/particles/history.hpp"
#include "vmslam/particles/joint.hpp"
#include "vmslam/particles/kalman.hpp"

namespace vmslam::particles {

using LandmarkId = std::int64_t;

/// The noise of the range at the estimated range r: variance (rate r)² + variance.
struct RangeNoise {
    double rate, variance;
};

class IdentifiedMap {
   public:
    /// `jointly`: so many sightings of a landmark (at most `most_sightings`) are integrated together, and the following ones
    /// alone; 0: a landmark follows by the Kalman gain from each.
    IdentifiedMap(std::size_t particles, bool oriented, std::size_t jointly, std::optional<RangeNoise> range_noise)
        : particles_(particles), oriented_(oriented), jointly_(jointly), range_noise_(range_noise) {}

    bool oriented() const { return oriented_; }
    bool has(LandmarkId id) const { return columns_.contains(id); }
    std::vector<LandmarkId> ids() const;
    LandmarkView view(LandmarkId id, History& history) const;
    /// Give all particles the same Gaussian of a landmark that is known beforehand.
    void place(LandmarkId id, const Vector& mean, const Symmetric& covariance, History& history);

    /// What a step does with one sighting.
    struct Task;
    /// The tasks of a scan, in its order.
    class Scan;
    Scan scan(std::span<const LandmarkId> ids, std::span<const Sighting> sightings, History& history);
    /// Columns that a scan has replaced can be reused.
    void end_scan() { spare_.splice(spare_.end(), replaced_); }

   private:
    /// The Gaussian; where landmarks are integrated over their sightings also log Z and the poses (x, y, heading) from which
    /// the landmark was seen, and the sightings, as long as they are integrated together.
    struct Column {
        std::int64_t level;
        Blocks numbers;
        std::vector<RatedSighting> sightings;
    };

    Task first_sighting(LandmarkId id, const Sighting& sighting, History& history);
    Task later_sighting(Column& column, const Sighting& sighting, History& history);
    Blocks spare();

    std::size_t particles_;
    bool oriented_;
    std::size_t jointly_;
    std::optional<RangeNoise> range_noise_;
    std::map<LandmarkId, Column> columns_;
    /// columns that nobody uses, and those that are still read in this scan
    std::list<Blocks> spare_, replaced_;
};

struct IdentifiedMap::Task {
    /// as measured, by which poses are corrected, and with the noise at the estimated range, if that is wanted
    Sighting sighting;
    RatedSighting rated;
    Blocks* target;
    /// where the landmark is read, which was known before; null source for a first sighting
    const Blocks* source = nullptr;
    const Index* slots = nullptr;
    /// whether it is the scan's first sighting of a landmark that was known before the scan
    bool leading = false;
    /// all sightings of a landmark that follows from them together
    std::vector<RatedSighting> together;
};

class IdentifiedMap::Scan {
   public:
    Scan(bool oriented, bool integrates, std::vector<Task> tasks)
        : oriented_(oriented), integrates_(integrates), tasks_(std::move(tasks)) {}

    bool weighs() const;

    /// The sightings as a group of particles sees them.
    class Group;

   private:
    bool oriented_, integrates_;
    std::vector<Task> tasks_;
};

class IdentifiedMap::Scan::Group {
   public:
    explicit Group(const Scan& scan) : scan_(scan) {}

    /// The functions of a group, see `Weighed`. Nothing is weighed before the pose is corrected or drawn.
    Lanes begin(std::size_t first, const Gaussian&) {
        first_ = first;
        return Lanes{};
    }
    /// The pose is corrected by the first sighting of each landmark.
    Lanes correct(Gaussian& belief, Weighed weighed) const;
    Lanes update(const Pose& pose, Weighed weighed) const;

   private:
    Lanes update_one(const Task& task, const Pose& pose) const;
    void write_integral(const Task& task, const Lanes& log_evidence, std::span<const Pose> poses) const;
    Lanes update_linearised(const Task& task, const Pose& pose, Gaussian& landmark) const;
    Lanes update_alone(const Task& task, const Pose& pose, Gaussian& landmark) const;
    Lanes update_jointly(const Task& task, const Pose& pose, Gaussian& landmark) const;

    const Scan& scan_;
    std::size_t first_ = 0;
};

}  // namespace vmslam::particles
