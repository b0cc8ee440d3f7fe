// Orders of elimination that keep the factor sparse.
#pragma once

#include <span>
#include <vector>

#include "vmslam/sparse/graph.hpp"

namespace vmslam::sparse {

/// Approximate minimum degree (Amestoy, Davis and Duff 1996); nodes with more than `limit` neighbours go last.
Order minimum_degree(const Pattern& pattern, Node limit);

/// Minimum degree of a graph in which groups of given sizes are tied together; their members follow each other.
Order minimum_degree(Node nodes, std::span<const Index> sizes, std::span<const Index> members);

/// Nested dissection, each part ordered by minimum degree; nodes with more than `limit` neighbours go last.
Order nested_dissection(const Pattern& pattern, Node limit);

/// The number of neighbours up to which a node is ordered by its degree: max(16, dense sqrt(n)); all for dense < 0.
Node degree_limit(Node nodes, double dense);

/// Dissection is tried from so many nodes on, where the factorisation takes more than so many flops for each block of the
/// matrix. Dissection and the order inside the parts take 0.3 us for each block. They save a third of the flops where maps
/// grow in both directions, in each of about five factorisations at 50 Gflop/s.
struct DissectionWorth {
    Node smallest = 5'000;
    double flops = 10'000.0;
};

/// Minimum degree, or nested dissection where that is tried and the factorisation then takes fewer flops.
Order fill_reducing(const Pattern& pattern, const DissectionWorth& worth = {});

/// The flops of the factorisation with blocks of 3 x 3 in an order, multiply and add counted apart.
double flops_of(const Pattern& pattern, std::span<const Node> order);

// --- the steps of which these are made

/// What is left after eliminating the nodes of degree two and less: they come first, in the order `head`.
struct Reduced {
    Order head;
    std::vector<Node> nodes;  ///< those that are left, by their number in `rest`
    Neighbours rest;
};
Reduced without_low_degrees(const Pattern& pattern);

/// Minimum degree among the nodes of one `stage` (n) after the other, from the lowest stage on; empty: all nodes are in one.
Order minimum_degree(const Neighbours& graph, Node limit, std::span<const Node> stage);

/// The depth of the separator that each node belongs to, 0 for the first; -1 for nodes in no separator.
std::vector<Node> separator_depths(const Neighbours& graph, Node limit);

/// A smallest set of nodes that separates those of side 0 from those of side 2 in the region of the nodes whose side is not
/// negative; its size. Afterwards these have the side 1.
Node separate(const Neighbours& graph, std::span<signed char> side);

}  // namespace vmslam::sparse
