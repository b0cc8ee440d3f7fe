// Omega and xi of a graph, into which edges add.
#pragma once

#include <span>

#include "vmslam/sparse/graph.hpp"

namespace vmslam::edges {

using sparse::Index;

/// Omega as the upper triangle of 3 x 3 blocks by columns, whose rows ascend and end with the diagonal, and xi. A view.
struct System : sparse::Pattern {
    double* values;  ///< nine numbers for each block, by rows
    double* xi;      ///< three numbers for each node
    bool curved = false;  ///< whether edges add the second derivatives of their residuals and kernels, too

    double* block(Index k) const { return values + 9 * k; }
    double* diagonal(Index node) const { return block(start[node + 1] - 1); }
    /// Let `slot_of` (n) map the rows of a column to its blocks.
    void open(Index column, std::span<Index> slot_of) const {
        for (Index p = start[column]; p < start[column + 1]; ++p) slot_of[rows[p]] = p;
    }
};

}  // namespace vmslam::edges
