// Poses, landmarks and edges of a graph that grows, with the values that its solver keeps for each.
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include "vmslam/edges/arithmetic.hpp"
#include "vmslam/edges/robust.hpp"
#include "vmslam/edges/single_numbers.hpp"

namespace vmslam::online {

using edges::Lever;
using edges::Rotation;
using edges::Symmetric;
using edges::Vector;
using Id = std::int32_t;
using Stamp = std::int64_t;
using Triple = std::array<double, 3>;

inline constexpr double infinity = std::numeric_limits<double>::infinity();

/// What is known of a node without the tree.
struct NodeValue {
    Triple x{};  ///< the estimate
    /// The smallest standard deviations of its edges [m, rad], with which changes of Jacobians are weighed. A new pose has
    /// those of the pose before it until its first sighting.
    double place_std = infinity, heading_std = infinity;
    Id edges = -1;  ///< the first edge of the node
    bool point = false, gone = false;  ///< gone: marginalised
    bool held = false;  ///< a pose with a prior of its own
    bool borrows = false;  ///< whether both deviations are those of the pose before, which a first sighting replaces
};

/// A pose, or a landmark. A landmark without heading is a `point`, whose third coordinate means nothing.
struct Node : NodeValue {
    Triple base{};  ///< the value at which its supernode was evaluated last
    Rotation axes, base_axes;  ///< of x and of the base
    Triple kept{};  ///< the value before the latest step that changed it
    Triple diagonal{};  ///< the diagonal of Omega, without priors
    Stamp changed = 0;  ///< the latest step that changed x
    Id home = 0;  ///< the supernode in which the node is eliminated; 0: none yet
    Id owned = -1;  ///< the first edge that is assembled where the node is eliminated
    Id local = -1;  ///< the number within a part of the graph; -1 between the calls

    /// The numbers that the node has in the equations.
    Id size() const { return point ? 2 : 3; }

    /// Remember the value from before a step.
    void keep(Stamp step) {
        if (changed != step) changed = step, kept = x;
    }

    /// Put the node at a value. Headings are not wrapped, because increments add up.
    void begin(const Triple& value) {
        x = base = value;
        axes = base_axes = Rotation(value[2]);
    }
};

/// What the factor holds of an edge: its information with the robust weight, lever u, cosine and sine of alpha, and second
/// derivatives, those of a kernel (`bent`) in W; of a single number its derivative n. See edge.hpp.
struct Linear {
    Symmetric W{};
    bool bent = false;
    Lever u{}, n{};
    double c = 0.0, s = 0.0;
    double gamma = 0.0;
    Lever h{};
};

/// What an edge measures: the second end in the axes of the first, where `motion` leads to a new pose and `sighting` to a
/// landmark; the range or the bearing of the second end alone; or a point of its only node in the world.
enum class Kind : std::int8_t { motion, sighting, relation, range, bearing, position };

/// An edge of a step. A single number stands in z.x and omega.xx, and its ends are known. A position has its node at both
/// ends.
struct NewEdge {
    Id ends[2];  ///< -1 once the edge was taken out
    Kind kind;
    bool oriented;  ///< whether a heading is measured, too
    Vector z;
    Symmetric omega;
    Lever lever{};  ///< where the sensor of a number is on the robot, or the point that a position measures
    bool robust = false;  ///< whether the robust kernel acts on it; it acts on all that is seen
    Id next[2] = {-1, -1};  ///< the next edge of either end in the graph
};

struct Edge : NewEdge {
    Linear linear;
    double weight = 0.0;  ///< the robust weight in the factor; 0 before the edge is in it
    double cost = 0.0, squares = 0.0;  ///< at the last evaluation: the cost, and e' W e
    Id owner = -1, next_owned = -1;  ///< the end that is eliminated first, and the next edge that this owns
    Id place = 0;  ///< where the numbers of the other end begin in the front of the owner

    int side(Id node) const { return ends[0] == node ? 0 : 1; }
    bool relative() const { return kind < Kind::range; }
    bool one_ended() const { return kind == Kind::position; }
    bool single_number() const { return kind == Kind::range || kind == Kind::bearing; }
    bool seen() const { return kind == Kind::sighting || single_number(); }
    int rows() const { return single_number() ? 1 : oriented ? 3 : 2; }
    bool taken_out() const { return ends[0] < 0; }
};

struct Graph {
    std::vector<Node> nodes;
    std::vector<Edge> edges;
    /// By the number of rows of an edge, less 1: the robust kernel, and what turns weights into information, 1 without a
    /// kernel.
    std::array<edges::Kernel, 3> kernels{};
    std::array<double, 3> gains{1.0, 1.0, 1.0};
    bool has_single_numbers = false;  ///< whether there have been single numbers, whose cost has many minima

    Id size() const { return static_cast<Id>(nodes.size()); }
    const edges::Kernel& kernel_of(const Edge& edge) const { return kernels[edge.rows() - 1]; }
    double gain_of(const Edge& edge) const { return gains[edge.rows() - 1]; }

    /// Add edges. Nodes from number `known` on are new, and placed by their first edge, but for those of single numbers.
    /// Returns the nodes of the edges, each once.
    std::vector<Id> append(std::span<const NewEdge> added, Id known);
    /// Take the edges from number `first` on out, which were added last.
    void detach(Id first);
    /// Take an edge out of the list of one of its ends.
    void unlink(Id edge, Id node);

    std::vector<Triple> values(std::span<const Id> of) const;
    std::vector<Id> edges_of(Id node) const;
    std::vector<Id> live_nodes() const, live_edges() const;
};

/// use(number, edge, side of the node) for the edges that are assembled where a node is eliminated.
template <class Use>
void each_owned(auto& graph, Id node, const Use& use) {
    for (Id e = graph.nodes[node].owned; e >= 0; e = graph.edges[e].next_owned)
        if (auto& edge = graph.edges[e]; !edge.taken_out()) use(e, edge, edge.side(node));
}

}  // namespace vmslam::online
