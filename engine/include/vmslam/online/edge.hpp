// Single edges of an online solution: their values at the estimate, and when their part of the factor is out of date.
//
// Increments d of poses are in their own axes, those of points in the world's. Then the information of an edge is constant
// in the axes of its first end, and Omega stays as it is when poses move and turn together. The Jacobians there are
//
//     B_i = -[I, u; 0, 1],  u the lever, and B_j = blkdiag(R(alpha), 1), alpha = theta_j - theta_i, or -theta_i for a point.
//
// A range or a bearing alone is an edge to a point whose W is omega n n'; see edges/single_numbers.hpp. A position of the
// only end has e = R(theta)' (z - p) - a, theta_z - theta, a the point that it measures: with u = (-a_y, a_x) its Jacobian is
// B_i, and its information in these axes is that of the world turned back by theta.
//
// The factor holds every edge with the lever, alpha and robust weight of the last time at which its part of the tree was
// factorised. Its pulls -B(x)' w W e(x), w the robust weight, are those at the estimate, so that passes end at an optimum,
// whatever B is in the factor. If it is near B(x), they converge fast. `evaluate` compares them.
//
// Gauss-Newton leaves out the second derivatives of the residual. Where residuals are as large as levers, the curvature of J
// can be more than twice B' W B, and Gauss-Newton then diverges from the minimum itself. So an edge with a cost above
// `costly` has them in the factor, and all edges where the passes show that many small residuals do the same. With
// g = W e, increments (a, phi) of the first end, b of the second and q = R(alpha) b,
//
//     J/2 has the further terms  phi h' (q - a) + gamma phi^2 / 2,   h = (-g_y, g_x),  gamma = -g' d,  d = (u_y, -u_x).
//
// They may make Omega indefinite. So an edge that is indefinite by itself has gamma only, and only if that is positive,
// unless its cost is above `costly`: next to a minimum, passes converge faster with all of them.
#pragma once

#include "vmslam/online/graph.hpp"

namespace vmslam::online {

/// Which edges have their second derivatives in the factor, and whether these are left out where the edge is indefinite although
/// it is costly.
struct Bent {
    enum class Edges { none, costly, all } edges = Edges::costly;
    bool convex = false;

    static Bent never() { return {Edges::none}; }
};
inline constexpr double costly = 4.0;

/// An edge at the estimate: lever, cosine and sine of alpha (of theta for a position), robust weight w, w W e, W e, e' W e,
/// and its cost; of a number n; whether there is no second end.
struct Present {
    Lever u;
    double c, s, weight;
    Vector g, pull;
    double squares, cost;
    Lever n{};
    bool one_ended = false;
};
Present linearize(const Graph& graph, const Edge& edge);

/// What an edge pulls its ends with at the estimate, -B(x)' w W e.
struct Pulls {
    Triple ends[2];
};
Pulls pulls(const Present& now);

struct Evaluated {
    Pulls pulls;
    double change;  ///< of its cost since the last evaluation
    bool outdated;  ///< whether its part of the factor is
};
Evaluated evaluate(const Graph& graph, Edge& edge, double limit, const Bent& bent);

/// Take lever, alpha, weight and second derivatives from the estimate.
void relinearize(Graph& graph, Edge& edge, const Bent& bent);

/// Whether an edge in the factor differs from that of Gauss-Newton at the estimate.
bool differs_from_gauss_newton(const Graph& graph, const Edge& edge, double limit);

/// The parts of the edge, as it is in the factor, of Omega: the diagonal blocks of its ends, and the one between them, by
/// rows.
struct Blocks {
    Symmetric first, second;
};
Blocks diagonal_blocks(const Edge& edge);
std::array<double, 9> block_between(const Edge& edge);

}  // namespace vmslam::online
