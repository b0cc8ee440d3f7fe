// The arithmetic that the edges of all families share.
//
// In world axes, the Jacobians of an edge between two nodes are B_i = -[I, u; 0, 1] and B_j = [I, v; 0, 1]; u and v are
// called levers. `add_pair` adds B' Omega B to Omega and -B' Omega e to xi.
#pragma once

#include <algorithm>
#include <cmath>
#include <numbers>

#include "vmslam/edges/system.hpp"

namespace vmslam::edges {

/// A residual, or a pull on a node: x, y and heading. Residuals without a heading row have t = 0.
struct Vector {
    double x, y, t;
};

/// The derivative of a residual's position with respect to the heading of a node.
struct Lever {
    double x, y;
};

/// A symmetric 3 x 3 matrix; without a heading row xt = yt = tt = 0.
struct Symmetric {
    double xx, xy, yy, xt, yt, tt;
};

/// Cosine and sine of an angle.
struct Rotation {
    double c, s;
    Rotation() : c(1.0), s(0.0) {}
    explicit Rotation(double angle) : c(std::cos(angle)), s(std::sin(angle)) {}
    Rotation(double cosine, double sine) : c(cosine), s(sine) {}

    Rotation inverse() const { return {c, -s}; }
};

/// The same angle in [-pi, pi).
inline double wrap(double angle) {
    constexpr double turn = 2 * std::numbers::pi;
    return angle - turn * std::floor((angle + std::numbers::pi) / turn);
}

inline Symmetric operator+(const Symmetric& V, const Symmetric& W) {
    return {V.xx + W.xx, V.xy + W.xy, V.yy + W.yy, V.xt + W.xt, V.yt + W.yt, V.tt + W.tt};
}

inline Symmetric operator*(double f, const Symmetric& W) {
    return {f * W.xx, f * W.xy, f * W.yy, f * W.xt, f * W.yt, f * W.tt};
}

inline Vector operator*(const Symmetric& W, const Vector& e) {
    return {W.xx * e.x + W.xy * e.y + W.xt * e.t, W.xy * e.x + W.yy * e.y + W.yt * e.t, W.xt * e.x + W.yt * e.y + W.tt * e.t};
}

inline Vector operator*(double f, const Vector& v) { return {f * v.x, f * v.y, f * v.t}; }

inline Vector operator+(const Vector& a, const Vector& b) { return {a.x + b.x, a.y + b.y, a.t + b.t}; }

/// a' b
inline double dot(const Vector& a, const Vector& b) { return a.x * b.x + a.y * b.y + a.t * b.t; }

/// T v with T = blkdiag(R, 1), R the rotation.
inline Vector turned(const Rotation& r, const Vector& v) { return {r.c * v.x - r.s * v.y, r.s * v.x + r.c * v.y, v.t}; }

/// T W T' with T = blkdiag(R, 1), R the rotation.
inline Symmetric turned(const Rotation& r, const Symmetric& W) {
    const double c = r.c, s = r.s;
    return {c * c * W.xx - 2 * c * s * W.xy + s * s * W.yy,
            c * s * (W.xx - W.yy) + (c * c - s * s) * W.xy,
            s * s * W.xx + 2 * c * s * W.xy + c * c * W.yy,
            c * W.xt - s * W.yt,
            s * W.xt + c * W.yt,
            W.tt};
}

/// f v v'
inline Symmetric outer(double f, const Vector& v) {
    return {f * v.x * v.x, f * v.x * v.y, f * v.y * v.y, f * v.x * v.t, f * v.y * v.t, f * v.t * v.t};
}

inline double determinant(const Symmetric& W) {
    const double xx = W.yy * W.tt - W.yt * W.yt, xy = W.xt * W.yt - W.xy * W.tt, xt = W.xy * W.yt - W.xt * W.yy;
    return W.xx * xx + W.xy * xy + W.xt * xt;
}

/// W^-1; without a heading row (not `oriented`) the inverse of the leading 2 x 2 part, and zeros.
inline Symmetric inverse(const Symmetric& W, bool oriented) {
    if (!oriented) {
        const double f = 1 / (W.xx * W.yy - W.xy * W.xy);
        return {f * W.yy, -f * W.xy, f * W.xx, 0.0, 0.0, 0.0};
    }
    const double xx = W.yy * W.tt - W.yt * W.yt, xy = W.xt * W.yt - W.xy * W.tt, xt = W.xy * W.yt - W.xt * W.yy;
    const double f = 1 / determinant(W);
    return {f * xx,
            f * xy,
            f * (W.xx * W.tt - W.xt * W.xt),
            f * xt,
            f * (W.xy * W.xt - W.xx * W.yt),
            f * (W.xx * W.yy - W.xy * W.xy)};
}

/// L with L L' = S, by rows. Where S may be `singular`, pivots that rounding leaves below zero give columns of zeros.
struct LowerRoot {
    double xx, yx, yy, tx, ty, tt;

    explicit LowerRoot(const Symmetric& S, bool singular = false) {
        const auto root = [=](double pivot) { return std::sqrt(singular ? std::max(pivot, 0.0) : pivot); };
        const auto over = [=](double entry, double pivot) { return singular && pivot == 0.0 ? 0.0 : entry / pivot; };
        xx = root(S.xx);
        yx = over(S.xy, xx), tx = over(S.xt, xx);
        yy = root(S.yy - yx * yx);
        ty = over(S.yt - yx * tx, yy);
        tt = root(S.tt - tx * tx - ty * ty);
    }
    /// L n
    Vector operator*(const Vector& n) const { return {xx * n.x, yx * n.x + yy * n.y, tx * n.x + ty * n.y + tt * n.t}; }
    /// L^-1 d
    Vector whitened(const Vector& d) const {
        const double a = d.x / xx, b = (d.y - yx * a) / yy;
        return {a, b, (d.t - tx * a - ty * b) / tt};
    }
    double determinant() const { return xx * yy * tt; }
};

// --- sums into Omega and xi; blocks are given by rows

/// Add sign W to the part of a block that belongs to the positions, its leading 2 x 2.
inline void add_corner(double* block, double sign, const Symmetric& W) {
    block[0] += sign * W.xx;
    block[1] += sign * W.xy;
    block[3] += sign * W.xy;
    block[4] += sign * W.yy;
}

/// Add B' W B to a diagonal block, with B = +-[I, u; 0, 1]; returns the third column of W B.
inline Vector add_block(double* block, const Symmetric& W, const Lever& u) {
    const Vector a = W * Vector{u.x, u.y, 1.0};
    add_corner(block, 1.0, W);
    block[2] += a.x;
    block[5] += a.y;
    block[6] += a.x;
    block[7] += a.y;
    block[8] += u.x * a.x + u.y * a.y + a.t;
    return a;
}

/// Add sign B' g to a row of xi, with B = [I, u; 0, 1].
inline void add_gradient(double* row, double sign, const Vector& g, const Lever& u) {
    row[0] += sign * g.x;
    row[1] += sign * g.y;
    row[2] += sign * (u.x * g.x + u.y * g.y + g.t);
}

/// Add an edge between the nodes i and j: B' W B to Omega and -B' W e to xi, with g = W e, B_i = -[I, u; 0, 1] and
/// B_j = [I, v; 0, 1]. `pair` is the number of the block between i and j. All edges between two nodes have this form.
inline void add_pair(System& to, Index i, Index j, Index pair, const Symmetric& W, const Vector& g, const Lever& u,
                     const Lever& v) {
    add_gradient(to.xi + 3 * i, 1.0, g, u);
    add_gradient(to.xi + 3 * j, -1.0, g, v);
    Vector a = add_block(to.diagonal(i), W, u), b = add_block(to.diagonal(j), W, v);
    const double corner = u.x * b.x + u.y * b.y + b.t;
    // only the upper triangle is stored: the block in row j and column i is the transpose
    if (i > j) std::swap(a, b);
    double* const block = to.block(pair);
    add_corner(block, -1.0, W);
    block[2] -= b.x;
    block[5] -= b.y;
    block[6] -= a.x;
    block[7] -= a.y;
    block[8] -= corner;
}

/// As `add_pair` for two rows and a point at the second end: B_i = -[I, u] and B_j = [I, 0]. `add_pair` gives the same
/// numbers, but also adds the zeros of the point's heading.
inline void add_point(System& to, Index i, Index j, Index pair, const Symmetric& W, const Vector& g, const Lever& u) {
    add_gradient(to.xi + 3 * i, 1.0, g, u);
    to.xi[3 * j] -= g.x;
    to.xi[3 * j + 1] -= g.y;
    const Vector a = add_block(to.diagonal(i), W, u);
    add_corner(to.diagonal(j), 1.0, W);
    double* const block = to.block(pair);
    add_corner(block, -1.0, W);
    block[i < j ? 6 : 2] -= a.x;
    block[i < j ? 7 : 5] -= a.y;
}

/// Add the second derivatives of a residual that is a function of R(theta_i)' d, d = (dx, dy) from the place of node i to that of
/// node j: with g = W e in world axes, J/2 has the further terms
///
///     theta_i h' (p_j - p_i) - g' d theta_i^2 / 2,   h = (-g_y, g_x).
inline void add_turning(System& to, Index i, Index j, Index pair, const Vector& g, double dx, double dy) {
    double *const own = to.diagonal(i), *const block = to.block(pair);
    own[2] += g.y, own[6] += g.y;
    own[5] -= g.x, own[7] -= g.x;
    own[8] -= g.x * dx + g.y * dy;
    block[i < j ? 6 : 2] -= g.y;
    block[i < j ? 7 : 5] += g.x;
}

}  // namespace vmslam::edges
