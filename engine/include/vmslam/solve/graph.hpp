// A graph that owns its edges, its linear system and the factor, for programs without Python.
#pragma once

#include <deque>
#include <memory>
#include <optional>

#include "vmslam/certificate/proof.hpp"
#include "vmslam/edges/relative.hpp"
#include "vmslam/log.hpp"
#include "vmslam/solve/objective.hpp"
#include "vmslam/solve/run.hpp"
#include "vmslam/solve/start.hpp"

namespace vmslam::solve {

/// Nodes 0 to n - 1 and edges between them. A graph without absolute measurements needs an anchor, which holds it in the world.
/// Every node that an edge or an anchor names must be one of the n, and every state must have 3 n numbers; other ones throw
/// std::invalid_argument. `points` are nodes without a heading.
class Graph {
   public:
    explicit Graph(Index nodes, std::vector<Index> points = {});

    /// Hold a node near a value: the gauge of a graph without a map.
    void add_anchor(Index node, const edges::Vector& value, double information = 1e6);
    /// Measured relative poses, such as motions and loop closures, or, unless `oriented`, relative points.
    void add_relative(std::vector<edges::RelativeEdge> edges, const edges::Kernel& kernel = {}, bool oriented = true);
    /// Edges of a family that lists them, each between two different nodes; none for a family of single nodes.
    void add_pairs(std::unique_ptr<const edges::Family> family, std::vector<Index> first = {},
                   std::vector<Index> second = {});
    /// Edges of any family that tie groups of nodes: those of group g are nodes[starts[g]] to nodes[starts[g + 1] - 1], not
    /// decreasing.
    void add_groups(std::unique_ptr<const edges::Family> family, std::span<const Index> starts, std::span<const Index> nodes);

    /// The families have information that depends on the state, or a robust kernel; see `Objective`.
    bool state_dependent = false, reweighted = false;

    /// Initial values by rotation first, or why there are none: the anchored nodes at their values, the others from the edges.
    Start rotation_first(int threads = 1) const;
    /// Minimise J from run.state by `gauss_newton`.
    void solve(Run& run, int threads = 1) const;
    /// J of a state, a lower bound on J of all states, and whether the state is a global minimum. With a kernel all of these are
    /// about the cost with its weights held at those of the state: necessary for a global minimum of J, and not sufficient.
    /// None where an edge has no constant information, or none that is positive semidefinite, or J is not finite.
    std::optional<certificate::Bound> lower_bound(std::span<const double> state) const;
    /// What each call of `add_` contributes to J at a state.
    std::vector<double> costs(std::span<const double> state) const;
    /// The blocks (n, 3, 3) of Omega^-1 on the diagonal at a state; none where Omega has no factor.
    std::vector<double> covariances(std::span<const double> state) const;

    /// The graph with its linear system, as the functions of `grow.hpp` and `restarts.hpp` take it. The graph must live as long.
    struct Assembled {
        OwnedSystem system;
        std::deque<std::vector<Index>> pairs;
        std::optional<GraphObjective> objective;

        explicit Assembled(const Graph& graph, int threads = 1);
    };

   private:
    void check_node(Index node) const;
    void check_state(std::span<const double> state) const;

    struct Member {
        std::unique_ptr<const edges::Family> family;
        std::vector<Index> first, second;  ///< the ends of pairs, for the families that list their edges
    };
    Index nodes_;
    std::vector<Index> points_;
    std::vector<Member> members_;
    std::vector<std::pair<Index, edges::Vector>> anchors_;
    /// the groups of nodes of all families, one after another
    std::vector<Index> sizes_, grouped_;
};

/// The sightings of a log by increasing landmark and step, as the families of `edges/` take them.
edges::ByLandmark by_landmark(const Log& log, const edges::Sensor& sensor, const edges::Kernel& kernel);

/// Which edges the graph of a log has.
struct LogEdges {
    bool motions = true;
    bool body = true;  ///< whether information turns with the poses, and is not that at the reference
    bool one_by_one = false;  ///< whether every edge is added by a call of its own, so that `costs` tells them apart
    /// Virtual-motion edges in place of marginal ones: groups of sightings of a landmark, by their numbers and by increasing
    /// step, any two of which make an edge.
    std::optional<std::vector<std::vector<std::size_t>>> virtual_motions;
};

/// The graph of a log: an anchor on its first pose, a motion edge for each control, and the sightings of each landmark as one
/// marginal edge (`edges/marginal.hpp`), these with a robust kernel.
Graph graph_of(const Log& log, const MotionNoise& noise = {}, const edges::Sensor& sensor = book_sensor,
               const edges::Kernel& kernel = {}, const LogEdges& chosen = {});

}  // namespace vmslam::solve
