// The steps of a proof around the factorisation of S: which nodes are held, and what rounding may take from S.
#pragma once

#include <complex>
#include <span>
#include <vector>

#include "vmslam/sparse/graph.hpp"

namespace vmslam::certificate {

using sparse::Node;
using sparse::Place;

/// The upper triangles of `count` matrices (d, d) into rows of six; false where one is not symmetric, but for rounding.
bool take_upper(std::span<const double> matrices, Place count, int d, double tolerance, std::span<double> rows);

/// Hold one node of every piece that nothing ties to the world: the cost does not change when such a piece moves. Edges
/// with the first node -1 come from the world. Returns the number of edges at each node.
std::vector<Place> hold_roots(std::span<const Place> first, std::span<const Place> second, std::span<bool> free);

/// What S may be less than assembled, and its least margin above L L^H, (N, 2) each; a node that is not free has 1.
/// `rounding` belongs to the rows in the order of elimination, `shifts` are added to the diagonal for headings.
struct Margins {
    std::vector<double> assembled, margin;
};
Margins margins(std::span<const double> scale, std::span<const double> shifts, std::span<const double> summation,
                std::span<const double> rounding, std::span<const Node> order);

/// S with its diagonal shifted, and lowered by `assembled` and twice the margin; 1 where a node is not free.
std::vector<std::complex<double>> changed(std::span<const std::complex<double>> values, std::span<const Place> column_start,
                                          std::span<const double> scale, std::span<const double> shifts,
                                          std::span<const double> assembled, std::span<const double> margin);

}  // namespace vmslam::certificate
