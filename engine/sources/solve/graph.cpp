#include "vmslam/solve/graph.hpp"

#include <algorithm>
#include <cmath>
#include <deque>
#include <limits>
#include <numeric>

#include "require.hpp"
#include "vmslam/edges/marginal.hpp"
#include "vmslam/solve/grow.hpp"

namespace vmslam::solve {

Graph::Graph(Index nodes) : nodes_(nodes) {
    require(nodes > 0, "a graph needs at least one node");
    motions_.resize(3 * nodes);
    variances_.resize(nodes, std::numeric_limits<double>::quiet_NaN());
    variances_[0] = 0.0;
}

void Graph::check_node(Index node) const {
    require(node >= 0 && node < nodes_, "an edge or an anchor names a node that the graph does not have");
}

void Graph::check_state(std::span<const double> state) const {
    require(state.size() == 3 * static_cast<std::size_t>(nodes_),
            "a state must have three numbers for each node of the graph");
}

void Graph::add_anchor(Index node, const edges::Vector& value, double information) {
    check_node(node);
    const edges::Symmetric omega{information, 0.0, information, 0.0, 0.0, information};
    members_.push_back({std::make_unique<edges::PositionEdges>(std::vector{edges::Position{node, value, omega}}), {}, {}});
    anchors_.emplace_back(node, value);
}

void Graph::add_relative(std::vector<edges::RelativeEdge> edges, const edges::Kernel& kernel) {
    reweighted = reweighted || kernel;
    Member member;
    member.doubted = static_cast<bool>(kernel);
    for (const edges::RelativeEdge& edge : edges) {
        check_node(edge.i);
        check_node(edge.j);
        require(edge.i != edge.j, "an edge ties two different nodes");
        member.first.push_back(edge.i);
        member.second.push_back(edge.j);
        sizes_.push_back(2);
        grouped_.insert(grouped_.end(), {std::min(edge.i, edge.j), std::max(edge.i, edge.j)});
        if (edge.j != edge.i + 1 || !std::isnan(variances_[edge.j])) continue;
        motions_[3 * edge.j] = edge.z.x, motions_[3 * edge.j + 1] = edge.z.y, motions_[3 * edge.j + 2] = edge.z.t;
        const double variance = edges::inverse(edge.omega, true).tt;
        variances_[edge.j] = variance > 0 ? variance : std::numeric_limits<double>::infinity();
    }
    member.family = std::make_unique<edges::RelativeEdges>(std::move(edges), true, false, kernel);
    members_.push_back(std::move(member));
}

void Graph::add_groups(std::unique_ptr<const edges::Family> family, std::span<const Index> starts,
                       std::span<const Index> nodes) {
    require(!starts.empty() && starts.front() == 0 && starts.back() == static_cast<Index>(nodes.size()) &&
                std::is_sorted(starts.begin(), starts.end()),
            "the starts of groups must not decrease from 0 to the number of their nodes");
    for (const Index node : nodes) check_node(node);
    for (std::size_t g = 0; g + 1 < starts.size(); ++g) sizes_.push_back(starts[g + 1] - starts[g]);
    grouped_.insert(grouped_.end(), nodes.begin(), nodes.end());
    members_.push_back({std::move(family), {}, {}, true});
}

struct Graph::Assembled {
    OwnedSystem system;
    std::deque<std::vector<Index>> pairs;
    std::optional<GraphObjective> objective;

    Assembled(const Graph& graph, int threads)
        : system(sparse::pattern_of_groups(graph.nodes_, graph.sizes_, graph.grouped_), threads) {
        std::vector<GraphObjective::Member> families;
        for (const Member& m : graph.members_) {
            std::vector<Index>& blocks = pairs.emplace_back();
            for (std::size_t e = 0; e < m.first.size(); ++e)
                blocks.push_back(sparse::block_between(system.view(), m.first[e], m.second[e]));
            families.push_back({m.family.get(), blocks});
        }
        objective.emplace(std::move(families), system);
        objective->state_dependent = graph.state_dependent;
        objective->reweighted = graph.reweighted;
    }
};

std::vector<double> Graph::anchored() const {
    std::vector<double> state(3 * nodes_, 0.0);
    for (const auto& [node, value] : anchors_)
        state[3 * node] = value.x, state[3 * node + 1] = value.y, state[3 * node + 2] = value.t;
    return state;
}

Start Graph::rotation_first(int threads) const {
    std::vector<Index> held;
    for (const auto& [node, value] : anchors_) held.push_back(node);
    if (held.empty()) held.push_back(0);
    return solve::rotation_first(*Assembled(*this, threads).objective, anchored(), held, nodes_);
}

std::optional<std::vector<double>> Graph::grown(Index each, int threads) const {
    require(each > 0, "a graph grows by at least one node at a time");
    if (std::any_of(variances_.begin(), variances_.end(), [](double v) { return std::isnan(v); })) return std::nullopt;
    std::vector<Index> parents(nodes_), from(nodes_);
    std::iota(parents.begin(), parents.end(), -1);
    std::iota(from.begin(), from.end(), 0);
    return grow(*Assembled(*this, threads).objective, anchored(), {nodes_, each, parents, motions_, from});
}

void Graph::solve(Run& run, int threads) const {
    check_state(run.state);
    Assembled graph(*this, threads);
    gauss_newton(*graph.objective, run);
}

Lowered Graph::lowered_by_restarts(std::span<const double> state, double limit, int threads) const {
    check_state(state);
    Assembled graph(*this, threads);
    const Odometry odometry{motions_, variances_};
    Lowered lowered = lowered_by_turns(*graph.objective, state, odometry, limit);
    std::vector<std::size_t> doubted;
    for (std::size_t k = 0; k < members_.size(); ++k)
        if (members_[k].doubted) doubted.push_back(k);
    const std::vector<double> from = lowered.state.value_or(std::vector(state.begin(), state.end()));
    const Lowered further = lowered_by_halves(*graph.objective, doubted, from, odometry, limit - lowered.steps);
    if (further.state) lowered.state = further.state;
    lowered.steps += further.steps;
    return lowered;
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

edges::ByLandmark by_landmark(const Log& log, const edges::Sensor& sensor, const edges::Kernel& kernel) {
    std::vector<LandmarkSighting> seen = log.sightings;
    std::stable_sort(seen.begin(), seen.end(), [](const LandmarkSighting& a, const LandmarkSighting& b) {
        return a.landmark != b.landmark ? a.landmark < b.landmark : a.step < b.step;
    });
    edges::ByLandmark made{{}, {}, {{}, {}, std::vector<double>(seen.size(), 1.0), sensor, kernel, log.oriented}};
    for (std::size_t k = 0; k < seen.size(); ++k) {
        if (k == 0 || seen[k].landmark != seen[k - 1].landmark) made.starts.push_back(static_cast<Index>(k));
        made.nodes.push_back(static_cast<Index>(seen[k].step));
        made.sightings.z.push_back(seen[k].z);
    }
    made.starts.push_back(static_cast<Index>(seen.size()));
    made.sightings.noisy = made.sightings.z;
    return made;
}

Graph graph_of(const Log& log, const MotionNoise& noise, const edges::Sensor& sensor, const edges::Kernel& kernel) {
    Graph graph(static_cast<Index>(log.poses()));
    graph.add_anchor(0, {log.start[0], log.start[1], log.start[2]});
    std::vector<edges::RelativeEdge> motions;
    for (Index t = 0; t + 1 < static_cast<Index>(log.poses()); ++t) {
        const auto [z, omega] = measured(log.motion(t), noise);
        motions.push_back({t, t + 1, z, omega});
    }
    graph.add_relative(std::move(motions));
    auto [starts, nodes, sightings] = by_landmark(log, sensor, kernel);
    graph.add_groups(std::make_unique<edges::MarginalEdges>(starts, nodes, std::move(sightings), true), starts, nodes);
    graph.reweighted = graph.reweighted || kernel;
    return graph;
}

}  // namespace vmslam::solve
