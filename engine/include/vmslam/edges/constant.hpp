// The form of edges that the certificate needs: information that is constant in the axes of the first node a,
//
//     e_xy = R(theta_a)' (p_b + R(theta_b) d_b - p_a) - d_a,    e_theta = wrap(theta_b - theta_a - turn).
#pragma once

#include <complex>
#include <vector>

#include "vmslam/edges/arithmetic.hpp"

namespace vmslam::edges {

/// Node -1 is the origin of the world. `oriented` edges have a heading row.
struct ConstantEdge {
    Index first, second;
    std::complex<double> d_a, d_b;
    double turn;
    bool oriented;
    Symmetric information;

    /// e' Omega e at a state.
    double squares(const double* state) const {
        constexpr double origin[3] = {0.0, 0.0, 0.0};
        const double *const a = first < 0 ? origin : state + 3 * first, *const b = state + 3 * second;
        const Vector end = turned(Rotation(b[2]), Vector{d_b.real(), d_b.imag(), 0.0});
        const Vector offset = turned(Rotation(-a[2]), Vector{b[0] + end.x - a[0], b[1] + end.y - a[1], 0.0});
        const Vector e{offset.x - d_a.real(), offset.y - d_a.imag(), oriented ? wrap(b[2] - a[2] - turn) : 0.0};
        return dot(information * e, e);
    }
};

/// Such edges, and the values of further nodes over which their cost is the minimum: the landmarks of marginal edges.
struct ConstantEdges {
    std::vector<ConstantEdge> edges;
    std::vector<Vector> landmarks;
};

}  // namespace vmslam::edges
