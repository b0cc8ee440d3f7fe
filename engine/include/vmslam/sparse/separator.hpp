// Smallest vertex separators between two sets of nodes, by a maximum flow of paths that share no node.
#pragma once

#include <array>
#include <span>
#include <vector>

#include "vmslam/sparse/graph.hpp"

namespace vmslam::sparse {

/// Separates regions of a graph. A node v has two states, in and out (2 v and 2 v + 1), between which at most one path
/// passes, so that the most paths are as many as the fewest nodes that cut them all (Menger 1927). The flow is kept as the
/// node before and the node after each node on its path; a further path may take others back. Paths are sought depth first,
/// many in one sweep (Pothen and Fan, Computing the block triangular form of a sparse matrix, 1990), towards the other end:
/// Dinic's shortest paths took 50 to 90 sweeps for the first separator of 120,000 nodes.
class Separator {
   public:
    explicit Separator(const Neighbours& graph);

    const Neighbours& graph() const { return graph_; }

    /// The sides 0, 1 (between) and 2 of the nodes of a region; other nodes have -1.
    std::vector<signed char> side;

    /// A smallest set of `nodes`, a region, that separates those of side 0 from those of side 2; its size.
    ///
    /// Afterwards `side` is 0 and 2 of the nodes on the two sides, and 1 of the separator, which may have taken nodes of
    /// both sides. Of the smallest separators it is the one next to side 0 or the one next to side 2, whichever divides the
    /// nodes more evenly.
    Node separate(std::span<const Node> nodes);

    /// The region divided in the middle, along the axis with the narrowest cut; `side` as after `separate`. Returns the
    /// size of the separator. The axes are a's distance minus b's for two nodes far apart, the same for two nodes far from
    /// both, and their sum and difference.
    Node cut(std::span<const Node> nodes);

    /// Add the neighbours of the separator of a region to it.
    void widen(std::span<const Node> nodes);

   private:
    static constexpr Node none = -1, end = -2;  // of `before_` and `after_`: on no path; a path begins or ends here

    void measure_hops(std::span<const Node> nodes);
    std::vector<Node> ends(std::span<const Node> nodes, int source) const;
    Node sweep(std::span<const Node> ends, int source, std::vector<Node>& before, std::vector<Node>& after);
    Node next_state(std::size_t depth, int source, std::span<const Node> before, std::span<const Node> after);
    void augment(std::size_t depth, std::vector<Node>& before, std::vector<Node>& after);
    bool inside(Node v, int source) const;
    Node measure_distances(std::span<const Node> nodes, Node first, std::vector<Node>& distance);
    void rank(std::span<const Node> nodes, std::span<const Node> values, std::vector<Node>& order);
    Node narrowest(std::span<const Node> order, Node begin, Node stop);

    const Neighbours& graph_;
    std::vector<signed char> part_;
    std::vector<Node> before_, after_, hops_;
    std::vector<Node> seen_;  ///< stamp of the last sweep that visited each state
    Node stamp_ = 0;
    std::vector<Node> queue_;  ///< nodes, or the states of a path
    std::vector<Place> arc_;   ///< of each state on the path: where to go on in its list,
    std::vector<char> turn_;   ///< and which kind of step is tried
    std::array<std::vector<Node>, 4> axes_;
    std::vector<Node> ranks_, profile_;
    std::vector<Place> bins_;
};

}  // namespace vmslam::sparse
