// Unknown data association: every particle decides by itself which landmark each sighting belongs to.
//
// The hypotheses of a sighting k are the landmarks j near it, with w_j = N(z_k; h(m_j), V) under the predicted pose, and a
// new landmark, with w_0. The most likely pair of the scan is taken first, and no landmark twice. Where sightings have
// classes, w_j is also multiplied by n sum over c of p(c) P(shown k given c): by how much this class is likelier than for a
// new landmark.
//
// A landmark is a slice of rows: 0 to 8 are the Gaussian; 9 is the evidence for the landmark, 0 where the particle does not
// have it; 10 is the step of its last sighting. With n classes, rows 11 to 10 + n are p(c), the probability that it is of
// class c.
#pragma once

#include <limits>
#include <span>

#include "vmslam/particles/kalman.hpp"

namespace vmslam::particles {

inline constexpr int evidence_row = 9, last_step_row = 10, first_class_row = 11;
/// The evidence is the number of sightings minus the number of misses: confirmed when seen twice, permanent when three times.
inline constexpr double permanent_evidence = 3.0;

/// Smallest and largest x and y.
struct Box {
    double left = std::numeric_limits<double>::infinity(), right = -left, low = left, high = -left;

    void include(const Box& other);
    /// A point, `wide` in every direction.
    void include(double x, double y, double wide) { include({x - wide, x + wide, y - wide, y + wide}); }
    bool overlaps(const Box& other) const;
};

/// P(shown k given class c), (n, n + 1) by rows; the last column, 1/n, is for sightings of unknown class; n = 0: no classes.
struct Confusion {
    std::size_t classes = 0;
    std::vector<double> numbers;

    double operator()(std::size_t c, std::int64_t shown) const {
        return numbers[c * (classes + 1) + static_cast<std::size_t>(shown)];
    }
};

/// Variances [m², rad²] by which the covariances are too small, because errors of sightings are correlated.
struct Blur {
    double position, heading;
};

/// Where in the world a sighting may be, for the particles of a group: the mean m of a landmark that is perfectly known lies
/// within `wide` of (x, y) in each direction if it is a hypothesis. For another landmark this is wider by 2 sqrt(gate trace
/// S). With the gate on range l and bearing, abs(m - z) <= sqrt(gate) (2 sqrt(trace S) + 2 sqrt(trace P) + sigma_l + l
/// (sigma_theta + sigma_phi)), S and P the covariances of the positions of landmark and robot.
struct Place {
    Lanes x, y, wide;
};
Place place_of(const Gaussian& belief, const Sighting& sighting, double gate);

/// The scan of one step, and the landmarks that it may have seen.
struct AnonymousScan {
    std::span<const Sighting> sightings;
    /// the class of each sighting, and its log likelihood if it belongs to a new landmark
    std::span<const std::int64_t> shown;
    std::vector<double> log_new;
    bool oriented;
    double gate, step;
    const Confusion* confusion;
    /// slices that may be in view, in the order of creation, and one for each sighting of a new landmark
    std::vector<Blocks*> near, fresh;
    std::vector<std::size_t> near_slices, fresh_slices;

    /// The scan as a group of particles sees it.
    class Group;
};

class AnonymousScan::Group {
   public:
    explicit Group(const AnonymousScan& scan)
        : scan_(scan), hypotheses_(scan.sightings.size()), chosen_(scan.sightings.size()), won_(scan.sightings.size()) {}

    /// The functions of a group, see `Weighed`. The sightings of new landmarks, and the classes of the others, are weighed
    /// when the landmarks are chosen.
    Lanes begin(std::size_t first, const Gaussian& belief);
    Lanes correct(Gaussian& belief, Weighed weighed) const;
    Lanes update(const Pose& pose, Weighed weighed) const;

   private:
    /// A landmark that may be that of a sighting, and the log likelihoods; -inf where it is no hypothesis.
    struct Hypothesis {
        std::int64_t landmark;
        Lanes score;
    };
    void weigh_landmark(const Gaussian& belief, std::int64_t c);
    void choose();
    numbers::Integers conflicts() const;
    void choose_in_order(int lane);
    template <class Row>
    Lanes class_ratio(std::size_t k, const Row& row) const;
    auto chosen(std::size_t k) const {
        return [this, k](int row) { return chosen_numbers(k, row); };
    }
    Lanes chosen_numbers(std::size_t k, int row) const;
    Gaussian chosen_landmark(std::size_t k) const;
    void write_chosen(std::size_t k, const numbers::Integers& known, int row, const Lanes& value) const;
    void update_known(std::size_t k, const Gaussian& landmark) const;
    void create(std::size_t k, const Pose& pose) const;

    const AnonymousScan& scan_;
    std::size_t first_ = 0;
    std::vector<std::vector<Hypothesis>> hypotheses_;
    /// for each sighting the place in `near` of its landmark, -1: a new one; and its log likelihood
    std::vector<numbers::Integers> chosen_;
    std::vector<Lanes> won_;
};

// --- which landmarks exist: evidence against those not seen, and landmarks that are one

/// Limits of range [m] and bearing [rad] within which a sensor sees, or a landmark should be seen.
struct Limits {
    double least_range, most_range, most_bearing;
};

/// Lower the evidence for landmarks that were in view in this step without a sighting, except for permanent ones.
void count_misses(std::span<Blocks* const> landmarks, const Rows& poses, double step, const Limits& view, std::size_t lo,
                  std::size_t hi);

/// How many particles have a landmark, whether any may still drop it, and where it lies: the box holds the means with the
/// margin that `place_of` leaves to it.
struct Extent {
    std::size_t owners = 0;
    bool droppable = false;
    Box box;
    void include(const Extent& other);
};
Extent extent_of(const Blocks& landmark, double gate, std::size_t lo, std::size_t hi);

/// Merge landmarks of a particle that are one: the older takes what the younger knows, and the younger goes.
///
/// They are one where the squared Mahalanobis distance of their means, under S_a + S_b + diag(blur), is at most the gate, and
/// the last scan that saw one of them did not see both. With n classes, 2 log of n sum over c of p(c) p'(c), by which two
/// landmarks of one class are likelier than any two, is subtracted from the distance. The older ones come first.
void merge(std::span<Blocks* const> landmarks, bool oriented, double gate, const Blur& blur, std::size_t classes,
           std::size_t lo, std::size_t hi);

}  // namespace vmslam::particles
