// A range or a bearing alone, from a pose to a landmark or to another pose.
//
// With (x, y) = R(theta_i)' (p_j - p_i) - o where the sensor at o on the robot sees the second end, and d = abs((x, y)),
//
//     range    e = d - z,                                     n = (x, y) / d,
//     bearing  e = atan2(y, x) - z,   the angle wrapped,      n = (-y, x) / d²,
//
// n the derivative by (x, y). So with W = omega n n' and the pull omega e n in the place of Omega e they are edges to a
// point.
#pragma once

#include <algorithm>
#include <vector>

#include "vmslam/edges/family.hpp"

namespace vmslam::edges {

enum class Number { range, bearing };

/// The residual of a number where the sensor sees the second end at (x, y), its derivative there, and the distance, at least
/// `nearest`.
struct NumberSeen {
    double e;
    Lever n;
    double distance;
};
inline NumberSeen number_seen(Number kind, double z, double x, double y) {
    // below this distance the direction is not defined
    constexpr double nearest = 1e-6;
    const double distance = std::hypot(x, y), d = std::max(distance, nearest);
    if (kind == Number::range) return {distance - z, {x / d, y / d}, d};
    return {wrap(std::atan2(y, x) - z), {-y / (d * d), x / (d * d)}, d};
}

/// omega n n'
inline Symmetric along(double omega, const Lever& n) { return outer(omega, {n.x, n.y, 0.0}); }

/// The second derivatives by (x, y), from the derivative n and the distance: (I - n n') / d of a range, and n m' + m n' of a
/// bearing, m = -(x, y) / d².
inline Symmetric bent(Number kind, const Lever& n, double d) {
    if (kind == Number::range) return {n.y * n.y / d, -n.x * n.y / d, n.x * n.x / d, 0.0, 0.0, 0.0};
    return {-2 * n.x * n.y, n.x * n.x - n.y * n.y, 2 * n.x * n.y, 0.0, 0.0, 0.0};
}

/// The number `z` of node j seen from pose i.
struct NumberEdge {
    Index i, j;
    double z, omega;
    Lever offset;
};

class NumberEdges : public EdgeList<NumberEdges, NumberEdge> {
   public:
    NumberEdges(Number kind, std::vector<NumberEdge> edges, Kernel kernel)
        : EdgeList(std::move(edges), kernel), kind_(kind) {}
    double accumulate(const State& state, System* system, std::span<const Index> pairs) const override;
    bool curves() const override { return true; }
    std::vector<double> squares(const double* state, std::span<const double> trust) const override;

   private:
    Number kind_;
};

}  // namespace vmslam::edges
