// The pattern of an information matrix from the groups of nodes that its edges tie, and the places of blocks in it.
#pragma once

#include <numeric>
#include <span>
#include <vector>

#include "vmslam/sparse/graph.hpp"

namespace vmslam::sparse {

/// Counting sort, stable: where the places of each key start, and the places key by key.
struct Sorted {
    std::vector<Index> start, places;

    Sorted() = default;
    template <class Key>
    Sorted(Index keys, Index count, Key key) : start(keys + 1, 0), places(count) {
        for (Index k = 0; k < count; ++k) ++start[key(k) + 1];
        std::partial_sum(start.begin(), start.end(), start.begin());
        std::vector<Index> free(start.begin(), start.end() - 1);
        for (Index k = 0; k < count; ++k) places[free[key(k)]++] = k;
    }
};

/// A pattern that owns its arrays.
struct OwnedPattern {
    std::vector<Index> start, rows;

    operator Pattern() const { return {start, rows}; }
};

/// The upper triangle by columns for groups of given sizes, whose nodes follow each other, not decreasing in each group.
OwnedPattern pattern_of_groups(Index nodes, std::span<const Index> sizes, std::span<const Index> members);

/// The numbers of all blocks in the rows and columns of some nodes.
std::vector<Index> blocks_of_nodes(const Pattern& pattern, std::span<const Index> nodes);

/// The number of the upper block between two nodes, or -1 where the pattern has none.
Index block_or_none(const Pattern& pattern, Index first, Index second);
/// The same for a pair that the pattern has.
Index block_between(const Pattern& pattern, Index first, Index second);

}  // namespace vmslam::sparse
