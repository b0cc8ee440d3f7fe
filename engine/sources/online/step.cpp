// Passes of one step, until the cost falls no further.
//
// A pass solves the tree and evaluates the edges of nodes that moved. Coarse passes leave out nodes that moved little, so that
// they need not visit the whole tree; fine passes look at all. What coarse passes leave out grows with the energy that new
// edges have put into the older ones (`work_of`), summed since the last fine pass. Where this sum exceeds `Memory::allowed`,
// a fine pass follows. The decrease of J that it predicts is what the coarse passes had missed, and sets the sum that is
// allowed from then on.
#include <algorithm>
#include <cmath>

#include "vmslam/online/system.hpp"

namespace vmslam::online {
namespace {

/// In standard deviations of the edges of a node: edges are evaluated again where a node has moved by `apart`, where J is
/// `small`. It grows with the square root of J, in fine passes up to there, in coarse passes by no more than `coarse`; these
/// also solve the tree downwards only where a separator has moved as far.
constexpr double apart = 0.007, small = 600.0, coarse = 10.0;
/// Where a pass predicts more than `slow` times the decrease of the pass before, the limit beyond which an edge is linearised
/// again is multiplied by `stricter`, and by `easier` after every step whose last pass does not.
constexpr double slow = 0.2, stricter = 0.1, easier = 1.5;
/// The same where edges were linearised again, more than `diverging` times. Where the predicted decrease grows `grows` times
/// then, although it is below `near` times J and the limit below `strict`, all edges get their second derivatives. These make
/// passes slow along directions that are hardly determined, so that they are not in the factor otherwise.
constexpr double diverging = 0.5, grows = 1.5, near = 1e-6, strict = 1e-4;
/// For so many passes second derivatives are convex once exact ones have made Omega indefinite.
constexpr int held = 3;
/// The part of the tolerance that coarse passes may cost, and the most work that is allowed, as a part of J.
constexpr double price = 0.3, most_work = 1e-3;
/// By so much the largest ratio of what coarse passes cost to the square of their work falls with each fine pass, and that of
/// the predictions of two passes with each step.
constexpr double forget = 0.9;
/// Passes end where one predicts that J falls by so many times itself.
constexpr double hopeless = 10.0;
/// What a further pass would predict, as a part of what this one predicts, is assumed to be no less.
constexpr double least_left = 0.3;

}  // namespace

OnlineSystem::Outcome OnlineSystem::advance(int& done, std::span<const Number> fresh, std::span<const Number> touched,
                                            std::span<const Triple> before) {
    Memory& m = memory_;
    const double size = std::min(std::max(std::sqrt(m.cost / small), 0.01), coarse);
    const double far = apart * size, close = apart * std::min(size, 1.0);
    bool fine = m.work > m.allowed, first = fine, renewed = false;
    double last = infinity;
    std::vector<Number> moved;
    m.shrinks *= forget;
    while (done < most_passes_) {
        if (m.hold > 0 && --m.hold == 0) m.bent.exact = usual_bent().exact;
        moved = std::move(pending_);
        pending_.clear();
        std::erase_if(moved, [&](Number node) { return !graph_.nodes[node].beyond(graph_.nodes[node].evaluated, close); });
        tree_.backward(graph_, fine ? -1.0 : far, fine ? close : far, moved);
        // edges are evaluated where both ends are exact
        if (!fine && !moved.empty()) tree_.solve_paths(graph_, homes_around(moved), far);
        Evaluation edges = evaluate_edges(moved);
        const double predicted = tree_.forward(graph_, edges.homes);
        // J cannot fall by more than itself: far from any minimum, undamped passes lead nowhere
        if (!(predicted < hopeless * m.cost + 1.0) || !std::isfinite(m.cost)) break;
        if (first) allow_work(predicted);
        first = false;
        // what is left after this pass, if the predictions of further ones shrink as slowly as lately
        m.shrinks = std::max({m.shrinks, std::min(predicted / last, 0.9), m.bent.convex == 0.0 ? 0.75 : 0.0});
        if (predicted * std::max(least_left, m.shrinks / (1 - m.shrinks)) <= tolerance_ * m.cost) {
            // what moves now is evaluated by the next step
            moved.clear();
            if (!edges.homes.empty()) tree_.backward(graph_, far, close, moved);
            pending_ = moved;
            if (predicted < slow * last) m.limit = std::min(Memory{}.limit, easier * m.limit);
            if (fine) return Outcome::done;
            m.work += work_of(fresh, touched, before);
            first = fine = m.work > m.allowed;
            if (!fine) return Outcome::done;
            last = infinity, renewed = false;
            ++done;
            continue;
        }
        if (predicted > (renewed ? diverging : slow) * last) {
            const bool closing = grows * last < predicted && predicted < near * m.cost;
            if (closing && renewed && m.hold == 0 && m.limit < strict && m.bent.convex > 0.0 &&
                m.bent.convex < infinity)
                m.bent.convex = 0.0;
            else  // slow passes: more of the edges have to be linearised where they are
                m.limit = std::max(stricter * m.limit, 1e-9);
        }
        last = predicted;
        const std::vector<Number> above = renew_priors(edges.outdated);
        renewed = !edges.late.empty() || !above.empty();
        ++done;
        while (renewed && !refactor(graph_, tree_, edges.late, above, m.bent, m.cost)) {
            if (m.hold > 0) return Outcome::indefinite;
            m.bent.exact = infinity;
            m.hold = held;
        }
    }
    done = most_passes_;
    return Outcome::unfinished;
}

void OnlineSystem::allow_work(double predicted) {
    Memory& m = memory_;
    if (m.work < infinity) {
        // what linear increments leave out grows with the square of the work
        const double work = std::max(m.work, 1e-9);
        m.rate = std::max(predicted / (work * work), forget * m.rate);
        m.allowed = std::min({std::sqrt(price * tolerance_ * m.cost / std::max(m.rate, 1e-30)), 2 * std::max(m.allowed, 1e-3),
                              most_work * m.cost});
    }
    m.work = 0.0;
}

// Twice the part of J by which the older edges have grown because of the edges `fresh`: the sum over these of the derivative of
// their cost, times the movement of their ends since the increments `before`.
double OnlineSystem::work_of(std::span<const Number> fresh, std::span<const Number> touched,
                             std::span<const Triple> before) const {
    const auto way = [&](Number number) -> Vector {
        const auto at = std::find(touched.begin(), touched.end(), number) - touched.begin();
        const Node& node = graph_.nodes[number];
        return {node.d[0] - before[at][0], node.d[1] - before[at][1], node.d[2] - before[at][2]};
    };
    double total = 0.0;
    for (const Number e : fresh) {
        const Edge& edge = graph_.edges[e];
        const Present now = linearize(graph_, edge);
        const Vector& g = now.g;
        const Vector a = way(edge.ends[0]), b = way(edge.ends[1]);
        total += g.x * a.x + g.y * a.y + (now.u.x * g.x + now.u.y * g.y + g.t) * a.t;
        total -= g.x * (now.c * b.x - now.s * b.y) + g.y * (now.s * b.x + now.c * b.y) + g.t * b.t;
    }
    return std::abs(total);
}

// Relative priors have no second derivatives in the factor. Those of the edges alone are of no use then: they sum up to nothing
// along a turn of many nodes only together with those of what pulls on the other side.
Bent OnlineSystem::usual_bent() const {
    return std::ranges::any_of(priors_, [](const Prior& prior) { return prior.relative; }) ? Bent::never() : Bent{};
}

/// Put the supernode of a node into a list, if it is not there yet.
void OnlineSystem::list_home(Number node, std::vector<Number>& homes) {
    list_supernode(graph_.nodes[node].home, homes);
}

void OnlineSystem::list_supernode(Number s, std::vector<Number>& supernodes) {
    if (tree_.groups[s].marked) return;
    tree_.groups[s].marked = true;
    supernodes.push_back(s);
}

std::vector<Number> OnlineSystem::homes_around(std::span<const Number> moved) {
    std::vector<Number> homes;
    for (const Number node : moved)
        for (Number e = graph_.nodes[node].edges; e >= 0;) {
            const Edge& edge = graph_.edges[e];
            const int side = edge.side(node);
            list_home(edge.ends[1 - side], homes);
            e = edge.next[side];
        }
    for (const Prior* prior : priors_around(moved))
        for (const Number member : prior->members) list_home(member, homes);
    for (const Number s : homes) tree_.groups[s].marked = false;
    return homes;
}

/// The relative priors of nodes. An absolute one is linear in the increments of points, and has to do with single poses else.
std::vector<Prior*> OnlineSystem::priors_around(std::span<const Number> moved) {
    std::vector<Prior*> found;
    if (priors_.empty() || moved.empty()) return found;
    const Stamp stamp = ++tree_.stamp;
    for (const Number node : moved) graph_.nodes[node].mark = stamp;
    for (Prior& prior : priors_)
        if (prior.relative && std::ranges::any_of(prior.members, [&](Number n) { return graph_.nodes[n].mark == stamp; }))
            found.push_back(&prior);
    return found;
}

/// Linearise priors where their nodes are; returns the supernodes above, which are to be factorised again.
std::vector<Number> OnlineSystem::renew_priors(std::span<Prior* const> priors) {
    std::vector<Number> above;
    for (Prior* const prior : priors) {
        prior->evaluate(graph_, true);
        write_prior(*prior, true);
        above.push_back(tree_.groups[prior->group].parent);
    }
    return above;
}

OnlineSystem::Evaluation OnlineSystem::evaluate_edges(std::span<const Number> moved) {
    Evaluation result;
    const Stamp stamp = ++tree_.stamp;
    for (const Number node : moved) graph_.nodes[node].evaluated = graph_.nodes[node].x;
    for (const Number node : moved)
        for (Number e = graph_.nodes[node].edges; e >= 0;) {
            Edge& edge = graph_.edges[e];
            if (edge.mark != stamp) {
                edge.mark = stamp;
                const auto [change, outdated] = evaluate(graph_, edge, memory_.limit, memory_.bent);
                memory_.cost += change;
                if (outdated) result.late.push_back(e);
                for (const Number end : edge.ends) list_home(end, result.homes);
            }
            e = edge.next[edge.side(node)];
        }
    for (Prior* prior : priors_around(moved)) {
        prior->evaluate(graph_, false);
        write_prior(*prior, false);
        list_supernode(tree_.groups[prior->group].parent, result.homes);
        if (prior->outdated(graph_)) result.outdated.push_back(prior);
    }
    for (const Number s : result.homes) tree_.groups[s].marked = false;
    return result;
}

bool OnlineSystem::iterate(std::span<const Number> newest, std::span<const Number> fresh, std::span<const Number> touched,
                           std::span<const Triple> before) {
    known_ = false;
    for (int done = 0;;) {
        const int earlier = done;
        const Outcome outcome = advance(done, fresh, touched, before);
        passes += done - earlier;
        if (outcome != Outcome::indefinite) return outcome == Outcome::done;
        memory_.bent.exact = memory_.work = infinity;
        memory_.hold = held;
        const std::vector<Number> every = graph_.live_nodes();
        if (!eliminate({every, {}, newest, {}})) return false;
    }
}

bool OnlineSystem::eliminate(const Changes& changes) {
    known_ = false;
    while (!rebuild(graph_, tree_, changes, memory_.bent, memory_.cost)) {
        if (memory_.hold > 0) return false;
        memory_.bent.exact = infinity;
        memory_.hold = held;
    }
    return true;
}

}  // namespace vmslam::online
