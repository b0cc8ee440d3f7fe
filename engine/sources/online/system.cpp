#include "vmslam/online/system.hpp"

#include <algorithm>
#include <cmath>
#include <tuple>

namespace vmslam::online {
namespace {

/// Everything is ordered again where there are so many times as many nodes as the last time.
constexpr double growth = 1.3;
/// How far the edges of a factor may be from the present ones where a covariance is asked for; see `Memory::limit`.
constexpr double known_limit = 1e-7;
/// The part by which J may rise in the passes of a step with single numbers.
constexpr double rises = 1e-6;

}  // namespace

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

/// What a step changes until an elimination has succeeded, to put it back: nodes from `homes` up to the roots, the new nodes and
/// edges, and what the system remembers.
class OnlineSystem::Undo {
   public:
    Undo(OnlineSystem& system, std::span<const Id> homes, Id known)
        : system_(system),
          known_(known),
          first_edge_(static_cast<Id>(system.graph_.edges.size())),
          remembered_(system.memory_, system.ordered_, system.passes, system.converged, system.covariances_ready_,
                      system.graph_.has_single_numbers) {
        for (const Id s : system.tree_.upwards(homes))
            for (const Id node : system.tree_.groups[s].columns()) nodes_.push_back({node, system.graph_.nodes[node]});
        for (const Prior& prior : system.priors_) of_priors_.push_back(prior.pull);
    }
    void operator()() const {
        system_.graph_.detach(first_edge_);
        for (const auto& [node, kept] : nodes_) system_.graph_.nodes[node] = kept;
        for (std::size_t k = 0; k < of_priors_.size(); ++k) {
            system_.priors_[k].pull = of_priors_[k];
            system_.write_prior(system_.priors_[k], false);
        }
        system_.graph_.nodes.resize(known_);
        std::tie(system_.memory_, system_.ordered_, system_.passes, system_.converged, system_.covariances_ready_,
                 system_.graph_.has_single_numbers) = remembered_;
    }

   private:
    OnlineSystem& system_;
    Id known_, first_edge_;
    std::vector<std::pair<Id, Node>> nodes_;
    std::vector<std::vector<double>> of_priors_;
    std::tuple<Memory, Id, int, bool, bool, bool> remembered_;
};

bool OnlineSystem::add(Id known, std::span<const NewEdge> added, std::span<const Id> newest) {
    if (added.empty()) {
        // a known pose from which nothing is seen
        passes = 0;
        return true;
    }
    std::vector<Id> homes;
    for (const NewEdge& edge : added)
        for (const Id end : {edge.first, edge.second})
            if (end < known) homes.push_back(graph_.nodes[end].home);
    const Undo undo(*this, homes, known);
    tree_.move_paths(graph_, homes);
    auto e = static_cast<Id>(graph_.edges.size());
    const std::vector<Id> touched = graph_.append(added, known);
    std::vector<Id> fresh;
    for (; e < static_cast<Id>(graph_.edges.size()); ++e) fresh.push_back(e);
    if (solve(touched, fresh, newest)) return true;
    undo();
    return false;
}

bool OnlineSystem::solve(std::span<const Id> touched, std::span<const Id> fresh, std::span<const Id> newest) {
    std::vector<Id> every, all;
    if (const auto n = graph_.size(); n > growth * ordered_ + 50) {
        ordered_ = n;
        touched = every = graph_.live_nodes();
    }
    if (lost_) {
        touched = every = graph_.live_nodes();
        fresh = all = graph_.live_edges();
    }
    passes = 0;
    const auto eliminate_all = [&] {
        const std::vector<Node> before = graph_.nodes;
        complete();
        if (eliminate({every, fresh, newest, {}})) return true;
        graph_.nodes = before;
        return false;
    };
    if (!every.empty()) {
        if (!eliminate_all()) return false;
    } else if (!eliminate({touched, fresh, newest, {}})) {
        // exact second derivatives below the top may make it indefinite
        every = graph_.live_nodes();
        if (touched.size() == every.size() || !eliminate_all()) return false;
    }
    lost_ = false;
    ++tree_.step;
    converged = descends(newest) || solve_as_batch(newest);
    return true;
}

/// `iterate`, and whether J has not risen: where there are single numbers, undamped passes may end in a higher minimum.
bool OnlineSystem::descends(std::span<const Id> newest) {
    const double before = memory_.cost;
    return iterate(newest) && (!graph_.has_single_numbers || memory_.cost <= before + rises * (1.0 + before));
}

bool OnlineSystem::begin_at(std::span<const Triple> x, std::span<const Id> newest) {
    for (std::size_t k = 0; k < x.size(); ++k) {
        Node& node = graph_.nodes[k];
        Node anew;
        anew.place_std = node.place_std, anew.heading_std = node.heading_std, anew.borrows = node.borrows,
        anew.edges = node.edges;
        anew.point = node.point, anew.gone = node.gone, anew.held = node.held;
        anew.begin(x[k]);
        node = anew;
    }
    for (Edge& edge : graph_.edges) {
        edge.linear = {};
        edge.weight = edge.cost = edge.squares = 0.0;
    }
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

/// The factor of Gauss-Newton at the estimate, without second derivatives; returns whether there is one.
bool OnlineSystem::factorize_again(std::span<const Id> newest) {
    complete();
    const std::vector<Triple> x = places();
    memory_.bent.convex = infinity;
    const std::vector<Id> nodes = graph_.live_nodes(), edges = graph_.live_edges();
    std::vector<Prior*> priors;
    for (Prior& prior : priors_) priors.push_back(&prior);
    const std::vector<Id> above = renew_priors(priors);
    bool good = !lost_ && (factorize_late(edges, above) || eliminate({nodes, {}, newest, {}}));
    good = good || begin_at(x, newest);
    memory_.bent.convex = usual_bent().convex;
    // second derivatives may make it definite, so that steps can go on
    if (!good) begin_at(x, newest);
    return good;
}

// Second derivatives only help passes to converge: they are no information that the graph has, or take some away. So edges
// enter the factor as Gauss-Newton has them, where covariances would be wrong otherwise.
bool OnlineSystem::linearize_late(std::span<const Id> newest) {
    if ((lost_ || memory_.bent.convex == 0.0) && !factorize_again(newest)) return false;
    if (covariances_ready_) return true;
    covariances_ready_ = true;
    complete();
    std::vector<Id> late;
    for (const Id e : graph_.live_edges())
        if (differs_from_gauss_newton(graph_, graph_.edges[e], known_limit)) late.push_back(e);
    if (late.empty()) return true;
    pass(-1.0);
    Evaluation found{memory_.limit, {infinity, memory_.bent.exact}};
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
    std::vector<Triple> x;
    for (const Id node : nodes) x.push_back(graph_.nodes[node].x);
    return x;
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
