// The pattern of an information matrix from the groups of nodes that its edges tie, and the places of blocks in it.
#pragma once

#include <array>
#include <span>
#include <vector>

#include "vmslam/sparse/graph.hpp"

namespace vmslam::sparse {

/// A pattern with rows in the type that NumPy indexes with.
struct WidePattern {
    std::vector<Place> start, rows;
};

/// The upper triangle by columns for groups of given sizes, whose nodes follow each other, not decreasing in each group.
WidePattern pattern_of_groups(Place nodes, std::span<const Place> sizes, std::span<const Place> members);

/// The numbers of all blocks in the rows and columns of some nodes.
std::vector<Place> blocks_of_nodes(std::span<const Place> start, std::span<const Place> rows, std::span<const Place> nodes);

/// The number of the upper block between two nodes.
Place block_between(std::span<const Place> start, std::span<const Place> rows, Place first, Place second);

}  // namespace vmslam::sparse
