// Poses, Gaussians and sightings of eight particles.
#pragma once

#include <limits>

#include "vmslam/edges/arithmetic.hpp"
#include "vmslam/numbers/elementary.hpp"
#include "vmslam/particles/rows.hpp"

namespace vmslam::particles {

using edges::LowerRoot;
using edges::Symmetric;
using edges::Vector;

inline constexpr double infinity = std::numeric_limits<double>::infinity();

struct Pose {
    Lanes x, y, t;
};

/// Mean and covariance of a landmark or of a pose, (x, y, heading). Without a heading xh, yh and hh have no meaning.
struct Gaussian {
    Lanes x, y, h, xx, xy, xh, yy, yh, hh;

    Pose mean() const { return {x, y, h}; }
};

/// The same Gaussian for all particles.
inline Gaussian common(const Vector& mean, const Symmetric& S) {
    const auto all = [](double x) { return numbers::all<Lanes>(x); };
    return {all(mean.x), all(mean.y), all(mean.t), all(S.xx), all(S.xy), all(S.xt), all(S.yy), all(S.yt), all(S.tt)};
}

/// Poses that are known.
inline Gaussian certain(const Pose& pose) {
    const Lanes zero{};
    return {pose.x, pose.y, pose.t, zero, zero, zero, zero, zero, zero};
}

/// Range, bearing and psi of a sighting, or their variances.
struct Reading {
    double range, bearing, psi;
};

struct Sighting {
    Reading z, variances;
};

inline Pose read_pose(const Rows& rows, std::size_t first, const Index* ancestors = nullptr) {
    return {read(rows.row(0), first, ancestors), read(rows.row(1), first, ancestors), read(rows.row(2), first, ancestors)};
}

inline void write_pose(Rows& rows, std::size_t first, const Pose& pose) {
    numbers::store(rows.row(0) + first, pose.x);
    numbers::store(rows.row(1) + first, pose.y);
    numbers::store(rows.row(2) + first, pose.t);
}

/// How many rows a Gaussian has. Without a heading these are x, y, xx, xy, yy, otherwise x, y, h, xx, xy, xh, yy, yh, hh.
constexpr int gaussian_rows(bool oriented) { return oriented ? 9 : 5; }

/// Which of them are those of the position.
struct PositionRows {
    int x, y, xx, xy, yy;
};
constexpr PositionRows position_rows(bool oriented) {
    return oriented ? PositionRows{0, 1, 3, 4, 6} : PositionRows{0, 1, 2, 3, 4};
}

inline Gaussian read_gaussian(const Blocks& blocks, bool oriented, std::size_t first, const Index* ancestors = nullptr) {
    const auto at = [&](int k) { return read(blocks, k, first, ancestors); };
    if (oriented) return {at(0), at(1), at(2), at(3), at(4), at(5), at(6), at(7), at(8)};
    const Lanes zero{};
    return {at(0), at(1), zero, at(2), at(3), zero, at(4), zero, zero};
}

inline void write_gaussian(Blocks& blocks, bool oriented, std::size_t first, const Gaussian& g) {
    const auto put = [&](int k, const Lanes& value) { numbers::store(blocks.group(k, first), value); };
    put(0, g.x), put(1, g.y);
    if (oriented) {
        put(2, g.h), put(3, g.xx), put(4, g.xy), put(5, g.xh), put(6, g.yy), put(7, g.yh), put(8, g.hh);
    } else {
        put(2, g.xx), put(3, g.xy), put(4, g.yy);
    }
}

inline Gaussian select(const numbers::Integers& condition, const Gaussian& a, const Gaussian& b) {
    using numbers::select;
    return {select(condition, a.x, b.x),   select(condition, a.y, b.y),   select(condition, a.h, b.h),
            select(condition, a.xx, b.xx), select(condition, a.xy, b.xy), select(condition, a.xh, b.xh),
            select(condition, a.yy, b.yy), select(condition, a.yh, b.yh), select(condition, a.hh, b.hh)};
}

}  // namespace vmslam::particles
