#include "vmslam/sparse/factor.hpp"

#include <algorithm>
#include <cmath>

#include "panel.hpp"
#include "parallel.hpp"

namespace vmslam::sparse {
namespace {

/// Nodes of a wide panel that are factorised before the rest is updated at once; the update of the rest of a wider panel is
/// large enough to copy its operands.
constexpr Step inner = 16, outer = 64;

/// A panel in work: its numbers, its front, and scratch for products for each of the threads that may work on it.
template <class Block>
struct Panel {
    double* x;
    Front front;
    std::span<Numbers> scratch;

    double* packed() const { return scratch[0].data(); }

    /// work(from, to, packed) for all of `nodes` node columns, on several threads where the flops are worth it. Every number is
    /// computed as on one thread.
    template <class Work>
    void share(Step nodes, Step rows, Step depth, const Work& work) const {
        const int count = threads_for(scratch.size(), nodes, rows, depth, Block::columns * nodes);
        if (count == 1) {
            work(Step{0}, nodes, packed());
            return;
        }
        in_parallel(count, [&](int k) {
            for (Step j = k * shared_nodes; j < nodes; j += count * shared_nodes)
                work(j, std::min(j + shared_nodes, nodes), scratch[k].data());
        });
    }

    double* node(Step j) const { return x + Block::columns * j * front.height; }
    Step row(Step j) const { return front.pad + Block::rows * j; }

    /// Left-looking factorisation of node columns `begin` to `end`, those before being done with; the bad pivot, or -1.
    Place factorize_columns(Step begin, Step end, const double* limits) const {
        const Step h = front.height;
        for (Step j = begin; j < end; ++j) {
            double* const column = node(j);
            if (const Step top = group_of(row(j)); j > begin)
                product<Block, true>({column + top, h}, {node(begin) + top, h}, node(begin) + row(j), h, h - top, 1,
                                     Block::columns * (j - begin), -1, packed());
            typename Block::Pivot pivot;
            const int bad = Block::factorize(column + row(j), h, limits + Block::rows * j, pivot);
            const Step below = group_of(row(j + 1));
            Block::solve_rows(column + below, h, h - below, pivot);
            // written last, because the group of rows on top may have overwritten the diagonal block
            pivot.store(column + row(j), h);
            if (bad >= 0) return Block::rows * j + bad;
        }
        return -1;
    }

    /// Node columns `stop` to `end` minus the product with the finished ones from `begin` on.
    void update_rest(Step begin, Step stop, Step end) const {
        const Step h = front.height, depth = Block::columns * (stop - begin);
        share(end - stop, h - row(stop), depth, [&](Step from, Step to, double* packed) {
            const Step first = row(stop + from), top = group_of(first);
            product<Block, true>({node(stop + from) + top, h}, {node(begin) + top, h}, node(begin) + first, h, h - top,
                                 to - from, depth, first - top, packed);
        });
    }

    Place factorize(const double* limits) const {
        for (Step out = 0; out < front.w; out += outer) {
            const Step last = std::min(out + outer, front.w);
            for (Step in = out; in < last; in += inner) {
                const Step stop = std::min(in + inner, last);
                if (const Place bad = factorize_columns(in, stop, limits); bad >= 0) return bad;
                if (stop < last) update_rest(in, stop, last);
            }
            if (last < front.w) update_rest(out, last, front.w);
        }
        return -1;
    }

    /// The lower triangle of -L21 L21^H.
    void update_matrix(double* u) const {
        const Step h = front.height, hu = front.update_height, depth = Block::columns * front.w;
        share(front.r, hu, depth, [&](Step from, Step to, double* packed) {
            const Step first = front.update_pad + Block::rows * from, top = group_of(first);
            product<Block, false>({u + Block::columns * from * hu + top, hu}, {x + h - hu + top, h}, x + row(front.w + from), h,
                                  hu - top, to - from, depth, first - top, packed);
        });
    }
};

/// Add the node columns `from` to `to` of the update matrix of supernode c to a panel or an update matrix, in which `skip`
/// nodes of the front are left out, and whose first row is `pad`.
template <class Block>
void extend(const Symbolic& s, Node c, Step from, Step to, const double* update, double* target, Step height, Step pad,
            Step skip) {
    const Front front = s.front(c);
    const Node* const relative = s.relative.data() + s.row_start[c];
    const Node* const run_end = s.run_end.data() + s.row_start[c];
    for (Step j = from; j < to; ++j) {
        const double* const source = update + Block::columns * j * front.update_height + front.update_pad;
        double* const column = target + Block::columns * (relative[j] - skip) * height + pad - Block::rows * skip;
        for (Step i = j; i < front.r;) {
            const Step end = run_end[i];
            add_rows<Block::columns>({column + Block::rows * relative[i], height},
                                     {source + Block::rows * i, front.update_height}, Block::rows * (end - i));
            i = end;
        }
    }
}

}  // namespace

template <class Block>
Factor<Block>::Factor(std::shared_ptr<const Symbolic> symbolic)
    : symbolic_(std::move(symbolic)), members_(symbolic_->parts), panels_(symbolic_->panel_start.back()),
      updates_(symbolic_->stack_size), limits_(Block::rows * symbolic_->nodes()),
      rhs_(Block::planes * Block::rows * symbolic_->nodes()), work_(Block::planes * symbolic_->tallest) {
    for (Node s = 0; s < symbolic_->supernodes(); ++s) members_[symbolic_->part[s]].push_back(s);
    for (int part = 0; part < std::max(symbolic_->parts, symbolic_->threads); ++part)
        packed_.emplace_back(packing<Block>(symbolic_->widest, symbolic_->tallest));
}

template <class Block>
Place Factor<Block>::factorize_supernode(Node s, std::span<const Value> values, double damping,
                                         std::span<Numbers> scratch) {
    const Symbolic& t = *symbolic_;
    const Panel<Block> panel{panels_.data() + t.panel_start[s], t.front(s), scratch};
    const Step h = panel.front.height;
    std::memset(panel.x, 0, Block::columns * panel.front.w * h * sizeof(double));
    for (Place q = t.entry_start[s]; q < t.entry_start[s + 1]; ++q) {
        const Entry& entry = t.entries[q];
        Block::put(panels_.data() + entry.target, h, values.data() + Block::size * entry.block(), entry.turned());
    }
    double* const limits = limits_.data() + Block::rows * t.first[s];
    for (Step j = 0; j < panel.front.w; ++j)
        for (int c = 0; c < Block::rows; ++c) {
            double& d = Block::diagonal(panel.node(j) + panel.row(j), h, c);
            d *= 1.0 + damping;
            limits[Block::rows * j + c] = d > 0.0 ? Block::tolerance * d : 0.0;
        }
    for (Node q = t.child_start[s]; q < t.child_start[s + 1]; ++q) {
        const Node c = t.children[q];
        extend<Block>(t, c, 0, t.split[c], updates_.data() + t.stack_start[c], panel.x, h, panel.front.pad, 0);
    }
    if (const Place bad = panel.factorize(limits); bad >= 0) return Block::rows * t.first[s] + bad;
    if (panel.front.r == 0) return -1;
    // only the columns are needed before the factorisation, so the update matrix is written by the product and never cleared
    double* const update = updates_.data() + t.stack_start[s];
    panel.update_matrix(update);
    for (Node q = t.child_start[s]; q < t.child_start[s + 1]; ++q) {
        const Node c = t.children[q];
        extend<Block>(t, c, t.split[c], t.row_start[c + 1] - t.row_start[c], updates_.data() + t.stack_start[c], update,
                      panel.front.update_height, panel.front.update_pad, panel.front.w);
    }
    return -1;
}

template <class Block>
Place Factor<Block>::factorize_part(int part, std::span<const Value> values, double damping) {
    // the last part has all threads for itself
    const bool last = part + 1 == symbolic_->parts;
    const auto scratch = last ? std::span(packed_) : std::span(packed_).subspan(part, 1);
    for (const Node s : members_[part])
        if (const Place bad = factorize_supernode(s, values, damping, scratch); bad >= 0) return bad;
    return -1;
}

template <class Block>
Place Factor<Block>::factorize(std::span<const Value> values, double damping) {
    const int last = symbolic_->parts - 1;
    std::vector<Place> bad(last, -1);
    if (last > 0) in_parallel(last, [&](int part) { bad[part] = factorize_part(part, values, damping); });
    // the first bad pivot in the order of elimination, as on one thread
    Place first = -1;
    for (const Place pivot : bad)
        if (pivot >= 0 && (first < 0 || pivot < first)) first = pivot;
    return first >= 0 ? first : factorize_part(last, values, damping);
}

template class Factor<Real3>;
template class Factor<Hermitian2>;

}  // namespace vmslam::sparse
