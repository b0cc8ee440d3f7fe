#include "vmslam/sparse/pattern.hpp"

#include <algorithm>

namespace vmslam::sparse {

OwnedPattern pattern_of_groups(Index nodes, std::span<const Index> sizes, std::span<const Index> members) {
    // where the group of each occurrence of a node begins
    std::vector<Index> begin;
    begin.reserve(members.size());
    for (const Index size : sizes) begin.insert(begin.end(), size, static_cast<Index>(begin.size()));
    const Sorted by_node(nodes, static_cast<Index>(members.size()), [&](Index k) { return members[k]; });
    OwnedPattern pattern{{0}, {}};
    pattern.start.reserve(nodes + 1);
    pattern.rows.reserve(nodes + members.size());
    std::vector<Index> mark(nodes, -1);
    for (Index j = 0; j < nodes; ++j) {
        mark[j] = j;
        // the neighbours before each node, and the node itself
        for (Index q = by_node.start[j]; q < by_node.start[j + 1]; ++q)
            for (Index p = begin[by_node.places[q]]; p < by_node.places[q]; ++p)
                if (const Index i = members[p]; mark[i] != j) {
                    mark[i] = j;
                    pattern.rows.push_back(i);
                }
        std::sort(pattern.rows.begin() + pattern.start.back(), pattern.rows.end());
        pattern.rows.push_back(j);
        pattern.start.push_back(static_cast<Index>(pattern.rows.size()));
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
