// Poses, landmarks and edges of a graph that grows, with the values that its solver keeps for each.
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include "vmslam/edges/arithmetic.hpp"
#include "vmslam/edges/robust.hpp"

namespace vmslam::online {

using edges::Lever;
using edges::Rotation;
using edges::Symmetric;
using edges::Vector;
using Number = std::int32_t;
using Stamp = std::int64_t;
using Triple = std::array<double, 3>;

inline constexpr double infinity = std::numeric_limits<double>::infinity();

/// A pose, or a landmark. A landmark without heading is a `point`, whose third coordinate means nothing.
struct Node {
    Triple x{};          ///< the estimate
    Triple d{};          ///< the sum of all increments, in the axes of a pose or, of a point, the world
    Triple rhs{};        ///< the right-hand side: the sum over the edges of the node
    Symmetric diagonal{};  ///< the diagonal block of Omega, without priors
    Rotation axes;       ///< of x
    Triple evaluated{};  ///< the value at which the edges of the node were evaluated last
    Triple passed{};     ///< the value that was passed down the tree last
    Triple kept{};       ///< the value before the latest step that changed it
    /// The smallest standard deviations of its edges [m, rad]. Movements are compared with these.
    double far = infinity, turned = infinity;
    Stamp mark = 0, changed = 0;  ///< the latest visit; the latest step that changed x
    Number home = 0;              ///< the supernode in which the node is eliminated; 0: none yet
    Number edges = -1, owned = -1;  ///< the first edge of the node; the first that is assembled where it is eliminated
    Number local = -1;            ///< the number within a part of the graph; -1 between the calls
    bool point = false, gone = false;  ///< gone: marginalised

    /// Put the node at a value. Headings are not wrapped, because increments add up.
    void begin(const Triple& value) {
        x = passed = evaluated = value;
        axes = Rotation(value[2]);
    }
    /// Whether a coordinate has moved away from `y` by more than `share` standard deviations.
    bool beyond(const Triple& y, double share) const {
        const double most = share * far;
        return std::abs(x[0] - y[0]) > most || std::abs(x[1] - y[1]) > most || std::abs(x[2] - y[2]) > share * turned;
    }
};

/// What the factor holds of an edge: its information with the robust weight, lever u, cosine and sine of alpha, and second
/// derivatives, those of a kernel (`bent`) in W; see edge.hpp.
struct Linear {
    Symmetric W{};
    bool bent = false;
    Lever u{};
    double c = 0.0, s = 0.0;
    double gamma = 0.0;
    Lever h{};
};

/// A relative pose (`oriented`) or a relative point: its second end measured in the axes of the first.
struct Edge {
    Vector z{};
    Symmetric omega{};
    Linear linear;
    double weight = 0.0;         ///< the robust weight in the factor; 0 before the edge is in it
    std::array<double, 6> rhs{};  ///< what the edge adds to the right-hand sides of its ends
    double cost = 0.0;           ///< at the last evaluation
    Stamp mark = 0;
    Number ends[2] = {-1, -1};   ///< -1 once the edge was taken out
    Number next[2] = {-1, -1};   ///< the next edge of either end
    Number owner = -1, next_owned = -1;  ///< the end that is eliminated first, and the next edge that this owns
    bool oriented = true, robust = false;

    int side(Number node) const { return ends[0] == node ? 0 : 1; }
    bool taken_out() const { return ends[0] < 0; }
};

/// An edge of a step. `motion` leads to a new pose, `sighting` to a landmark.
enum class Kind { motion, sighting, relation };
struct NewEdge {
    Number first, second;
    Kind kind;
    bool oriented;
    Vector z;
    Symmetric omega;
};

struct Graph {
    std::vector<Node> nodes;
    std::vector<Edge> edges;
    edges::Kernel kernel;  ///< of sightings
    double gain = 1.0;     ///< what turns the weight of a sighting into its information; 1 without a kernel

    Number size() const { return static_cast<Number>(nodes.size()); }

    /// Add edges. Nodes from number `known` on are new, and placed by their first edge. Returns the nodes of the edges, each
    /// once.
    std::vector<Number> append(std::span<const NewEdge> added, Number known);
    /// Take the edges from number `first` on out, which were added last.
    void detach(Number first);
    /// Take an edge out of the list of one of its ends.
    void unlink(Number edge, Number node);

    std::vector<Number> edges_of(Number node) const;
    std::vector<Number> live_nodes() const, live_edges() const;
};

}  // namespace vmslam::online
