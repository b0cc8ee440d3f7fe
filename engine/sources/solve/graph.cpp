#include "vmslam/solve/graph.hpp"

#include <algorithm>
#include <map>
#include <utility>

#include "require.hpp"
#include "vmslam/edges/marginal.hpp"
#include "vmslam/edges/virtual_motion.hpp"

namespace vmslam::solve {

Graph::Graph(Index nodes, std::vector<Index> points) : nodes_(nodes), points_(std::move(points)) {
    require(nodes > 0, "a graph needs at least one node");
    for (const Index node : points_) check_node(node);
}

void Graph::check_node(Index node) const {
    require(node >= 0 && node < nodes_, "an edge, an anchor or the list of points names a node that the graph lacks");
}

void Graph::check_state(std::span<const double> state) const {
    require(state.size() == 3 * static_cast<std::size_t>(nodes_),
            "a state must have three numbers for each node of the graph");
}

void Graph::add_anchor(Index node, const edges::Vector& value, double information) {
    check_node(node);
    const edges::Symmetric omega{information, 0.0, information, 0.0, 0.0, information};
    add_pairs(std::make_unique<edges::PositionEdges>(std::vector{edges::Position{node, value, omega}}));
    anchors_.emplace_back(node, value);
}

void Graph::add_relative(std::vector<edges::RelativeEdge> edges, const edges::Kernel& kernel, bool oriented) {
    reweighted = reweighted || kernel;
    std::vector<Index> first, second;
    for (const edges::RelativeEdge& edge : edges) {
        first.push_back(edge.i);
        second.push_back(edge.j);
    }
    add_pairs(std::make_unique<edges::RelativeEdges>(std::move(edges), oriented, false, kernel), std::move(first),
              std::move(second));
}

void Graph::add_pairs(std::unique_ptr<const edges::Family> family, std::vector<Index> first, std::vector<Index> second) {
    require(first.size() == second.size(), "each edge has two ends");
    for (std::size_t e = 0; e < first.size(); ++e) {
        check_node(first[e]);
        check_node(second[e]);
        require(first[e] != second[e], "an edge ties two different nodes");
        sizes_.push_back(2);
        grouped_.insert(grouped_.end(), {std::min(first[e], second[e]), std::max(first[e], second[e])});
    }
    members_.push_back({std::move(family), std::move(first), std::move(second)});
}

void Graph::add_groups(std::unique_ptr<const edges::Family> family, std::span<const Index> starts,
                       std::span<const Index> nodes) {
    require(!starts.empty() && starts.front() == 0 && starts.back() == static_cast<Index>(nodes.size()) &&
                std::is_sorted(starts.begin(), starts.end()),
            "the starts of groups must not decrease from 0 to the number of their nodes");
    for (const Index node : nodes) check_node(node);
    for (std::size_t g = 0; g + 1 < starts.size(); ++g) {
        require(std::is_sorted(nodes.begin() + starts[g], nodes.begin() + starts[g + 1]),
                "the nodes of a group must not decrease");
        sizes_.push_back(starts[g + 1] - starts[g]);
    }
    grouped_.insert(grouped_.end(), nodes.begin(), nodes.end());
    members_.push_back({std::move(family), {}, {}});
}

Graph::Assembled::Assembled(const Graph& graph, int threads)
    : system(sparse::pattern_of_groups(graph.nodes_, graph.sizes_, graph.grouped_), threads, graph.points_) {
    std::vector<GraphObjective::Member> families;
    for (const Member& m : graph.members_) {
        std::vector<Index>& blocks = pairs.emplace_back();
        for (std::size_t e = 0; e < m.first.size(); ++e)
            blocks.push_back(sparse::block_between(system.view(), m.first[e], m.second[e]));
        families.push_back({m.family.get(), blocks});
    }
    objective.emplace(std::move(families), system, Held{{}, graph.points_});
    objective->state_dependent = graph.state_dependent;
    objective->reweighted = graph.reweighted;
}

Start Graph::rotation_first(int threads) const {
    std::vector<double> state(3 * nodes_, 0.0);
    std::vector<Index> held;
    for (const auto& [node, value] : anchors_) {
        held.push_back(node);
        state[3 * node] = value.x, state[3 * node + 1] = value.y, state[3 * node + 2] = value.t;
    }
    if (held.empty()) held.push_back(0);
    return solve::rotation_first(*Assembled(*this, threads).objective, std::move(state), held, nodes_);
}

void Graph::solve(Run& run, int threads) const {
    check_state(run.state);
    Assembled graph(*this, threads);
    gauss_newton(*graph.objective, run);
}

std::optional<certificate::Bound> Graph::lower_bound(std::span<const double> state) const {
    check_state(state);
    edges::ConstantEdges found;
    for (const Member& m : members_)
        if (!m.family->constant(state.data(), nodes_ + static_cast<Index>(found.landmarks.size()), found))
            return std::nullopt;
    std::vector<double> values(state.begin(), state.end());
    for (const edges::Vector& m : found.landmarks) values.insert(values.end(), {m.x, m.y, m.t});
    return certificate::lower_bound(values, std::move(found.edges));
}

std::vector<double> Graph::costs(std::span<const double> state) const {
    check_state(state);
    std::vector<double> costs;
    for (const Member& m : members_) costs.push_back(m.family->accumulate({state.data(), state.data()}, nullptr, {}));
    return costs;
}

std::vector<double> Graph::covariances(std::span<const double> state) const {
    check_state(state);
    Assembled graph(*this, 1);
    graph.objective->linearize(state, state);
    if (!graph.objective->factorize(0.0)) return {};
    return sparse::SelectedInverse(graph.system.factor()).diagonal();
}

namespace {

/// Numbers of sightings of a log, each group those of a landmark.
using Groups = std::vector<std::vector<std::size_t>>;

Groups landmarks_of(const Log& log) {
    std::map<std::int64_t, std::vector<std::size_t>> seen;
    for (std::size_t k = 0; k < log.sightings.size(); ++k) seen[log.sightings[k].landmark].push_back(k);
    Groups groups;
    for (auto& [landmark, numbers] : seen) {
        std::ranges::stable_sort(numbers, {}, [&](std::size_t k) { return log.sightings[k].step; });
        groups.push_back(std::move(numbers));
    }
    return groups;
}

edges::ByLandmark grouped(const Log& log, std::span<const Groups::value_type> groups, const edges::Sensor& sensor,
                          const edges::Kernel& kernel) {
    edges::ByLandmark made{{0}, {}, {{}, {}, {}, sensor, kernel, log.oriented}};
    for (const auto& group : groups) {
        for (const std::size_t k : group) {
            require(k < log.sightings.size(), "a group names a sighting that the log does not have");
            made.nodes.push_back(static_cast<Index>(log.sightings[k].step));
            made.sightings.z.push_back(log.sightings[k].z);
        }
        made.starts.push_back(static_cast<Index>(made.nodes.size()));
    }
    made.sightings.noisy = made.sightings.z;
    made.sightings.trust.assign(made.nodes.size(), 1.0);
    return made;
}

}  // namespace

edges::ByLandmark by_landmark(const Log& log, const edges::Sensor& sensor, const edges::Kernel& kernel) {
    return grouped(log, landmarks_of(log), sensor, kernel);
}

Graph graph_of(const Log& log, const MotionNoise& noise, const edges::Sensor& sensor, const edges::Kernel& kernel,
               const LogEdges& chosen) {
    Graph graph(static_cast<Index>(log.poses()));
    graph.add_anchor(0, {log.start[0], log.start[1], log.start[2]});
    std::vector<edges::RelativeEdge> motions;
    for (Index t = 0; chosen.motions && t + 1 < static_cast<Index>(log.poses()); ++t) {
        const auto [z, omega] = measured(log.motion(t), noise);
        motions.push_back({t, t + 1, z, omega});
        if (chosen.one_by_one) graph.add_relative(std::exchange(motions, {}));
    }
    if (chosen.motions && !chosen.one_by_one) graph.add_relative(std::move(motions));

    const Groups groups = chosen.virtual_motions.value_or(landmarks_of(log));
    const std::size_t at_once = chosen.one_by_one ? 1 : groups.size();
    for (std::size_t g = 0; g < groups.size(); g += at_once) {
        const auto seen = grouped(log, std::span(groups).subspan(g, at_once), sensor, kernel);
        std::unique_ptr<const edges::Family> family;
        if (chosen.virtual_motions)
            family = std::make_unique<edges::VirtualMotionEdges>(seen, false, chosen.body);
        else
            family = std::make_unique<edges::MarginalEdges>(seen, chosen.body);
        graph.add_groups(std::move(family), seen.starts, seen.nodes);
    }
    graph.state_dependent = !chosen.body || (chosen.virtual_motions && !log.oriented);
    graph.reweighted = static_cast<bool>(kernel);
    return graph;
}

}  // namespace vmslam::solve
