// A step of the online solver (`OnlineSystem::add`) and its passes. A step
//
//     moves the nodes at which its edges end, and those above them in the tree, to the solution,
//     appends the edges,
//     eliminates the top of the tree again, with the new nodes (rebuild.cpp),
//     passes through the tree until the next pass would lower J by less than the tolerance (`advance`),
//     and where that fails, solves the graph as a batch (batch.cpp), or undoes what it has changed.
//
// A pass moves the nodes to the solution from the roots down, evaluates their edges, and solves the tree again on the way up.
// It leaves out subtrees that are not deformed; see tree.hpp.
#include <algorithm>
#include <cmath>
#include <tuple>
#include <utility>

#include "vmslam/online/system.hpp"

namespace vmslam::online {

/// A pass leaves out subtrees that would change J by less than this part of it. Where a pass is slow, this is multiplied by
/// `finer` for the next ones, because edges of subtrees that were left out may be the reason.
constexpr double settled = 2e-7, finer = 0.3;
/// The first pass of a step leaves out `coarse` times as much where a later one will follow it: where this part of what the
/// elimination predicts is not below the tolerance.
constexpr double coarse = 3.0, never_last = 0.05;
/// What rounding leaves of a prediction where J is zero.
constexpr double rounding = 1e-15;
/// A pass is slow where it predicts more than this part of the decrease that the pass before predicted; after edges were
/// linearised again, where it predicts more than `diverging` of it.
constexpr double slow = 0.2, diverging = 0.5;
/// The limit beyond which an edge is linearised again is multiplied by `stricter` after a slow pass, and by `easier` after
/// every step whose last pass is not slow.
constexpr double stricter = 0.1, easier = 1.5;
/// All edges get their second derivatives after a slow pass if its prediction is larger by the factor `grows` than the one
/// before, although the end is near: it is below `near` times J, the limit of edges is below `strict`, and what is left out
/// is below `fine` times the usual. Second derivatives make passes slow along directions that are hardly determined, so that
/// they are not in the factor otherwise.
constexpr double grows = 1.5, near = 1e-6, strict = 1e-4, fine = 0.03;
/// For so many passes second derivatives are convex once exact ones have made Omega indefinite.
constexpr int held = 3;
/// The largest ratio of the predictions of two passes is multiplied by this at each step.
constexpr double forget = 0.9;
/// Passes end where one predicts a decrease of more than this many times J.
constexpr double hopeless = 10.0;
/// From the pass `patient` on they end where one predicts more than this part of what the third one before it predicted, and as
/// many edges as the graph has were linearised again: a batch solution then takes less time than more passes.
constexpr double stuck = 0.7;
constexpr int patient = 6;
/// The next pass is assumed to predict at least this part of what this one predicts.
constexpr double least_left = 0.3;
/// All nodes are ordered again where there are this many times as many as when they were ordered last.
constexpr double growth = 1.3;
/// The part by which J may rise in the passes of a step with single numbers.
constexpr double rises = 1e-6;

/// What a step changes until an elimination has succeeded, to put it back: nodes from `homes` up to the roots, the new nodes
/// and edges, and what the system remembers.
class OnlineSystem::Undo {
   public:
    Undo(OnlineSystem& system, std::span<const Id> homes, Id known)
        : system_(system),
          known_(known),
          first_edge_(static_cast<Id>(system.graph_.edges.size())),
          remembered_(system.memory_, system.ordered_, system.passes, system.converged, system.covariances_ready_,
                      system.graph_.has_single_numbers) {
        const std::vector<Id> path = system.tree_.upwards(homes);
        std::size_t count = 0;
        for (const Id s : path) count += system.tree_.groups[s].w;
        nodes_.reserve(count);
        for (const Id s : path)
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
        for (const Id end : edge.ends)
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

bool OnlineSystem::is_small(double decrease) const { return decrease <= std::max(tolerance_ * memory_.cost, rounding); }

// A step that begins at the solution needs no pass: nothing promises to lower J. Each pass moves the nodes by what is
// predicted to lower J, and evaluates their edges; those that are far from their linearisation are linearised again, and the
// tree above them is factorised again. The last pass is the one after which further ones are predicted to lower J by less
// than the tolerance.
OnlineSystem::Outcome OnlineSystem::advance(int& done) {
    Memory& m = memory_;
    Progress progress;
    m.shrinks *= forget;
    while (done < most_passes_) {
        if (progress.first() && is_small(least_left * m.predicted)) return Outcome::done;
        if (m.hold > 0 && --m.hold == 0) m.bent.convex = false;
        const bool followed = progress.first() && !is_small(never_last * m.predicted);
        const Pass pass = this->pass((followed ? coarse : 1.0) * progress.part * settled * m.cost);
        // J cannot fall by more than itself: far from any minimum, undamped passes lead nowhere
        if (!(pass.predicted < hopeless * m.cost + 1.0) || !std::isfinite(m.cost)) break;
        const bool ends = is_last(pass.predicted, progress.last);
        adapt(pass.predicted, ends, progress);
        const std::vector<Id> above = renew_priors(pass.outdated);
        progress.renewed = !pass.late.empty() || !above.empty();
        if (ends && !progress.renewed) return Outcome::done;
        ++done;
        progress.linearized += pass.late.size();
        const double earlier = std::exchange(progress.earlier[done % 3], pass.predicted);
        if (done >= patient && pass.predicted > stuck * earlier && progress.linearized > graph_.edges.size()) break;
        while (progress.renewed && !factorize_late(pass.late, above)) {
            if (m.hold > 0) return Outcome::indefinite;
            m.bent.convex = true;
            m.hold = held;
        }
        // the factor before may have been too stiff along directions that are hardly determined, and predicted too little
        if (ends && is_small(least_left * m.predicted)) return Outcome::done;
    }
    done = most_passes_;
    return Outcome::unfinished;
}

/// Whether further passes would lower J little in all, if their predictions shrink as slowly as those of the last passes.
bool OnlineSystem::is_last(double predicted, double last) {
    Memory& m = memory_;
    m.shrinks = std::max({m.shrinks, std::min(predicted / last, 0.9), m.bent.edges == Bent::Edges::all ? 0.75 : 0.0});
    return is_small(predicted * std::max(least_left, m.shrinks / (1 - m.shrinks)));
}

/// After a slow pass, keep edges nearer to their linearisation and leave out less; after a fast last one, allow more again.
void OnlineSystem::adapt(double predicted, bool ends, Progress& progress) {
    Memory& m = memory_;
    const double last = std::exchange(progress.last, predicted);
    if (ends) {
        if (predicted < slow * last) m.limit = std::min(Memory{}.limit, easier * m.limit);
        return;
    }
    if (predicted <= (progress.renewed ? diverging : slow) * last) return;
    const bool near_the_end = grows * last < predicted && predicted < near * m.cost && progress.part < fine;
    if (near_the_end && progress.renewed && m.hold == 0 && m.limit < strict && m.bent.edges == Bent::Edges::costly)
        m.bent.edges = Bent::Edges::all;
    else
        m.limit = std::max(stricter * m.limit, 1e-9);
    progress.part *= finer;
}

OnlineSystem::Pass OnlineSystem::pass(double least) {
    Pass result;
    const Tree::Moved moved = tree_.descend(graph_, least);
    for (const Id group : moved.priors) {
        Prior& prior = *std::ranges::find(priors_, group, &Prior::group);
        prior.evaluate(graph_, false);
        write_prior(prior, false);
        // an absolute one is linear but for the heading of each pose itself
        if (!prior.linear_in_places() && prior.outdated(graph_)) result.outdated.push_back(&prior);
    }
    Evaluation found{memory_.limit, memory_.bent};
    for (auto s = moved.supernodes.rbegin(); s != moved.supernodes.rend(); ++s) tree_.evaluate(graph_, *s, found);
    memory_.cost += found.change;
    result.predicted = found.predicted;
    result.late = std::move(found.late);
    return result;
}

/// Factorise again above edges that are linearised where they are, and above `others`.
bool OnlineSystem::factorize_late(std::span<const Id> late, std::span<const Id> others) {
    Evaluation found{memory_.limit, memory_.bent};
    const bool good = refactor(graph_, tree_, late, others, found);
    memory_.cost += found.change;
    memory_.predicted = found.predicted;
    return good;
}

// Relative priors, and those that turn, have no second derivatives in the factor. Those of the edges are of no use then:
// along a common turn of many nodes they cancel only together with those of the priors.
Bent OnlineSystem::usual_bent() const {
    const bool all = std::ranges::all_of(priors_, [](const Prior& prior) { return prior.linear_in_places(); });
    return all ? Bent{} : Bent::never();
}

/// Linearise priors where their nodes are; returns the supernodes above, which are to be factorised again.
std::vector<Id> OnlineSystem::renew_priors(std::span<Prior* const> priors) {
    std::vector<Id> above;
    for (Prior* const prior : priors) {
        prior->evaluate(graph_, true);
        write_prior(*prior, true);
        above.push_back(tree_.groups[prior->group].parent);
    }
    return above;
}

bool OnlineSystem::iterate(std::span<const Id> newest) {
    covariances_ready_ = false;
    for (int done = 0;;) {
        const int earlier = done;
        const Outcome outcome = advance(done);
        passes += done - earlier;
        if (outcome != Outcome::indefinite) return outcome == Outcome::done;
        memory_.bent.convex = true;
        memory_.hold = held;
        tree_.move_all(graph_);
        const std::vector<Id> every = graph_.live_nodes();
        if (!eliminate({every, {}, newest, {}})) return false;
    }
}

bool OnlineSystem::eliminate(const Changes& changes) {
    covariances_ready_ = false;
    for (Prior& prior : priors_) {
        prior.evaluate(graph_, false);
        write_prior(prior, false);
    }
    for (;;) {
        Evaluation found{memory_.limit, memory_.bent};
        const bool good = rebuild(graph_, tree_, changes, found);
        memory_.cost += found.change;
        memory_.predicted = found.predicted;
        if (good) return true;
        if (memory_.hold > 0) return false;
        memory_.bent.convex = true;
        memory_.hold = held;
    }
}

}  // namespace vmslam::online
