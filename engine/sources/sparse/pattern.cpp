#include "vmslam/sparse/pattern.hpp"

#include <algorithm>
#include <numeric>

namespace vmslam::sparse {
namespace {

/// Counting sort, stable: where the places of each key start, and the places key by key.
struct Sorted {
    std::vector<Place> start, places;

    template <class Key>
    Sorted(Place keys, Place count, Key key) : start(keys + 1, 0), places(count) {
        for (Place k = 0; k < count; ++k) ++start[key(k) + 1];
        std::partial_sum(start.begin(), start.end(), start.begin());
        std::vector<Place> free(start.begin(), start.end() - 1);
        for (Place k = 0; k < count; ++k) places[free[key(k)]++] = k;
    }
};

}  // namespace

WidePattern pattern_of_groups(Place nodes, std::span<const Place> sizes, std::span<const Place> members) {
    // where the group of each occurrence of a node begins
    std::vector<Place> begin;
    begin.reserve(members.size());
    for (const Place size : sizes) begin.insert(begin.end(), size, static_cast<Place>(begin.size()));
    const Sorted by_node(nodes, static_cast<Place>(members.size()), [&](Place k) { return members[k]; });
    // the neighbours before each node, in any order, ...
    std::vector<Place> low, high, mark(nodes, -1);
    for (Place j = 0; j < nodes; ++j) {
        mark[j] = j;
        for (Place q = by_node.start[j]; q < by_node.start[j + 1]; ++q)
            for (Place p = begin[by_node.places[q]]; p < by_node.places[q]; ++p)
                if (const Place i = members[p]; mark[i] != j) {
                    mark[i] = j;
                    low.push_back(i);
                    high.push_back(j);
                }
    }
    // ... and a stable sort by the neighbour, then by the node, brings them into columns with increasing rows
    const auto count = static_cast<Place>(low.size());
    const Sorted by_low(nodes, count, [&](Place k) { return low[k]; });
    const Sorted by_high(nodes, count, [&](Place k) { return high[by_low.places[k]]; });
    WidePattern pattern{std::vector<Place>(nodes + 1), std::vector<Place>(count + nodes)};
    for (Place j = 0; j <= nodes; ++j) pattern.start[j] = by_high.start[j] + j;
    for (Place j = 0; j < nodes; ++j) {
        for (Place k = by_high.start[j]; k < by_high.start[j + 1]; ++k)
            pattern.rows[k + j] = low[by_low.places[by_high.places[k]]];
        pattern.rows[pattern.start[j + 1] - 1] = j;
    }
    return pattern;
}

std::vector<Place> blocks_of_nodes(std::span<const Place> start, std::span<const Place> rows, std::span<const Place> nodes) {
    std::vector<char> held(start.size() - 1, 0);
    for (const Place node : nodes) held[node] = 1;
    std::vector<Place> blocks;
    for (std::size_t j = 0; j + 1 < start.size(); ++j)
        for (Place k = start[j]; k < start[j + 1]; ++k)
            if (held[j] || held[rows[k]]) blocks.push_back(k);
    return blocks;
}

Place block_between(std::span<const Place> start, std::span<const Place> rows, Place first, Place second) {
    const auto [row, column] = std::minmax(first, second);
    const auto low = rows.begin() + start[column], high = rows.begin() + start[column + 1];
    return std::lower_bound(low, high, row) - rows.begin();
}

}  // namespace vmslam::sparse
