// Gaussians of landmarks and of single poses: fuse, move to other axes, draw.
//
// Sightings are relative places
//
//     q = (R(theta)' (m - p), m_h - theta),    y | x, m ~ N(q, C),
//
// with C constant in the axes of the robot. Seen from a known pose, a sighting is y in world axes with a turned C: an
// observation of the landmark itself. So fusing sightings and integrating landmarks out is exact linear algebra, and the
// order of the sightings does not matter. Without psi (not `oriented`) the heading is a number of variance 1 on which nothing
// depends.
#pragma once

#include "vmslam/edges/arithmetic.hpp"
#include "vmslam/gibbs/random.hpp"
#include "vmslam/numbers/elementary.hpp"

namespace vmslam::gibbs {

using edges::LowerRoot;
using edges::Rotation;
using edges::Symmetric;
using edges::Vector;
using numbers::wrap_angle;

inline Rotation rotation(double angle) {
    const auto [sine, cosine] = numbers::sincos(angle);
    return {cosine, sine};
}

/// A pose with the cosine and sine of its heading.
struct Frame {
    Vector at;
    Rotation axes;

    Frame() : at{} {}
    explicit Frame(const Vector& pose) : at(pose), axes(rotation(pose.t)) {}
};

/// The pose that lies at d in the axes of a pose.
inline Vector composed(const Frame& pose, const Vector& d) {
    const Vector v = edges::turned(pose.axes, d);
    return {pose.at.x + v.x, pose.at.y + v.y, wrap_angle(pose.at.t + v.t)};
}

/// Where another pose or a landmark lies in the axes of a pose.
inline Vector relative(const Frame& pose, const Vector& other) {
    const double dx = other.x - pose.at.x, dy = other.y - pose.at.y, c = pose.axes.c, s = pose.axes.s;
    return {c * dx + s * dy, c * dy - s * dx, wrap_angle(other.t - pose.at.t)};
}

/// The deviation d - motion, the heading wrapped, and zero where nothing depends on it.
inline Vector deviation(const Vector& motion, const Vector& d, bool oriented = true) {
    return {d.x - motion.x, d.y - motion.y, oriented ? wrap_angle(d.t - motion.t) : 0.0};
}

/// r' W r
inline double squared(const Symmetric& W, const Vector& r) { return edges::dot(r, W * r); }

struct Inverse {
    Symmetric matrix;
    double determinant;
};

inline Inverse inverse(const Symmetric& V) { return {edges::inverse(V, true), edges::determinant(V)}; }

inline Vector normals(Random& random) {
    const double x = random.normal(), y = random.normal(), t = random.normal();
    return {x, y, t};
}

/// A draw from N(mean, S).
inline Vector drawn(Random& random, const Vector& mean, const Symmetric& S) {
    const Vector d = mean + LowerRoot(S) * normals(random);
    return {d.x, d.y, wrap_angle(d.t)};
}

/// A landmark. A negative S.xx marks one that has not been seen: its prior is flat.
struct Gaussian {
    Vector mean{};
    Symmetric S{-1.0, 0.0, 0.0, 0.0, 0.0, 0.0};

    bool seen() const { return S.xx >= 0; }
};

/// A landmark in the axes of a pose, in those in which the pose is given.
inline Gaussian composed(const Frame& pose, const Gaussian& mark) {
    return {composed(pose, mark.mean), edges::turned(pose.axes, mark.S)};
}

/// log N(r; 0, V) without the constant of 2 pi, for the inverse of V and W r.
inline double log_density(const Vector& r, const Inverse& W, const Vector& g) {
    return -0.5 * (edges::dot(r, g) + logarithm(W.determinant));
}

/// The sum of many log densities; one logarithm serves many determinants, whose product stays within floating point.
class LogDensities {
   public:
    /// Add log N(mean_b; mean_a, S_a + S_b).
    void add(const Gaussian& a, const Gaussian& b, bool oriented) {
        const Inverse W = inverse(a.S + b.S);
        const Vector r = deviation(a.mean, b.mean, oriented);
        squares_ += squared(W.matrix, r);
        determinants_ *= W.determinant;
        if (determinants_ > 1e-200 && determinants_ < 1e200) return;
        logarithms_ += logarithm(determinants_);
        determinants_ = 1.0;
    }
    double sum() const { return -0.5 * (squares_ + logarithms_ + logarithm(determinants_)); }

   private:
    double squares_ = 0.0, determinants_ = 1.0, logarithms_ = 0.0;
};
/// log N(mean_b; mean_a, S_a + S_b) without the constant of 2 pi.
inline double density(const Gaussian& a, const Gaussian& b, bool oriented) {
    LogDensities one;
    one.add(a, b, oriented);
    return one.sum();
}

/// Let a landmark absorb an observation of it, N(y; m, C); returns log N(y; mean, S + C), 0 for the first one.
double fuse(Gaussian& mark, const Gaussian& observed, bool oriented);

/// The information L on a small displacement d of a pose, in its own axes, and eta = L d at its mode.
struct Information {
    Symmetric L{};
    Vector eta{};

    /// eta' d - d' L d / 2
    double quadratic(const Vector& d) const { return edges::dot(eta, d) - 0.5 * squared(L, d); }
    /// Add A' W A to L and A' g to eta, A = [[1, 0, -q_y], [0, 1, q_x], [0, 0, 1]]: d moves the relative place q to q - A d.
    void add_at(const Vector& q, const Symmetric& W, const Vector& g);
    /// Add that of a sighting N(y; q, C) of a landmark: A' V^-1 A and A' V^-1 (q - y), V = S + C, S in the axes of the pose.
    void add_sighting(const Frame& pose, const Gaussian& mark, const Gaussian& sighting, bool oriented);
};

/// W - W (W + M)^-1 W = (W^-1 + M^-1)^-1: the information M after noise of the information W.
Symmetric passed(const Symmetric& W, const Symmetric& M);

}  // namespace vmslam::gibbs
