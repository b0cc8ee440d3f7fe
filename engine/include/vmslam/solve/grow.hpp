// Initial values by growing: solve the first poses, add the next ones, solve again, until all are there.
//
// Each added pose begins where the odometry leads from the corrected pose before it, so that no error of dead reckoning
// accumulates, and each new landmark where the first pose that sees it puts it.
#pragma once

#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "vmslam/solve/objective.hpp"

namespace vmslam::solve {

/// A part of a graph: some of its nodes, and the edges between them.
class Part {
   public:
    /// The nodes, and what is held of them, are those that `used` (n) marks.
    Part(const GraphObjective& whole, std::span<const char> used);
    Part(const Part&) = delete;
    Part& operator=(const Part&) = delete;

    /// Whether all families can be divided; if not, the part is of no use.
    bool divided() const { return objective_.has_value(); }
    /// The nodes of the whole graph that are those of the part.
    const std::vector<Index>& nodes() const { return nodes_; }
    GraphObjective& objective() { return *objective_; }

   private:
    std::vector<Index> nodes_, held_nodes_, points_;
    std::vector<std::unique_ptr<const edges::Family>> families_;
    std::vector<std::vector<Index>> pairs_;
    std::optional<OwnedSystem> system_;
    std::optional<GraphObjective> objective_;
};

/// How a graph grows. Poses have the first numbers of its nodes.
struct Growth {
    Index poses;  ///< their number
    Index each;   ///< how many are added at a time, more where there are many
    std::span<const Index> parents;    ///< (n) the pose with a lower number from which a node is placed, or -1
    std::span<const double> offsets;   ///< (n, 3) the node in the axes of that pose
    std::span<const Index> from;       ///< (n) the first pose with which the node is in the graph

    /// The number of poses after some more were added to `count`.
    Index next(Index count) const;
    /// The most steps of all solutions, each counted as the part of the poses that it moves.
    double most_steps() const;
};

/// The initial values that growth from a state leads to; none where a family of edges cannot be divided.
std::optional<std::vector<double>> grow(const GraphObjective& graph, std::vector<double> state, const Growth& growth);

}  // namespace vmslam::solve
