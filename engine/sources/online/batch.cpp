// The batch solution of an online system, for steps from which undamped passes do not converge.
#include <algorithm>

#include "vmslam/edges/single_numbers.hpp"
#include "vmslam/online/system.hpp"
#include "vmslam/solve/graph.hpp"

namespace vmslam::online {
namespace {

using sparse::Index;

/// The nodes and edges of an online system as a graph for the batch solver, and the state where they are.
struct BatchProblem {
    std::vector<Id> nodes, number;
    std::vector<double> state;
    std::optional<solve::Graph> graph;

    BatchProblem(const Graph& online, std::span<const Prior> priors)
        : nodes(online.live_nodes()), number(online.nodes.size(), -1) {
        std::vector<Index> points;
        for (std::size_t k = 0; k < nodes.size(); ++k) {
            const Node& node = online.nodes[nodes[k]];
            number[nodes[k]] = static_cast<Id>(k);
            state.insert(state.end(), node.x.begin(), node.x.end());
            if (node.point) points.push_back(static_cast<Index>(k));
        }
        graph.emplace(static_cast<Index>(nodes.size()), std::move(points));
        for (const bool oriented : {true, false})
            for (const bool robust : {true, false}) add_edges(online, oriented, robust);
        add_numbers(online, Kind::range, edges::Number::range);
        add_numbers(online, Kind::bearing, edges::Number::bearing);
        for (const Prior& prior : priors) {
            std::vector<Index> members;
            for (const Id node : prior.members) members.push_back(number[node]);
            std::ranges::sort(members);
            const Index starts[] = {0, static_cast<Index>(members.size())};
            graph->add_groups(std::make_unique<PriorFamily>(prior, online, number), starts, members);
        }
        graph->reweighted = std::ranges::any_of(online.edges, &Edge::robust);
    }

   private:
    /// Relative poses or points, and positions.
    void add_edges(const Graph& online, bool oriented, bool robust) {
        std::vector<edges::RelativeEdge> relative;
        std::vector<edges::Position> positions;
        const edges::Kernel kernel = robust ? online.kernels[oriented ? 2 : 1] : edges::Kernel{};
        for (const Edge& edge : online.edges) {
            if (edge.taken_out() || edge.single_number() || edge.oriented != oriented || edge.robust != robust) continue;
            const Index i = number[edge.ends[0]], j = number[edge.ends[1]];
            if (edge.one_ended())
                positions.push_back({i, edge.z, edge.omega, edge.lever});
            else
                relative.push_back({i, j, edge.z, edge.omega});
        }
        if (!relative.empty()) graph->add_relative(std::move(relative), kernel, oriented);
        if (!positions.empty()) graph->add_pairs(std::make_unique<edges::PositionEdges>(std::move(positions), kernel));
    }

    void add_numbers(const Graph& online, Kind measured, edges::Number kind) {
        std::vector<edges::NumberEdge> found;
        std::vector<Index> first, second;
        for (const Edge& edge : online.edges) {
            if (edge.taken_out() || edge.kind != measured) continue;
            first.push_back(number[edge.ends[0]]);
            second.push_back(number[edge.ends[1]]);
            found.push_back({first.back(), second.back(), edge.z.x, edge.omega.xx, edge.lever});
        }
        // all of them are sightings
        if (!found.empty())
            graph->add_pairs(std::make_unique<edges::NumberEdges>(kind, std::move(found), online.kernels[0]),
                             std::move(first), std::move(second));
    }
};

/// A state of lower cost by Gauss-Newton, damped where necessary, or nothing.
std::vector<double> lower_state(const BatchProblem& problem, bool damped_only) {
    solve::Graph::Assembled assembled(*problem.graph);
    solve::GraphObjective& objective = *assembled.objective;
    const double cost = objective.cost(problem.state, problem.state);
    solve::Run run;
    const auto lowers = [&](const auto& iterate) {
        run = {};
        run.rules = {.tolerance = 1e-9, .cost_tolerance = 1e-9};
        run.state = problem.state;
        iterate();
        return run.end != solve::End::not_determined && run.end != solve::End::diverged &&
               objective.cost(run.state, run.state) <= cost;
    };
    // plain steps from far away may end in a much higher minimum, and damped ones do not
    if (!damped_only && lowers([&] { solve::gauss_newton(objective, run); })) return run.state;
    if (lowers([&] { solve::levenberg_marquardt(objective, run, run.rules.most_steps); })) return run.state;
    return {};
}

}  // namespace

/// Put all nodes at these values and linearise their edges there, in the tree that there is.
bool OnlineSystem::move_to(std::span<const Triple> x) {
    for (const Id k : graph_.live_nodes()) {
        Node& node = graph_.nodes[k];
        node.keep(tree_.step);
        node.x = x[k];
        node.axes = Rotation(x[k][2]);
    }
    return factorize_all();
}

// The correction is too large for undamped passes: the step is undone, the batch solver solves the graph, and the edges are
// linearised where that has ended.
bool OnlineSystem::solve_as_batch(std::span<const Id> newest) {
    ++batch_solutions;
    for (Node& node : graph_.nodes)
        if (node.changed == tree_.step) node.x = node.kept, node.axes = Rotation(node.kept[2]);
    const BatchProblem problem(graph_, priors_);
    const std::vector<double> found = lower_state(problem, graph_.has_single_numbers);
    std::vector<Triple> start = places();
    for (std::size_t k = 0; k < found.size() / 3; ++k) std::copy_n(found.begin() + 3 * k, 3, start[problem.nodes[k]].begin());
    // where passes have failed, second derivatives of all edges did not help
    memory_.bent.edges = usual_bent().edges;
    if ((move_to(start) || begin_at(start, newest)) && descends(newest)) return true;
    begin_at(start, newest);
    return false;
}

}  // namespace vmslam::online
