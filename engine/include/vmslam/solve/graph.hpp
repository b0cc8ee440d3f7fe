// A graph that owns its edges, its linear system and the factor, for programs without Python.
#pragma once

#include <memory>
#include <optional>

#include "vmslam/certificate/proof.hpp"
#include "vmslam/edges/relative.hpp"
#include "vmslam/log.hpp"
#include "vmslam/solve/restarts.hpp"
#include "vmslam/solve/run.hpp"
#include "vmslam/solve/start.hpp"

namespace vmslam::solve {

/// Nodes 0 to n - 1 and edges between them. A graph without absolute measurements needs an anchor, which holds it in the world.
/// Every node that an edge or an anchor names must be one of the n, and every state must have 3 n numbers; other ones throw
/// std::invalid_argument.
class Graph {
   public:
    explicit Graph(Index nodes);

    /// Hold a node near a value: the gauge of a graph without a map.
    void add_anchor(Index node, const edges::Vector& value, double information = 1e6);
    /// Measured relative poses, such as motions and loop closures.
    void add_relative(std::vector<edges::RelativeEdge> edges, const edges::Kernel& kernel = {});
    /// Edges of any family that tie groups of nodes: those of group g are nodes[starts[g]] to nodes[starts[g + 1] - 1], not
    /// decreasing.
    void add_groups(std::unique_ptr<const edges::Family> family, std::span<const Index> starts, std::span<const Index> nodes);

    /// The families have information that depends on the state, or a robust kernel; see `Objective`.
    bool state_dependent = false, reweighted = false;

    /// Initial values by rotation first, or why there are none: the anchored nodes at their values, the others from the edges.
    Start rotation_first(int threads = 1) const;
    /// Initial values by growth from the anchors along the odometry, `each` nodes at a time: that is the first relative edge from
    /// each node to the next. None where one of these is missing, or the edges of a family cannot be divided.
    std::optional<std::vector<double>> grown(Index each = 10, int threads = 1) const;
    /// Minimise J from run.state by `gauss_newton`.
    void solve(Run& run, int threads = 1) const;
    /// The end that other turns of the robot, and then random halves of the measurements that may be wrong, lead to from an end of
    /// `solve`, where it is lower; it takes at most `limit` steps and those of one restart more. Measurements of
    /// `add_groups`, and those with a kernel, may be wrong.
    Lowered lowered_by_restarts(std::span<const double> state, double limit = 1e4, int threads = 1) const;
    /// J of a state, a lower bound on J of all states, and whether the state is a global minimum. With a kernel all of these are
    /// about the cost with its weights held at those of the state: necessary for a global minimum of J, and not sufficient.
    /// None where an edge has no constant information, or none that is positive semidefinite, or J is not finite.
    std::optional<certificate::Bound> lower_bound(std::span<const double> state) const;
    /// What each call of `add_` contributes to J at a state.
    std::vector<double> costs(std::span<const double> state) const;
    /// The blocks (n, 3, 3) of Omega^-1 on the diagonal at a state; none where Omega has no factor.
    std::vector<double> covariances(std::span<const double> state) const;

   private:
    /// The anchored nodes at their values, the others at zero.
    std::vector<double> anchored() const;
    void check_node(Index node) const;
    void check_state(std::span<const double> state) const;

    /// The linear system of the graph.
    struct Assembled;

    struct Member {
        std::unique_ptr<const edges::Family> family;
        std::vector<Index> first, second;  ///< the ends of pairs, for the families that list their edges
        bool doubted = false;  ///< whether its measurements may be wrong
    };
    Index nodes_;
    std::vector<Member> members_;
    std::vector<std::pair<Index, edges::Vector>> anchors_;
    std::vector<double> motions_, variances_;  ///< the odometry; the variance of a turn is NaN where there is none
    /// the groups of nodes of all families, one after another
    std::vector<Index> sizes_, grouped_;
};

/// The sightings of a log by increasing landmark and step, as the families of `edges/` take them.
edges::ByLandmark by_landmark(const Log& log, const edges::Sensor& sensor, const edges::Kernel& kernel);

/// The graph of a log: an anchor on its first pose, a motion edge for each control, and the sightings of each landmark as one
/// marginal edge (`edges/marginal.hpp`) with a robust kernel, all in the body frame.
Graph graph_of(const Log& log, const MotionNoise& noise = {}, const edges::Sensor& sensor = book_sensor,
               const edges::Kernel& kernel = {});

}  // namespace vmslam::solve
