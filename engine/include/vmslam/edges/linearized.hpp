// Edges given by their linearization, between two nodes each, that also depend on parameters of the whole graph.
//
// With the residual e, the Jacobians A and B by its two nodes and P by the parameters, and the information W, an edge adds
// (A, B, P)' W (A, B, P) to the normal equations and -(A, B, P)' W e to their right-hand side. The parameters border Omega:
//
//     [ Omega  mixed ] [ nodes      ]   [ xi       ]
//     [ mixed' own   ] [ parameters ] = [ gradient ]
#pragma once

#include "vmslam/edges/system.hpp"

namespace vmslam::edges {

/// `rows` numbers in each residual, 2 or 3, and `parameters` columns of P; all matrices by rows, one edge after another. The
/// two nodes of an edge differ, and W is symmetric.
struct Linearized {
    std::span<const Index> first, second, pairs;
    std::size_t rows, parameters;
    const double *e, *A, *B, *P, *W;
};

/// The parts of the normal equations that belong to the parameters: mixed (n, 3, K), own (K, K), and gradient (K), their
/// right-hand side.
struct Border {
    double *mixed, *own, *gradient;
};

/// Add the edges to the system and its border.
void add(const Linearized& edges, System& system, const Border& border);

}  // namespace vmslam::edges
