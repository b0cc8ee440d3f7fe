// The batch solution of an online system, for steps from which undamped passes do not converge.
#include <algorithm>
#include <cmath>
#include <deque>
#include <memory>

#include "vmslam/edges/relative.hpp"
#include "vmslam/edges/single_numbers.hpp"
#include "vmslam/online/system.hpp"
#include "vmslam/solve/run.hpp"
#include "vmslam/sparse/pattern.hpp"

namespace vmslam::online {
namespace {

using edges::RelativeEdge;
using sparse::Index;

/// The nodes and edges of an online system as a graph of edge families.
class BatchProblem {
   public:
    BatchProblem(const Graph& graph, std::span<const Prior> priors) : nodes_(graph.live_nodes()) {
        number_.assign(graph.nodes.size(), -1);
        for (std::size_t k = 0; k < nodes_.size(); ++k) {
            const Node& node = graph.nodes[nodes_[k]];
            number_[nodes_[k]] = static_cast<Id>(k);
            state.insert(state.end(), node.x.begin(), node.x.end());
            if (node.point) points_.push_back(static_cast<Index>(k));
        }
        system_.emplace(pattern_of(graph, priors), 1, points_);
        add_families(graph, priors);
        objective = std::make_unique<solve::GraphObjective>(members_, *system_, solve::Held{{}, {}, points_});
        objective->reweighted = std::ranges::any_of(graph.edges, &Edge::robust);
    }

    std::vector<double> state;
    std::unique_ptr<solve::GraphObjective> objective;
    std::span<const Id> nodes() const { return nodes_; }

   private:
    sparse::OwnedPattern pattern_of(const Graph& graph, std::span<const Prior> priors) const {
        std::vector<Index> sizes, members;
        const auto add = [&](std::span<const Id> group) {
            sizes.push_back(static_cast<Index>(group.size()));
            for (const Id node : group) members.push_back(number_[node]);
            std::sort(members.end() - sizes.back(), members.end());
        };
        for (const Edge& edge : graph.edges)
            if (!edge.taken_out() && !edge.one_ended()) add(edge.ends);
        for (const Prior& prior : priors) add(prior.members);
        return sparse::pattern_of_groups(static_cast<Index>(nodes_.size()), sizes, members);
    }

    void add_families(const Graph& graph, std::span<const Prior> priors) {
        for (const bool oriented : {true, false})
            for (const bool robust : {true, false}) {
                std::vector<RelativeEdge> edges;
                std::vector<Index>& pairs = pairs_.emplace_back();
                std::vector<edges::Position> positions;
                const edges::Kernel kernel = robust ? graph.kernels[oriented ? 2 : 1] : edges::Kernel{};
                for (const Edge& edge : graph.edges) {
                    if (edge.taken_out() || edge.single_number() || edge.oriented != oriented || edge.robust != robust)
                        continue;
                    const Index i = number_[edge.ends[0]], j = number_[edge.ends[1]];
                    if (edge.one_ended()) {
                        positions.push_back({i, edge.z, edge.omega, edge.lever});
                        continue;
                    }
                    edges.push_back({i, j, edge.z, edge.omega});
                    pairs.push_back(sparse::block_between(system_->view(), i, j));
                }
                if (!edges.empty())
                    add(std::make_unique<edges::RelativeEdges>(std::move(edges), oriented, false, kernel), pairs);
                if (!positions.empty()) add(std::make_unique<edges::PositionEdges>(std::move(positions), kernel), {});
            }
        for (const auto& [form, kind] :
             {std::pair(Form::range, edges::Number::range), {Form::bearing, edges::Number::bearing}}) {
            std::vector<edges::NumberEdge> edges;
            std::vector<Index>& pairs = pairs_.emplace_back();
            for (const Edge& edge : graph.edges) {
                if (edge.taken_out() || edge.form != form) continue;
                const Index i = number_[edge.ends[0]], j = number_[edge.ends[1]];
                edges.push_back({i, j, edge.z.x, edge.omega.xx, edge.lever});
                pairs.push_back(sparse::block_between(system_->view(), i, j));
            }
            // all of them are sightings
            if (!edges.empty()) add(std::make_unique<edges::NumberEdges>(kind, std::move(edges), graph.kernels[0]), pairs);
        }
        for (const Prior& prior : priors) add(std::make_unique<PriorFamily>(prior, graph, number_), {});
    }

    void add(std::unique_ptr<edges::Family> family, std::span<const Index> pairs) {
        families_.push_back(std::move(family));
        members_.push_back({families_.back().get(), pairs});
    }

    std::vector<Id> nodes_, number_;
    std::vector<Index> points_;
    std::optional<solve::OwnedSystem> system_;
    std::deque<std::vector<Index>> pairs_;  ///< stay where they are while others are added
    std::vector<std::unique_ptr<edges::Family>> families_;
    std::vector<solve::GraphObjective::Member> members_;
};

/// A state of lower cost by Gauss-Newton, damped where necessary, or nothing.
std::vector<double> lower_state(BatchProblem& problem, bool damped_only) {
    solve::GraphObjective& objective = *problem.objective;
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

// The correction is too large for undamped passes: the step is undone, the batch solver solves the graph, and the tree is
// built anew where that has ended.
bool OnlineSystem::solve_as_batch(std::span<const Id> newest) {
    ++batch_solutions;
    for (Node& node : graph_.nodes)
        if (node.changed == tree_.step) node.x = node.kept, node.axes = Rotation(node.kept[2]);
    BatchProblem problem(graph_, priors_);
    const std::vector<double> found = lower_state(problem, graph_.has_single_numbers);
    std::vector<Triple> start = places();
    for (std::size_t k = 0; k < found.size() / 3; ++k)
        std::copy_n(found.begin() + 3 * k, 3, start[problem.nodes()[k]].begin());
    // where passes have failed, second derivatives of all edges did not help
    memory_.bent.convex = usual_bent().convex;
    if (begin_at(start, newest) && descends(newest)) return true;
    begin_at(start, newest);
    return false;
}

}  // namespace vmslam::online
