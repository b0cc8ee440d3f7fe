#include "vmslam/sparse/pattern.hpp"

#include <algorithm>

namespace vmslam::sparse {

OwnedPattern pattern_of_groups(Index nodes, std::span<const Index> sizes, std::span<const Index> members) {
    // where the group of each occurrence of a node begins
    std::vector<Index> begin;
    begin.reserve(members.size());
    for (const Index size : sizes) begin.insert(begin.end(), size, static_cast<Index>(begin.size()));
    const Sorted by_node(nodes, static_cast<Index>(members.size()), [&](Index k) { return members[k]; });
    // the neighbours before each node, in any order, ...
    std::vector<Index> low, high, mark(nodes, -1);
    for (Index j = 0; j < nodes; ++j) {
        mark[j] = j;
        for (Index q = by_node.start[j]; q < by_node.start[j + 1]; ++q)
            for (Index p = begin[by_node.places[q]]; p < by_node.places[q]; ++p)
                if (const Index i = members[p]; mark[i] != j) {
                    mark[i] = j;
                    low.push_back(i);
                    high.push_back(j);
                }
    }
    // ... and a stable sort by the neighbour, then by the node, brings them into columns with increasing rows
    const auto count = static_cast<Index>(low.size());
    const Sorted by_low(nodes, count, [&](Index k) { return low[k]; });
    const Sorted by_high(nodes, count, [&](Index k) { return high[by_low.places[k]]; });
    OwnedPattern pattern{std::vector<Index>(nodes + 1), std::vector<Index>(count + nodes)};
    for (Index j = 0; j <= nodes; ++j) pattern.start[j] = by_high.start[j] + j;
    for (Index j = 0; j < nodes; ++j) {
        for (Index k = by_high.start[j]; k < by_high.start[j + 1]; ++k)
            pattern.rows[k + j] = low[by_low.places[by_high.places[k]]];
        pattern.rows[pattern.start[j + 1] - 1] = j;
    }
    return pattern;
}

std::vector<Index> blocks_of_nodes(const Pattern& pattern, std::span<const Index> nodes) {
    std::vector<char> held(pattern.size(), 0);
    for (const Index node : nodes) held[node] = 1;
    std::vector<Index> blocks;
    for (Node j = 0; j < pattern.size(); ++j)
        for (Index k = pattern.start[j]; k < pattern.start[j + 1]; ++k)
            if (held[j] || held[pattern.rows[k]]) blocks.push_back(k);
    return blocks;
}

Index block_between(const Pattern& pattern, Index first, Index second) {
    const auto [row, column] = std::minmax(first, second);
    const auto rows = pattern.rows.begin(), low = rows + pattern.start[column], high = rows + pattern.start[column + 1];
    return std::lower_bound(low, high, row) - rows;
}

Index block_or_none(const Pattern& pattern, Index first, Index second) {
    const auto [row, column] = std::minmax(first, second);
    if (row < 0 || column >= pattern.size()) return -1;
    const Index block = block_between(pattern, first, second);
    return block < pattern.start[column + 1] && pattern.rows[block] == row ? block : -1;
}

}  // namespace vmslam::sparse
