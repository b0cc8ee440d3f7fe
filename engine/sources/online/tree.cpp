#include "vmslam/online/tree.hpp"

#include <algorithm>

#include "sparse/supernode.hpp"
#include "vmslam/online/edge.hpp"

namespace vmslam::online {

using sparse::Index;
using sparse::Real3;

Supernode::Supernode(Id w, Id r) : w(w), r(r), nodes(w + r) {
    const Front f = front();
    numbers = Numbers(3 * (w * f.height + r * f.update_height + w + 2 * r));
    std::fill_n(y(), 3 * (w + 2 * r), 0.0);
    seen.resize(r);
}

void Tree::clear() {
    groups.clear();
    groups.resize(1);
    free_.clear();
    step = 1;
}

Id Tree::create(Id w, Id r) {
    if (free_.empty()) {
        groups.emplace_back(w, r);
        return static_cast<Id>(groups.size()) - 1;
    }
    const Id s = free_.back();
    free_.pop_back();
    groups[s] = Supernode(w, r);
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

double* Tree::work(Index rows) {
    if (work_.size() < rows) work_ = Numbers(2 * rows);
    return work_.data();
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
    Id place = 0;
    for (const Id node : parent.nodes) graph.nodes[node].local = place++;
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
            if (k + 1 < child.r && child.relative[k + 1] != child.relative[k] + 1) end = k + 1;
            child.run_end[k] = end;
        }
    }
    for (const Id node : parent.columns())
        for (Id e = graph.nodes[node].owned; e >= 0; e = graph.edges[e].next_owned) {
            Edge& edge = graph.edges[e];
            if (edge.taken_out()) continue;
            edge.place = graph.nodes[edge.ends[1 - edge.side(node)]].local;
            parent.absolute |= edge.one_ended();
        }
    for (const Id node : parent.nodes) graph.nodes[node].local = -1;
    for (Id k = parent.r - 1; k >= 0 && !parent.absolute; --k)
        if (!graph.nodes[parent.nodes[parent.w + k]].point) parent.frame = k;
}

namespace {

/// Add a symmetric block to a diagonal block.
void add_symmetric(double* t, Index h, const Symmetric& D) {
    t[0] += D.xx, t[1] += D.xy, t[2] += D.xt;
    t[h + 1] += D.yy, t[h + 2] += D.yt;
    t[2 * h + 2] += D.tt;
}

/// Add the update matrix of a child to the node columns `from` to `to` of the front of its parent, whose order may be another
/// one. Only the lower triangles are there. The first number of the target is that of node `from`.
void extend(Supernode& child, Id from, Id to, double* target, Index height) {
    const Index h = child.front().update_height;
    const auto place = [&](Id column, Id row) { return target + 3 * (column - from) * height + 3 * (row - from); };
    const auto inside = [=](Id column) { return from <= column && column < to; };
    for (Id j = 0; j < child.r; ++j) {
        const double* const source = child.update() + child.front().update_pad + 3 * j * h;
        const Id own = child.relative[j];
        if (child.ascending && !inside(own)) continue;
        for (Id i = j; i < child.r;) {
            const Id end = child.run_end[i];
            Id node = child.relative[i];
            if (node >= own && inside(own))
                sparse::add_rows<3>({place(own, node), height}, {source + 3 * i, h}, 3 * (end - i));
            // above the diagonal: the blocks are turned
            for (Id k = i; k < end && node < own; ++k, ++node) {
                if (!inside(node)) continue;
                double* const t = place(node, own);
                for (int c = 0; c < 3; ++c)
                    for (int r = 0; r < 3; ++r) t[r * height + c] += source[3 * k + r + c * h];
            }
            i = end;
        }
    }
}

}  // namespace

/// The blocks of the edges that its nodes own in the columns of a panel.
void Tree::put_entries(const Graph& graph, const Supernode& group, double* x) {
    const Front front = group.front();
    const Index h = front.height;
    for (Id q = 0; q < group.w; ++q) {
        const Id number = group.nodes[q];
        double* const column = x + 3 * q * h + front.pad;
        if (graph.nodes[number].point) column[3 * q + 2 * h + 2] += 1.0;
        for (Id e = graph.nodes[number].owned; e >= 0; e = graph.edges[e].next_owned) {
            const Edge& edge = graph.edges[e];
            if (edge.taken_out()) continue;
            const int side = edge.side(number);
            const Blocks own = diagonal_blocks(edge);
            add_symmetric(column + 3 * q, h, side == 0 ? own.first : own.second);
            if (edge.place < group.w)
                add_symmetric(x + 3 * edge.place * (h + 1) + front.pad, h, side == 0 ? own.second : own.first);
            const auto block = block_between(edge);
            double* const to = column + 3 * edge.place;
            for (int k = 0; k < 3; ++k)
                for (int i = 0; i < 3; ++i) to[side == 0 ? k * h + i : i * h + k] += block[3 * k + i];
        }
    }
}

/// Their blocks on the diagonal of the separator.
void Tree::put_separator_entries(const Graph& graph, const Supernode& group, double* update) {
    const Front front = group.front();
    for (const Id number : group.columns())
        for (Id e = graph.nodes[number].owned; e >= 0; e = graph.edges[e].next_owned) {
            const Edge& edge = graph.edges[e];
            if (edge.taken_out() || edge.place < group.w) continue;
            const Blocks own = diagonal_blocks(edge);
            add_symmetric(update + 3 * (edge.place - group.w) * (front.update_height + 1) + front.update_pad,
                          front.update_height, edge.side(number) == 0 ? own.second : own.first);
        }
}

bool Tree::factorize(Graph& graph, Id s) {
    Supernode& group = groups[s];
    const Front front = group.front();
    const Index h = front.height;
    double* const x = group.panel();
    const Index packing = sparse::packing<Real3>(group.w, h);
    if (packed_.empty() || packed_[0].size() < packing) packed_.assign(1, Numbers(2 * packing));
    const sparse::Panel<Real3> panel{x, front, packed_};
    std::memset(x, 0, 3 * group.w * h * sizeof(double));
    put_entries(graph, group, x);
    double* const limits = work(3 * group.w);
    for (Index k = 0; k < 3 * group.w; ++k)
        limits[k] = std::max(0.0, pivot_tolerance * graph.nodes[group.nodes[k / 3]].diagonal[k % 3]);
    for (Id c = group.child; c > 0; c = groups[c].sibling) extend(groups[c], 0, group.w, x + front.pad, h);
    if (panel.factorize(limits) >= 0) return false;
    if (group.r == 0) return true;
    // only the columns are needed before the factorisation, so the update matrix is written by the product and never cleared
    double* const update = group.update();
    panel.update_matrix(update);
    put_separator_entries(graph, group, update);
    for (Id c = group.child; c > 0; c = groups[c].sibling)
        extend(groups[c], group.w, group.w + group.r, update + front.update_pad, front.update_height);
    // what is above the diagonal there has no meaning, and enters sums as zero
    for (Id j = 0; j < 3 * group.r; ++j) {
        double* const column = update + j * front.update_height;
        const Index row = front.update_pad + j;
        std::fill(column + sparse::group_of(front.update_pad + j / 3 * 3), column + row, 0.0);
    }
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
            tree.evaluate(graph, s, found);
        else
            tree.rest(graph, s);
    }
    return good;
}

}  // namespace vmslam::online
