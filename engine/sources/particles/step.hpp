// One observation step of the particles: a template over the proposal of the poses, and over the map with its association.
#pragma once

#include "vmslam/particles/filter.hpp"

namespace vmslam::particles {

/// FastSLAM 1.0 and Monte Carlo localisation: the poses are those of the motion.
class Given {
   public:
    static constexpr bool corrects = false;
    explicit Given(const Rows& poses) : poses_(poses) {}

    bool exact() const { return true; }
    Gaussian predict(std::size_t first) const {
        const Pose x = read_pose(poses_, first);
        const Lanes zero{};
        return {x.x, x.y, x.t, zero, zero, zero, zero, zero, zero};
    }
    Drawn draw(std::size_t, const Gaussian& belief) const { return {belief.mean(), Lanes{}}; }

   private:
    const Rows& poses_;
};

/// FastSLAM 2.0: the poses are drawn from the motion, corrected by the sightings, with exact or with linearised weights.
class Corrected {
   public:
    static constexpr bool corrects = true;
    Corrected(const Rows& starts, const Motion& motion, bool exact)
        : starts_(starts), key_(motion.key), prediction_(particles::predict(motion, exact)) {
        if (exact) weighted_.emplace(motion);
    }

    bool exact() const { return weighted_.has_value(); }
    Gaussian predict(std::size_t first) const { return prediction_.of(read_pose(starts_, first)); }
    Drawn draw(std::size_t first, const Gaussian& belief) const {
        const numbers::Bits particles = particles_of(first);
        if (weighted_) return (*weighted_)(read_pose(starts_, first), belief, particles);
        const auto [n0, n1] = numbers::normal_pair<Lanes>(key_, particles, 0);
        return {drawn(belief, n0, n1, numbers::normal_pair<Lanes>(key_, particles, 1).first), Lanes{}};
    }

   private:
    const Rows& starts_;
    std::uint64_t key_;
    Prediction prediction_;
    std::optional<WeightedDraw> weighted_;
};

/// The sightings of landmarks at known places.
class KnownScan {
   public:
    explicit KnownScan(std::span<const KnownSighting> sightings) : sightings_(sightings) {}

    class Group {
       public:
        explicit Group(const KnownScan& scan) : scan_(scan) {}
        Lanes begin(std::size_t, const Gaussian&) const { return Lanes{}; }
        Lanes update(const Pose& pose, bool) const {
            Lanes value{};
            for (const KnownSighting& k : scan_.sightings_)
                value += known_likelihood(pose, k.landmark, k.sighting, k.oriented);
            return value;
        }

       private:
        const KnownScan& scan_;
    };

   private:
    std::span<const KnownSighting> sightings_;
};

/// The particles `lo` to `hi`: predict, associate, correct, draw, weigh, update the map.
template <class Proposal, class Scan>
void weigh_particles(const Proposal& proposal, const Scan& scan, Rows* drawn, double* log_likelihoods, std::size_t lo,
                     std::size_t hi) {
    typename Scan::Group group(scan);
    for (std::size_t i = lo; i < hi; i += lanes) {
        Gaussian belief = proposal.predict(i);
        Lanes log_likelihood = group.begin(i, belief);
        if constexpr (Proposal::corrects) log_likelihood += group.correct(belief, !proposal.exact());
        const auto [pose, log_ratio] = proposal.draw(i, belief);
        // log p(x) - log q(x), and log p(z | x)
        log_likelihood += log_ratio;
        log_likelihood += group.update(pose, proposal.exact());
        numbers::store(log_likelihoods + i, log_likelihood);
        if (drawn) write_pose(*drawn, i, pose);
    }
}

/// For each sighting the box that holds the mean of each landmark that is a hypothesis of a particle; see `place_of`.
template <class Proposal>
std::vector<Box> boxes_of(const Proposal& proposal, std::span<const Sighting> sightings, double gate, const Ranges& ranges) {
    std::vector<std::vector<Box>> parts(ranges.count(), std::vector<Box>(sightings.size()));
    in_parallel(static_cast<int>(ranges.count()), [&](int part) {
        const std::size_t hi = ranges.edge(part + 1);
        for (std::size_t i = ranges.edge(part); i < hi; i += lanes) {
            const Gaussian belief = proposal.predict(i);
            for (std::size_t k = 0; k < sightings.size(); ++k) {
                const Place place = place_of(belief, sightings[k], gate);
                for (int lane = 0; lane < lanes && i + lane < hi; ++lane)
                    parts[part][k].include(place.x, place.y, place.wide, lane);
            }
        }
    });
    for (std::size_t part = 1; part < parts.size(); ++part)
        for (std::size_t k = 0; k < sightings.size(); ++k) parts[0][k].include(parts[part][k]);
    return parts[0];
}

}  // namespace vmslam::particles
