// What all edges that come from sightings have in common, and sightings grouped by landmark.
//
// Every sighting places its landmark at y = h^-1(x, z) with covariance C = R Q R'. When the pose rotates, y moves by the
// lever t = (-v_y, v_x) per radian, where v leads from the pose to the landmark. It is l (cos, sin)(theta + phi), plus
// R(theta) o where the sensor sits at o on the robot.
#pragma once

#include <vector>

#include "vmslam/edges/family.hpp"
#include "vmslam/sparse/pattern.hpp"

namespace vmslam::edges {

/// The noise of a sensor, and its place on the robot.
struct Sensor {
    double range_by_square;  ///< the variance of the range, over the square of the range, ...
    double range_constant;   ///< ... and the part that does not grow
    double bearing, orientation;  ///< variances
    double offset_x, offset_y;

    double range_variance(double l) const { return range_by_square * l * l + range_constant; }
};

/// C = R Q R' with R = [[c, -l s, 0], [s, l c, 0], [0, 1, -1]], for a landmark at range l in the direction (c, s).
inline Symmetric landmark_covariance(const Sensor& sensor, double l, const Rotation& along, bool oriented) {
    const double c = along.c, s = along.s, range = sensor.range_variance(l), across = sensor.bearing * l * l;
    Symmetric C{range * c * c + across * s * s, (range - across) * c * s, range * s * s + across * c * c, 0.0, 0.0, 0.0};
    if (oriented) {
        C.xt = -sensor.bearing * l * s;
        C.yt = sensor.bearing * l * c;
        C.tt = sensor.bearing + sensor.orientation;
    }
    return C;
}

/// z = (l, phi, psi); psi is 0 where it is not measured.
struct Sighting {
    double range, bearing, orientation;
};

/// How the covariance is treated: evaluated at the reference; in the landmark's own axes; evaluated at the reference, and
/// then rotating with the pose.
enum class Covariance { reference, landmark, rotating };

/// Sightings at a state: y, t, the heading gamma of the axes of C, and C.
struct Placed {
    Vector y;
    Lever lever;
    double gamma;
    Symmetric C;
};

/// Range and bearing sightings by one sensor with a robust kernel. The covariance of each is evaluated at its `noisy` values,
/// and its information multiplied by its `trust`.
struct Sightings {
    std::vector<Sighting> z, noisy;
    std::vector<double> trust;
    Sensor sensor;
    Kernel kernel;
    bool oriented;

    /// Add sighting k of other ones.
    void add(const Sightings& from, std::size_t k);
    /// None with this sensor and this kernel.
    Sightings emptied() const { return {{}, {}, {}, sensor, kernel, oriented}; }
};

/// Sightings grouped by landmark: landmark g has those from starts[g] to starts[g + 1], by increasing node.
struct ByLandmark {
    std::vector<Index> starts, nodes;
    Sightings sightings;
};

/// Edges from the sightings of landmarks that are no nodes, grouped as in `ByLandmark`.
class LandmarkSightings : public Family {
   public:
    explicit LandmarkSightings(ByLandmark seen);

    std::vector<Placed> placed(const State& state, Covariance mode) const;
    /// The sightings with all poses at the origin, so that places are in the axes of the poses.
    std::vector<Placed> from_robot(Covariance mode) const;
    std::vector<HeadingRelation> headings() const override;
    std::vector<PositionRelation> positions(const double* state) const override;
    std::size_t measurements() const override { return nodes_.size(); }

   protected:
    /// The sightings from the nodes that have a new number, not -1, of the landmarks that these see.
    ByLandmark from_nodes(std::span<const Index> number) const;

    Index landmarks() const { return static_cast<Index>(starts_.size()) - 1; }
    /// The numbers of the sightings from a node.
    std::span<const Index> from(Index node) const {
        return {by_node_.places.data() + by_node_.start[node], by_node_.places.data() + by_node_.start[node + 1]};
    }
    Index last_node() const { return static_cast<Index>(by_node_.start.size()) - 2; }

    std::vector<Index> starts_, nodes_, groups_;  ///< `groups_`: the landmark of each sighting
    Sightings seen_;

   private:
    /// Call use(a, b) for the sightings a and b of a landmark that follow each other, from different nodes.
    template <class Use>
    void for_consecutive(Use use) const;

    sparse::Sorted by_node_;
};

}  // namespace vmslam::edges
