#include "vmslam/online/tree.hpp"

#include <algorithm>

#include "sparse/supernode.hpp"
#include "vmslam/online/edge.hpp"

namespace vmslam::online {

using sparse::Index;
using sparse::Real3;

Supernode::Supernode(const Graph& graph, std::vector<Id> of, Id w)
    : w(w), r(static_cast<Id>(of.size()) - w), nodes(std::move(of)), row(nodes.size() + 1), seen(r) {
    const auto blocks = [&](Id from, Id to, Id begin) {
        Id end = begin;
        for (Id k = from; k < to; ++k) row[k] = end, end += graph.nodes[nodes[k]].size();
        row[to] = end;
        return (end - begin + 2) / 3;
    };
    wide = blocks(0, w, 0);
    tall = blocks(w, w + r, 3 * wide);
    const Front f = front();
    numbers = Numbers(3 * (wide * f.height + tall * f.update_height + 2 * wide + 3 * tall));
    std::fill_n(y(), 3 * (wide + 2 * tall), 0.0);
}

void Tree::clear() {
    groups.clear();
    groups.resize(1);
    free_.clear();
    step = 1;
}

Id Tree::create(const Graph& graph, std::vector<Id> nodes, Id w) {
    if (free_.empty()) {
        groups.emplace_back(graph, std::move(nodes), w);
        return static_cast<Id>(groups.size()) - 1;
    }
    const Id s = free_.back();
    free_.pop_back();
    groups[s] = Supernode(graph, std::move(nodes), w);
    return s;
}

void Tree::release(Id s) {
    groups[s] = Supernode();
    free_.push_back(s);
}

void Tree::take_back(std::span<const Id> created, std::size_t size_before) {
    for (auto s = created.rbegin(); s != created.rend(); ++s)
        if (*s < static_cast<Id>(size_before)) release(*s);
    groups.resize(size_before);
}

void Tree::hang(Id s, Id parent) {
    groups[s].parent = parent;
    groups[s].sibling = groups[parent].child;
    groups[parent].child = s;
}

std::ptrdiff_t Tree::numbers() const {
    std::ptrdiff_t total = 0;
    for (const Supernode& group : groups) total += group.numbers.size();
    return total;
}

std::vector<Id> Tree::upwards(std::span<const Id> homes) {
    std::vector<Id> path, chains, order;
    for (Id s : homes) {
        if (groups[s].marked) continue;
        chains.push_back(static_cast<Id>(path.size()));
        for (; s > 0 && !groups[s].marked; s = groups[s].parent) {
            groups[s].marked = true;
            path.push_back(s);
        }
    }
    // a chain ends below a supernode of an earlier chain, so the last one comes first
    order.reserve(path.size());
    auto end = path.end();
    for (auto chain = chains.rbegin(); chain != chains.rend(); ++chain) {
        order.insert(order.end(), path.begin() + *chain, end);
        end = path.begin() + *chain;
    }
    for (const Id s : order) groups[s].marked = false;
    return order;
}

void Tree::relate_children(Graph& graph, Id s) {
    Supernode& parent = groups[s];
    for (Id k = 0; k < parent.w + parent.r; ++k) graph.nodes[parent.nodes[k]].local = parent.row[k];
    for (Id c = parent.child; c > 0; c = groups[c].sibling) {
        Supernode& child = groups[c];
        child.relative.resize(child.r);
        child.run_end.resize(child.r);
        child.ascending = true;
        parent.absolute |= child.absolute;
        for (Id k = 0; k < child.r; ++k) {
            child.relative[k] = graph.nodes[child.nodes[child.w + k]].local;
            child.ascending &= k == 0 || child.relative[k] > child.relative[k - 1];
        }
        for (Id k = child.r - 1, end = child.r; k >= 0; --k) {
            if (k + 1 < child.r && child.relative[k + 1] != child.relative[k] + child.size_of(k)) end = k + 1;
            child.run_end[k] = end;
        }
    }
    for (const Id node : parent.columns())
        each_owned(graph, node, [&](Id, Edge& edge, int side) {
            edge.place = graph.nodes[edge.ends[1 - side]].local;
            parent.absolute |= edge.one_ended();
        });
    for (const Id node : parent.nodes) graph.nodes[node].local = -1;
    for (Id k = parent.r - 1; k >= 0 && !parent.absolute; --k)
        if (!graph.nodes[parent.nodes[parent.w + k]].point) parent.frame = k;
}

namespace {

/// Add a symmetric block, or for a point its part for the place, to a diagonal block.
void add_symmetric(double* t, Index h, const Symmetric& D, bool point) {
    t[0] += D.xx, t[1] += D.xy;
    t[h + 1] += D.yy;
    if (!point) t[2] += D.xt, t[h + 2] += D.yt, t[2 * h + 2] += D.tt;
}

/// Add the update matrix of a child to the columns `from` to `to` of the front of its parent, whose order may be another one.
/// Only the lower triangles are there. The first number of the target is that of column and row `from`.
void extend(Supernode& child, Index from, Index to, double* target, Index height) {
    const Index h = child.front().update_height;
    const auto place = [&](Index column, Index row) { return target + (column - from) * height + (row - from); };
    const auto inside = [=](Index column) { return from <= column && column < to; };
    for (Id j = 0; j < child.r; ++j) {
        const double* const source = child.update() + child.front().update_pad + child.begin_of(j) * h;
        const Id own = child.relative[j], columns = child.size_of(j);
        if (child.ascending && !inside(own)) continue;
        for (Id i = j; i < child.r;) {
            const Id end = child.run_end[i];
            if (child.relative[i] >= own && inside(own)) {
                const sparse::Columns to_rows{place(own, child.relative[i]), height};
                const sparse::ConstColumns from_rows{source + child.begin_of(i), h};
                const Index rows = child.begin_of(end) - child.begin_of(i);
                columns == 3 ? sparse::add_rows<3>(to_rows, from_rows, rows) : sparse::add_rows<2>(to_rows, from_rows, rows);
            }
            // above the diagonal: the blocks are turned
            for (Id k = i; k < end && child.relative[k] < own; ++k) {
                if (!inside(child.relative[k])) continue;
                double* const t = place(child.relative[k], own);
                const double* const block = source + child.begin_of(k);
                for (int c = 0; c < columns; ++c)
                    for (int r = 0; r < child.size_of(k); ++r) t[r * height + c] += block[r + c * h];
            }
            i = end;
        }
    }
}

}  // namespace

/// The blocks of the edges that its nodes own in the columns of a panel. Those on the diagonal of the separator are for the
/// update matrix, and are summed by the number at which the node begins.
void Tree::put_entries(const Graph& graph, const Supernode& group, double* x, std::span<Symmetric> of_separator) {
    const Front front = group.front();
    const Index h = front.height;
    Index used = 0;
    for (Id q = 0; q < group.w; ++q) {
        const Id number = group.nodes[q];
        double* const column = x + group.row[q] * h + front.pad;
        used = group.row[q] + graph.nodes[number].size();
        each_owned(graph, number, [&](Id, const Edge& edge, int side) {
            const Blocks own = diagonal_blocks(edge);
            const Symmetric& other = side == 0 ? own.second : own.first;
            const Node &first = graph.nodes[edge.ends[0]], &second = graph.nodes[edge.ends[1]];
            add_symmetric(column + group.row[q], h, side == 0 ? own.first : own.second, graph.nodes[number].point);
            if (edge.place < 3 * group.wide)
                add_symmetric(x + edge.place * (h + 1) + front.pad, h, other, (side == 0 ? second : first).point);
            else
                of_separator[edge.place - 3 * group.wide] = of_separator[edge.place - 3 * group.wide] + other;
            const auto block = block_between(edge);
            double* const to = column + edge.place;
            for (int k = 0; k < first.size(); ++k)
                for (int i = 0; i < second.size(); ++i) to[side == 0 ? k * h + i : i * h + k] += block[3 * k + i];
        });
    }
    for (; used < 3 * group.wide; ++used) x[used * (h + 1) + front.pad] = 1.0;
}

bool Tree::factorize(Graph& graph, Id s) {
    Supernode& group = groups[s];
    const Front front = group.front();
    const Index h = front.height;
    double* const x = group.panel();
    const Index own = 3 * front.w, all = own + 3 * front.r;
    const Index packing = sparse::packing<Real3>(front.w, h);
    at_least(packed_[0], packing);
    const sparse::Panel<Real3> panel{x, front, packed_};
    std::memset(x, 0, own * h * sizeof(double));
    of_separator_.assign(3 * front.r, {});
    put_entries(graph, group, x, of_separator_);
    double* const limits = at_least(work_, own);
    std::fill_n(limits, own, 0.0);
    for (Id q = 0; q < group.w; ++q) {
        const Node& node = graph.nodes[group.nodes[q]];
        for (int c = 0; c < node.size(); ++c) limits[group.row[q] + c] = std::max(0.0, pivot_tolerance * node.diagonal[c]);
    }
    for (Id c = group.child; c > 0; c = groups[c].sibling) extend(groups[c], 0, own, x + front.pad, h);
    if (panel.factorize(limits) >= 0) return false;
    if (group.r == 0) return true;
    // only the columns are needed before the factorisation, so the update matrix is written by the product and never cleared
    double* const update = group.update();
    panel.update_matrix(update);
    for (Id k = 0; k < group.r; ++k)
        add_symmetric(update + group.begin_of(k) * (front.update_height + 1) + front.update_pad, front.update_height,
                      of_separator_[group.begin_of(k)], group.size_of(k) == 2);
    for (Id c = group.child; c > 0; c = groups[c].sibling)
        extend(groups[c], own, all, update + front.update_pad, front.update_height);
    // it enters sums
    panel.clear_above_diagonal(update);
    return true;
}

bool refactor(Graph& graph, Tree& tree, std::span<const Id> late, std::span<const Id> others, Evaluation& found) {
    std::vector<Id> homes(others.begin(), others.end());
    homes.reserve(others.size() + late.size());
    for (const Id e : late) {
        relinearize(graph, graph.edges[e], found.bent);
        homes.push_back(graph.nodes[graph.edges[e].owner].home);
    }
    bool good = true;
    for (const Id s : tree.upwards(homes)) {
        good = good && tree.factorize(graph, s);
        if (good)
            tree.solve_forward(s, found);
        else
            tree.rest(graph, s);
    }
    return good;
}

}  // namespace vmslam::online
