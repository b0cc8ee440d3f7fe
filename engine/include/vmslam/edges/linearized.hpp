// Edges given by their linearization, between two nodes each, that also depend on parameters of the whole graph.
//
// With the residual e, the Jacobians A and B by the nodes and J by the parameters, and the information W, an edge adds
// (A, B, J)' W (A, B, J) to the normal equations and -(A, B, J)' W e to their right-hand side. The parameters border Omega:
//
//     [ Omega  mixed ] [ nodes      ]   [ xi       ]
//     [ mixed' own   ] [ parameters ] = [ gradient ]
#pragma once

#include "vmslam/edges/system.hpp"

namespace vmslam::edges {

/// `rows` numbers in each residual, and `parameters` columns of J; all matrices by rows, one edge after another.
struct Linearized {
    std::span<const Place> first, second, pairs;
    std::size_t rows, parameters;
    const double *e, *A, *B, *J, *W;
};

/// What the parameters add to the normal equations: mixed (n, 3, K), own (K, K) and gradient (K).
struct Border {
    double *mixed, *own, *gradient;
};

void add(const Linearized& edges, System& system, const Border& border);

}  // namespace vmslam::edges
