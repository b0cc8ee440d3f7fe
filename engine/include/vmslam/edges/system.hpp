// Omega and xi of a graph, into which edges add.
#pragma once

#include <span>
#include <vector>

#include "vmslam/sparse/graph.hpp"

namespace vmslam::edges {

using sparse::Index;

/// Omega as the upper triangle of 3 x 3 blocks by columns, whose rows ascend and end with the diagonal, and xi. A view.
struct System {
    std::span<const Index> start;  ///< (n + 1) the first block of each column
    std::span<const Index> rows;   ///< the row of each block
    double* values;                ///< nine numbers for each block, by rows
    double* xi;                    ///< three numbers for each node
    Index* slot_of;                ///< (n) room to map the rows of one column to blocks

    double* block(Index k) const { return values + 9 * k; }
    double* diagonal(Index node) const { return block(start[node + 1] - 1); }
    /// Let `slot_of` map the rows of a column to its blocks.
    void open(Index column) const {
        for (Index p = start[column]; p < start[column + 1]; ++p) slot_of[rows[p]] = p;
    }
};

}  // namespace vmslam::edges
