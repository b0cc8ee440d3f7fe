#include "vmslam/online/system.hpp"

#include <algorithm>

namespace vmslam::online {

/// How far the edges of a factor may be from the present ones where a covariance is asked for; see `Memory::limit`. It is
/// measured by standard deviations of single edges. On a long way without closures those of poses are thousands of times as
/// large, and errors of all edges have the same direction: with 1e-7 they were up to 27 % too small.
constexpr double known_limit = 1e-11;

void OnlineSystem::use_kernel(const edges::Kernel& kernel, double gain, int rows) {
    for (int k = 1; k <= 3; ++k)
        if (rows == k || rows == 0) graph_.kernels[k - 1] = kernel, graph_.gains[k - 1] = gain;
}

Id OnlineSystem::add_node() {
    graph_.nodes.emplace_back();
    return graph_.size() - 1;
}

Id OnlineSystem::add_point(double x, double y) {
    Node& node = graph_.nodes.emplace_back();
    node.point = true;
    node.begin({x, y, 0.0});
    return graph_.size() - 1;
}

void OnlineSystem::add_prior(std::span<const Id> nodes, std::span<const Triple> places, std::vector<double> information,
                             bool points, std::vector<double> pivot) {
    Prior prior;
    prior.pivot = std::move(pivot);
    prior.members.assign(nodes.begin(), nodes.end());
    prior.information = std::move(information);
    prior.rhs.assign(3 * nodes.size(), 0.0);
    prior.centre.assign(places.begin(), places.end());
    for (std::size_t k = 0; k < nodes.size(); ++k) {
        graph_.nodes[nodes[k]].point = points;
        graph_.nodes[nodes[k]].held = !points;
        graph_.nodes[nodes[k]].begin(places[k]);
    }
    if (!points) prior.turn_to_poses();
    prior.evaluate(graph_, true);
    hang_prior(prior);
    priors_.push_back(std::move(prior));
    memory_.bent = usual_bent();
}

/// Put a prior into the tree, where the next elimination of its nodes finds it.
void OnlineSystem::hang_prior(Prior& prior) {
    prior.group = tree_.create(graph_, prior.members, 0);
    tree_.groups[prior.group].absolute = !prior.relative;
    write_prior(prior, true);
    tree_.hang(prior.group, 0);
}

/// What the tree has of a prior: the right-hand side, and the information, if it is new.
void OnlineSystem::write_prior(const Prior& prior, bool renewed) {
    Supernode& group = tree_.groups[prior.group];
    // a prior has three numbers for points, too, of which the last one means nothing
    const auto put = [&](const double* from, double* to) {
        for (Id k = 0; k < group.r; ++k) std::copy_n(from + 3 * k, group.size_of(k), to + group.begin_of(k));
    };
    put(prior.pull.data(), group.pull_now());
    if (!renewed) return;
    const Front front = group.front();
    std::fill_n(group.update(), 3 * front.r * front.update_height, 0.0);
    for (Id k = 0; k < group.r; ++k)
        for (Id c = 0; c < group.size_of(k); ++c)
            put(prior.linear.data() + (3 * k + c) * 3 * group.r,
                group.update() + (group.begin_of(k) + c) * front.update_height + front.update_pad);
}

bool OnlineSystem::begin_at(std::span<const Triple> x, std::span<const Id> newest) {
    for (std::size_t k = 0; k < x.size(); ++k) {
        Node& node = graph_.nodes[k];
        node = Node{static_cast<const NodeValue&>(node)};
        node.begin(x[k]);
    }
    for (Edge& edge : graph_.edges) edge = Edge{static_cast<const NewEdge&>(edge)};
    memory_.cost = 0.0;
    tree_.clear();
    for (Prior& prior : priors_) {
        prior.evaluate(graph_, true);
        hang_prior(prior);
    }
    const std::vector<Id> nodes = graph_.live_nodes(), edges = graph_.live_edges();
    lost_ = !eliminate({nodes, edges, newest, {}});
    return !lost_;
}

bool OnlineSystem::solve_from(std::span<const Id> nodes, std::span<const Triple> places, std::span<const Id> newest) {
    complete();
    std::vector<Triple> x = this->places();
    for (std::size_t k = 0; k < nodes.size(); ++k) x[nodes[k]] = places[k];
    return begin_and_solve(x, newest);
}

bool OnlineSystem::begin_and_solve(std::span<const Triple> x, std::span<const Id> newest) {
    ++tree_.step;
    passes = 0;
    if (!begin_at(x, newest)) return converged = false;
    converged = iterate(newest) || solve_as_batch(newest);
    return true;
}

void OnlineSystem::loosen(const Triple& place, std::vector<double> information) {
    Prior& prior = priors_.front();
    prior.centre[0] = place;
    prior.information = std::move(information);
    prior.turn_to_poses();
}

void OnlineSystem::relinearize(std::span<const Id> newest) {
    factorize_again(newest);
    converged = !lost_ && iterate(newest);
    if (!converged) begin_at(places(), newest);
}

/// Linearise all edges and priors where the nodes are, in the tree that there is; false where there is none, or no factor.
bool OnlineSystem::factorize_all() {
    if (lost_) return false;
    std::vector<Prior*> priors;
    for (Prior& prior : priors_) priors.push_back(&prior);
    const std::vector<Id> above = renew_priors(priors);
    Evaluation found{memory_.limit, memory_.bent};
    for (Id s = 1; s < static_cast<Id>(tree_.groups.size()); ++s)
        if (tree_.groups[s].w > 0) tree_.evaluate_edges(graph_, s, found);
    memory_.cost += found.change;
    return factorize_late(graph_.live_edges(), above);
}

/// The factor of Gauss-Newton at the estimate, without second derivatives; returns whether there is one.
bool OnlineSystem::factorize_again(std::span<const Id> newest) {
    complete();
    const std::vector<Triple> x = places();
    memory_.bent.edges = Bent::Edges::none;
    const std::vector<Id> nodes = graph_.live_nodes();
    bool good = factorize_all() || (!lost_ && eliminate({nodes, {}, newest, {}}));
    good = good || begin_at(x, newest);
    memory_.bent.edges = usual_bent().edges;
    // second derivatives may make it definite, so that steps can go on
    if (!good) begin_at(x, newest);
    return good;
}

// Second derivatives only help passes to converge: they are no information that the graph has, or take some away. So edges
// enter the factor as Gauss-Newton has them, where covariances would be wrong otherwise.
bool OnlineSystem::linearize_late(std::span<const Id> newest) {
    if ((lost_ || memory_.bent.edges == Bent::Edges::all) && !factorize_again(newest)) return false;
    if (covariances_ready_) return true;
    covariances_ready_ = true;
    complete();
    std::vector<Id> late;
    for (const Id e : graph_.live_edges())
        if (differs_from_gauss_newton(graph_, graph_.edges[e], known_limit)) late.push_back(e);
    if (late.empty()) return true;
    pass(-1.0);
    Evaluation found{memory_.limit, Bent::never()};
    const bool good = refactor(graph_, tree_, late, {}, found);
    memory_.cost += found.change;
    if (!good) return covariances_ready_ = factorize_again(newest);
    // along a weak direction the factor of Gauss-Newton would move the estimate, maybe upwards: it is for covariances alone
    if (!is_small(found.predicted)) tree_.stay();
    return true;
}

std::optional<std::vector<double>> OnlineSystem::covariance(std::span<const Id> nodes, std::span<const Id> newest) {
    if (!converged) {
        // making the factor of Gauss-Newton may fail where steps have not converged, and would cost the one that there is
        OnlineSystem other = *this;
        other.converged = true;
        return other.covariance(nodes, newest);
    }
    const auto eliminated = [&](Id node) { return graph_.nodes[node].home > 0; };
    if (!linearize_late(newest) || !std::all_of(nodes.begin(), nodes.end(), eliminated)) return std::nullopt;
    // the axes of the nodes are those of the solution
    values(nodes);
    return tree_.covariance(graph_, nodes);
}

std::vector<Triple> OnlineSystem::values(std::span<const Id> nodes) {
    std::vector<Id> homes;
    for (const Id node : nodes) homes.push_back(graph_.nodes[node].home);
    tree_.move_paths(graph_, homes);
    return graph_.values(nodes);
}

void OnlineSystem::complete() { tree_.move_all(graph_); }

double OnlineSystem::cost() {
    complete();
    double total = 0.0;
    for (const Edge& edge : graph_.edges) {
        if (edge.taken_out()) continue;
        const double squares = linearize(graph_, edge).squares;
        total += edge.robust ? graph_.kernel_of(edge).loss(squares) : squares;
    }
    return total;
}

double OnlineSystem::cost_with_priors() {
    double total = cost();
    for (const Prior& prior : priors_) total += prior.cost(graph_);
    return total;
}

std::vector<Triple> OnlineSystem::places() const {
    std::vector<Triple> x;
    for (const Node& node : graph_.nodes) x.push_back(node.x);
    return x;
}

std::size_t OnlineSystem::bytes() const {
    return graph_.nodes.capacity() * sizeof(Node) + graph_.edges.capacity() * sizeof(Edge) +
           tree_.groups.capacity() * sizeof(Supernode) + static_cast<std::size_t>(tree_.numbers()) * sizeof(double);
}

}  // namespace vmslam::online
