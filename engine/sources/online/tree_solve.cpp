// Passes through the tree: down where the solution moves nodes, and up where their edges were evaluated.
#include <algorithm>
#include <cmath>
#include <cstring>

#include "sparse/supernode.hpp"
#include "vmslam/online/edge.hpp"
#include "vmslam/online/tree.hpp"

namespace vmslam::online {

using sparse::Index;
using sparse::Real3;
using Part = Real3::Part;

namespace {

/// The rotation from b to a.
Rotation between(const Rotation& a, const Rotation& b) { return {a.c * b.c + a.s * b.s, b.c * a.s - b.s * a.c}; }
Lever turned(const Rotation& r, double x, double y) { return {r.c * x - r.s * y, r.s * x + r.c * y}; }
Lever turned_back(const Rotation& r, double x, double y) { return {r.c * x + r.s * y, r.c * y - r.s * x}; }

/// A node as another one sees it.
Seen seen_from(const Node& frame, const Node& node) {
    const Lever at = turned_back(frame.axes, node.x[0] - frame.x[0], node.x[1] - frame.x[1]);
    return {at.x, at.y, node.x[2] - frame.x[2], between(node.axes, frame.axes)};
}
Seen value_of(const Node& node) { return {node.x[0], node.x[1], node.x[2], node.axes}; }
bool all_zero(const double* x, std::size_t count) {
    return std::all_of(x, x + count, [](double each) { return each == 0.0; });
}

/// The frame of a supernode now and at its last evaluation: the world where it has none.
struct Frame {
    const Node& now;
    const Seen& then;
};
Frame frame_of(const Graph& graph, const Supernode& group) {
    static const Node world;
    static const Seen origin{};
    if (group.frame < 0) return {world, origin};
    return {graph.nodes[group.separator()[group.frame]], group.seen[group.frame]};
}

}  // namespace

const double* Tree::motion(const Graph& graph, const Supernode& group) {
    const Front front = group.front();
    std::fill_n(at_least(motion_, front.update_height + 1), front.update_height, 0.0);
    double* const all = motion_.data() + front.update_pad;
    const Frame frame = frame_of(graph, group);
    for (Id k = 0; k < group.r; ++k) {
        if (k == group.frame) continue;
        const Node& node = graph.nodes[group.separator()[k]];
        const Seen now = seen_from(frame.now, node), &then = group.seen[k];
        // the axes of a pose at that time, or those of the world, as the frame saw them
        const Rotation axes = node.point ? frame.then.axes.inverse() : then.axes;
        const Lever way = turned_back(axes, now.x - then.x, now.y - then.y);
        double* const m = all + group.begin_of(k);
        m[0] = way.x, m[1] = way.y;
        if (!node.point) m[2] = now.angle - then.angle;
    }
    return all;
}

const double* Tree::predict(Supernode& group, const double* m) {
    using sparse::lanes, sparse::load, sparse::store;
    const Front front = group.front();
    const Index h = front.update_height, pad = front.update_pad;
    double* const pull = at_least(pull_, h + 1);
    std::fill_n(pull, h, 0.0);
    // each block of the lower triangle, and of the upper one, which is not there
    for (Index j = 0; j < front.r; ++j) {
        const double *const x = group.update() + 3 * j * h, *const by = m + 3 * j;
        sparse::Vector<lanes> s0{}, s1{}, s2{};
        for (Index i = sparse::group_of(pad + 3 * j); i < h; i += lanes) {
            const auto v = load<lanes>(m - pad + i), x0 = load<lanes>(x + i), x1 = load<lanes>(x + h + i),
                       x2 = load<lanes>(x + 2 * h + i);
            store<lanes>(pull + i, load<lanes>(pull + i) + x0 * by[0] + x1 * by[1] + x2 * by[2]);
            s0 += x0 * v, s1 += x1 * v, s2 += x2 * v;
        }
        const double* const d = x + pad + 3 * j;
        double* const own = pull + pad + 3 * j;
        own[0] += sparse::sum<lanes>(s0) - d[0] * by[0];
        own[1] += sparse::sum<lanes>(s1) - d[h + 1] * by[1];
        own[2] += sparse::sum<lanes>(s2) - d[2 * h + 2] * by[2];
    }
    group.separator_change = 0.0;
    for (Index j = 0; j < 3 * front.r; ++j) group.separator_change += m[j] * pull[pad + j];
    // exact second derivatives may make U indefinite, and J then falls with the motion
    group.separator_change = std::abs(group.separator_change);
    return pull + pad;
}

void Tree::follow(const Graph& graph, Supernode& group, const double* pull) {
    const Frame frame = frame_of(graph, group);
    // the pull of the frame takes what the others have lost
    double x = 0.0, y = 0.0, torque = 0.0;
    for (Id k = 0; k < group.r; ++k) {
        if (k == group.frame) continue;
        const Node& node = graph.nodes[group.separator()[k]];
        const Seen now = seen_from(frame.now, node), &then = group.seen[k];
        const double *const f = group.pull_then() + group.begin_of(k), *const p = pull + group.begin_of(k);
        double* const to = group.pull_now() + group.begin_of(k);
        const Rotation axes_then = node.point ? frame.then.axes.inverse() : then.axes;
        const Rotation axes_now = node.point ? frame.now.axes.inverse() : now.axes;
        // in the axes of the frame
        const Lever before = turned(axes_then, f[0], f[1]), change = turned(axes_then, p[0], p[1]);
        const Lever after{before.x - change.x, before.y - change.y}, own = turned_back(axes_now, after.x, after.y);
        to[0] = own.x, to[1] = own.y;
        if (!node.point) to[2] = f[2] - p[2];
        x += change.x;
        y += change.y;
        torque += (node.point ? 0.0 : p[2]) - now.x * after.y + now.y * after.x + then.x * before.y - then.y * before.x;
    }
    if (group.frame < 0) return;
    const double* const f = group.pull_then() + group.begin_of(group.frame);
    double* const own = group.pull_now() + group.begin_of(group.frame);
    own[0] = f[0] + x, own[1] = f[1] + y, own[2] = f[2] + torque;
}

void Tree::follow(const Graph& graph, Id s) {
    Supernode& group = groups[s];
    if (group.w > 0) follow(graph, group, predict(group, motion(graph, group)));
}

void Tree::move(Graph& graph, Supernode& group, const double* m) {
    const Front front = group.front();
    double* const a = at_least(work_, front.height);
    // rows that are not known yet are zero, so that the unused part of the panel does not enter the sums
    std::memset(a, 0, (front.pad + 3 * front.w) * sizeof(double));
    std::copy_n(m, 3 * front.r, a + front.pad + 3 * front.w);
    const double* const y = group.y();
    const auto get = [y](Index j) { return Part{y[3 * j], y[3 * j + 1], y[3 * j + 2]}; };
    sparse::solve_backward<Real3>(front, group.panel(), a, 0, get,
                                  [a](Index, Index row, const Part& part) { std::copy_n(part.v, 3, a + row); });
    // the nodes move along with the frame, and from there by a
    const Frame frame = frame_of(graph, group);
    const Rotation turn = between(frame.now.axes, frame.then.axes);
    // where nothing moves, sums would change the last digits, and those of a saved system with them
    const bool still = frame.now.x == Triple{frame.then.x, frame.then.y, frame.then.angle} && all_zero(m, 3 * front.r) &&
                       all_zero(y, 3 * group.wide);
    for (Id q = 0; q < group.w; ++q) {
        Node& node = graph.nodes[group.nodes[q]];
        node.keep(step);
        if (still) {
            node.x = node.base;
            node.axes = node.base_axes;
            continue;
        }
        const Rotation axes = node.point ? turn : between(node.base_axes, turn.inverse());
        const double* const own = a + front.pad + group.row[q];
        const Lever along = turned(turn, node.base[0] - frame.then.x, node.base[1] - frame.then.y);
        const Lever way = turned(axes, own[0], own[1]);
        node.x[0] = frame.now.x[0] + along.x + way.x;
        node.x[1] = frame.now.x[1] + along.y + way.y;
        if (node.point) continue;
        node.x[2] = node.base[2] + (frame.now.x[2] - frame.then.angle) + own[2];
        node.axes = Rotation(node.x[2]);
    }
}

void Tree::move(Graph& graph, Id s) {
    Supernode& group = groups[s];
    move(graph, group, motion(graph, group));
}

void Tree::move_paths(Graph& graph, std::span<const Id> homes) {
    const std::vector<Id> path = upwards(homes);
    for (auto s = path.rbegin(); s != path.rend(); ++s) move(graph, *s);
}

void Tree::move_all(Graph& graph) { descend(graph, -1.0); }

void Tree::stay() {
    for (Supernode& group : groups) {
        std::fill_n(group.y(), 3 * group.wide, 0.0);
        group.largest_decrease = 0.0;
    }
}

Tree::Moved Tree::descend(Graph& graph, double least) {
    Moved moved;
    std::vector<Id> stack{0};
    while (!stack.empty()) {
        const Id s = stack.back();
        stack.pop_back();
        if (s > 0) moved.supernodes.push_back(s);
        for (Id c = groups[s].child; c > 0; c = groups[c].sibling) {
            Supernode& child = groups[c];
            if (child.w == 0) {
                if (s > 0) moved.priors.push_back(c);
                continue;
            }
            const double* const m = motion(graph, child);
            if (s > 0 && child.largest_decrease <= least) {
                const double* const pull = predict(child, m);
                if (child.separator_change * child.largest_squares <= least) {
                    follow(graph, child, pull);
                    continue;
                }
            }
            move(graph, child, m);
            stack.push_back(c);
        }
    }
    return moved;
}

void Tree::rest(Graph& graph, Id s) {
    Supernode& group = groups[s];
    for (const Id number : group.columns()) {
        Node& node = graph.nodes[number];
        node.base = node.x;
        node.base_axes = node.axes;
    }
    for (Id k = 0; k < group.r; ++k) {
        const Node& node = graph.nodes[group.separator()[k]];
        group.seen[k] = k == group.frame ? value_of(node) : seen_from(frame_of(graph, group).now, node);
    }
    std::fill_n(group.y(), 3 * group.wide, 0.0);
    group.separator_change = group.largest_decrease = 0.0;
    group.largest_squares = 1.0;
}

void Tree::evaluate_edges(Graph& graph, Id s, Evaluation& found) {
    rest(graph, s);
    Supernode& group = groups[s];
    double* const at = group.own_pull();
    std::fill_n(at, 3 * (group.wide + group.tall), 0.0);
    group.own_squares = 1.0;
    for (Id q = 0; q < group.w; ++q)
        each_owned(graph, group.nodes[q], [&](Id e, Edge& edge, int side) {
            const Evaluated now = online::evaluate(graph, edge, found.limit, found.bent);
            found.change += now.change;
            group.own_squares = std::max(group.own_squares, edge.squares);
            if (now.outdated) found.late.push_back(e);
            const auto add = [&](Id row, int end) {
                for (int p = 0; p < graph.nodes[edge.ends[end]].size(); ++p) at[row + p] += now.pulls.ends[end][p];
            };
            add(group.row[q], side);
            add(edge.place, 1 - side);
        });
}

void Tree::solve_forward(Id s, Evaluation& found) {
    Supernode& group = groups[s];
    const Front front = group.front();
    double* const b = at_least(work_, front.height);
    double* const at = b + front.pad;
    std::memset(b, 0, front.pad * sizeof(double));
    std::copy_n(group.own_pull(), 3 * (group.wide + group.tall), at);
    group.largest_decrease = 0.0;
    group.largest_squares = group.own_squares;
    for (Id c = group.child; c > 0; c = groups[c].sibling) {
        Supernode& child = groups[c];
        const double* const pull_now = child.pull_now();
        for (Id q = 0; q < child.r; ++q)
            for (Id k = 0; k < child.size_of(q); ++k) at[child.relative[q] + k] += pull_now[child.begin_of(q) + k];
        group.largest_decrease = std::max(group.largest_decrease, child.largest_decrease);
        group.largest_squares = std::max(group.largest_squares, child.largest_squares);
    }
    double square = 0.0;
    double* const y = group.y();
    sparse::solve_forward<Real3>(front, group.panel(), b, 0, [&](Index j, const Part& part) {
        for (int k = 0; k < 3; ++k) {
            square += part.v[k] * part.v[k];
            y[3 * j + k] = part.v[k];
        }
    });
    std::copy_n(at + 3 * front.w, 3 * front.r, group.pull_then());
    std::copy_n(at + 3 * front.w, 3 * front.r, group.pull_now());
    group.largest_decrease = std::max(group.largest_decrease, square);
    found.predicted += square;
}

// With the unit vectors E of the nodes, it is Y' Y, L Y = E. The columns of Y are zero beside the paths from their nodes to
// the roots, so that they are solved forward on these only.
std::vector<double> Tree::covariance(Graph& graph, std::span<const Id> nodes) {
    std::vector<Id> homes;
    for (const Id node : nodes) homes.push_back(graph.nodes[node].home);
    const std::vector<Id> path = upwards(homes);
    // separators of the path lie on it
    Id rows = 0;
    for (const Id s : path) {
        const Supernode& group = groups[s];
        for (Id q = 0; q < group.w; ++q) graph.nodes[group.nodes[q]].local = rows + group.row[q];
        rows += 3 * group.wide;
    }
    const std::size_t size = 3 * nodes.size();
    std::vector<double> Y(size * rows, 0.0), covariance(size * size), b(rows, 0.0);
    const auto numbers_of = [&](Id node) {
        const Node& of = graph.nodes[node];
        return std::span(b).subspan(of.local, of.size());
    };
    for (std::size_t column = 0; column < size; ++column) {
        const Id number = nodes[column / 3];
        const Node& node = graph.nodes[number];
        // a unit vector of the world in the axes of the node; a point has no third number
        const double c = node.point ? 1.0 : node.axes.c, t = node.point ? 0.0 : node.axes.s;
        const int axis = static_cast<int>(column % 3);
        const Triple unit = axis == 0 ? Triple{c, -t, 0.0} : axis == 1 ? Triple{t, c, 0.0} : Triple{0.0, 0.0, 1.0};
        std::copy_n(unit.begin(), node.size(), numbers_of(number).begin());
        double* y = Y.data() + column * rows;
        bool begun = false;
        for (const Id s : path) {
            Supernode& group = groups[s];
            begun = begun || s == node.home;
            bool some = false;
            for (const Id inner : begun ? group.columns() : std::span<const Id>{})
                some |= std::ranges::any_of(numbers_of(inner), [](double x) { return x != 0.0; });
            if (some) {
                const Front front = group.front();
                double* const part = at_least(work_, front.height);
                std::memset(part, 0, front.height * sizeof(double));
                double* const at = part + front.pad;
                for (Id k = 0; k < group.w + group.r; ++k) std::ranges::copy(numbers_of(group.nodes[k]), at + group.row[k]);
                sparse::solve_forward<Real3>(front, group.panel(), part, 0,
                                             [y](Index j, const Part& solved) { std::copy_n(solved.v, 3, y + 3 * j); });
                for (const Id inner : group.columns()) std::ranges::fill(numbers_of(inner), 0.0);
                for (Id k = group.w; k < group.w + group.r; ++k) {
                    const auto numbers = numbers_of(group.nodes[k]);
                    std::copy_n(at + group.row[k], numbers.size(), numbers.begin());
                }
            }
            y += 3 * group.wide;
        }
    }
    for (const Id s : path)
        for (const Id node : groups[s].columns()) graph.nodes[node].local = -1;
    for (std::size_t i = 0; i < size; ++i)
        for (std::size_t j = 0; j <= i; ++j) {
            double total = 0.0;
            for (Index q = 0; q < rows; ++q) total += Y[i * rows + q] * Y[j * rows + q];
            covariance[i * size + j] = covariance[j * size + i] = total;
        }
    return covariance;
}

}  // namespace vmslam::online
