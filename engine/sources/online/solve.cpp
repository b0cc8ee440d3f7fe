// Passes through the tree: forward where right-hand sides changed, backward where the solution changes.
#include <algorithm>
#include <cstring>

#include "sparse/supernode.hpp"
#include "vmslam/online/tree.hpp"

namespace vmslam::online {

using sparse::Place;
using sparse::Real3;
using Part = Real3::Part;

double Tree::forward(const Graph& graph, Number s) {
    Supernode& group = groups[s];
    const Front front = group.front();
    double* const b = work(front.height);
    std::memset(b, 0, front.height * sizeof(double));
    double* at = b + front.pad;
    for (const Number node : group.columns()) at = std::copy_n(graph.nodes[node].rhs.data(), 3, at);
    for (Number c = group.child; c > 0; c = groups[c].sibling) {
        Supernode& child = groups[c];
        const double* const carry = child.carry();
        for (Number q = 0; q < child.r; ++q) {
            double* const to = b + front.pad + 3 * child.relative[q];
            for (int k = 0; k < 3; ++k) to[k] += carry[3 * q + k];
        }
    }
    double change = 0.0;
    double* const y = group.y();
    sparse::solve_forward<Real3>(front, group.panel(), b, 0, [&](Place j, const Part& part) {
        for (int k = 0; k < 3; ++k) {
            const double away = part.v[k] - y[3 * j + k];
            change += away * away;
            y[3 * j + k] = part.v[k];
        }
    });
    std::copy_n(b + front.pad + 3 * group.w, 3 * group.r, group.carry());
    return change;
}

double Tree::forward(const Graph& graph, std::span<const Number> homes) {
    double change = 0.0;
    for (const Number s : upwards(homes)) {
        change += forward(graph, s);
        groups[s].changed = true;
    }
    return change;
}

void Tree::backward(Graph& graph, Number s) {
    Supernode& group = groups[s];
    const Front front = group.front();
    double* const a = work(front.height);
    // rows that are not known yet are zero, so that the unused part of the panel does not enter the sums
    std::memset(a, 0, (front.pad + 3 * group.w) * sizeof(double));
    double* at = a + front.pad + 3 * group.w;
    for (const Number node : group.separator()) at = std::copy_n(graph.nodes[node].d.data(), 3, at);
    const double* const y = group.y();
    const auto get = [y](Place j) { return Part{y[3 * j], y[3 * j + 1], y[3 * j + 2]}; };
    sparse::solve_backward<Real3>(front, group.panel(), a, 0, get,
                                  [a](Place, Place row, const Part& part) { std::copy_n(part.v, 3, a + row); });
    at = a + front.pad;
    for (const Number number : group.columns()) {
        Node& node = graph.nodes[number];
        if (node.changed != step) {
            node.changed = step;
            node.kept = node.x;
        }
        double dx = at[0] - node.d[0], dy = at[1] - node.d[1];
        if (!node.point) {
            const auto [c, t] = node.axes;
            const double ahead = dx;
            dx = c * ahead - t * dy;
            dy = t * ahead + c * dy;
            node.x[2] += at[2] - node.d[2];
            node.axes = Rotation(node.x[2]);
        }
        node.x[0] += dx;
        node.x[1] += dy;
        std::copy_n(at, 3, node.d.data());
        at += 3;
    }
}

void Tree::backward(Graph& graph, double share, double apart, std::vector<Number>& moved) {
    ++stamp;
    std::vector<Number> stack{0};
    while (!stack.empty()) {
        const Number s = stack.back();
        stack.pop_back();
        if (s > 0) {
            backward(graph, s);
            for (const Number number : groups[s].columns()) {
                Node& node = graph.nodes[number];
                if (node.beyond(node.passed, share)) {
                    node.mark = stamp;
                    node.passed = node.x;
                }
                if (node.beyond(node.evaluated, apart)) moved.push_back(number);
            }
            groups[s].changed = false;
        }
        for (Number c = groups[s].child; c > 0; c = groups[c].sibling) {
            const Supernode& child = groups[c];
            if (child.w == 0) continue;
            bool visit = share < 0 || child.changed;
            for (const Number node : child.separator()) {
                if (visit) break;
                visit = graph.nodes[node].mark == stamp;
            }
            if (visit) stack.push_back(c);
        }
    }
}

void Tree::solve_paths(Graph& graph, std::span<const Number> homes, double share) {
    const std::vector<Number> path = upwards(homes);
    for (auto s = path.rbegin(); s != path.rend(); ++s) {
        backward(graph, *s);
        Supernode& group = groups[*s];
        for (const Number number : group.columns()) {
            if (group.changed) break;
            group.changed = graph.nodes[number].beyond(graph.nodes[number].passed, share);
        }
    }
    for (const Number s : path)
        if (groups[s].changed) groups[groups[s].parent].changed = true;
}

// With the unit vectors E of the nodes, it is Y' Y, L Y = E. The columns of Y are zero beside the paths from their nodes to the
// roots, so that they are solved forward on these only.
std::vector<double> Tree::covariance(Graph& graph, std::span<const Number> nodes) {
    std::vector<Number> homes;
    for (const Number node : nodes) homes.push_back(graph.nodes[node].home);
    const std::vector<Number> path = upwards(homes);
    // separators of the path lie on it
    Number columns = 0;
    for (const Number s : path)
        for (const Number node : groups[s].columns()) graph.nodes[node].local = columns++;
    const Place rows = 3 * columns;
    const std::size_t size = 3 * nodes.size();
    std::vector<double> Y(size * rows, 0.0), covariance(size * size);
    std::vector<Triple> b(columns, Triple{});
    const auto part_of = [&](Number node) -> Triple& { return b[graph.nodes[node].local]; };
    for (std::size_t column = 0; column < size; ++column) {
        const Node& node = graph.nodes[nodes[column / 3]];
        // a unit vector of the world in the axes of the node
        const double c = node.point ? 1.0 : node.axes.c, t = node.point ? 0.0 : node.axes.s;
        const int axis = static_cast<int>(column % 3);
        part_of(nodes[column / 3]) = axis == 0 ? Triple{c, -t, 0.0} : axis == 1 ? Triple{t, c, 0.0} : Triple{0.0, 0.0, 1.0};
        double* y = Y.data() + column * rows;
        bool begun = false;
        for (const Number s : path) {
            Supernode& group = groups[s];
            begun = begun || s == node.home;
            bool some = false;
            for (const Number inner : begun ? group.columns() : std::span<const Number>{}) some |= part_of(inner) != Triple{};
            if (some) {
                const Front front = group.front();
                double* const part = work(front.height);
                std::memset(part, 0, front.pad * sizeof(double));
                double* at = part + front.pad;
                for (const Number inner : group.nodes) at = std::copy_n(part_of(inner).data(), 3, at);
                sparse::solve_forward<Real3>(front, group.panel(), part, 0,
                                             [y](Place j, const Part& solved) { std::copy_n(solved.v, 3, y + 3 * j); });
                at = part + front.pad + 3 * group.w;
                for (const Number inner : group.columns()) part_of(inner) = {};
                for (const Number inner : group.separator()) {
                    std::copy_n(at, 3, part_of(inner).data());
                    at += 3;
                }
            }
            y += 3 * group.w;
        }
    }
    for (const Number s : path)
        for (const Number node : groups[s].columns()) graph.nodes[node].local = -1;
    for (std::size_t i = 0; i < size; ++i)
        for (std::size_t j = 0; j <= i; ++j) {
            double total = 0.0;
            for (Place q = 0; q < rows; ++q) total += Y[i * rows + q] * Y[j * rows + q];
            covariance[i * size + j] = covariance[j * size + i] = total;
        }
    return covariance;
}

}  // namespace vmslam::online
