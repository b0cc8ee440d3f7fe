// One supernode: factorising its panel, its update matrix, adding that to the parent, and triangular solves.
#pragma once

#include <algorithm>
#include <span>

#include "sparse/panel.hpp"

namespace vmslam::sparse {

/// Block columns of a panel are factorised in groups of `outer`, and these in groups of `inner`. After an inner group the
/// rest of its outer group is updated, and after an outer group the rest of the panel, by a product large enough to copy its
/// operands.
inline constexpr Step inner = 16, outer = 64;

/// A panel during its factorisation: its numbers, its front, and scratch for the products of each thread that may work on it.
template <class Block>
struct Panel {
    double* x;
    Front front;
    std::span<Numbers> scratch;

    double* packed() const { return scratch[0].data(); }

    /// work(from, to, packed) for all of `nodes` block columns, on several threads where the flops are worth it. Every number
    /// is computed as on one thread.
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

    /// Left-looking factorisation of block columns `begin` to `end`, those before being done with; the bad pivot, or -1.
    Index factorize_columns(Step begin, Step end, const double* limits) const {
        const Step h = front.height;
        for (Step j = begin; j < end; ++j) {
            double* const column = node(j);
            if (const Step top = group_of(row(j)); j > begin)
                product<Block, true>({column + top, h}, {node(begin) + top, h}, {node(begin) + row(j), h, 1}, h - top, 1,
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

    /// Block columns `stop` to `end` minus the product with the finished ones from `begin` on.
    void update_rest(Step begin, Step stop, Step end) const {
        const Step h = front.height, depth = Block::columns * (stop - begin);
        share(end - stop, h - row(stop), depth, [&](Step from, Step to, double* packed) {
            const Step first = row(stop + from), top = group_of(first);
            product<Block, true>({node(stop + from) + top, h}, {node(begin) + top, h}, {node(begin) + first, h, 1}, h - top,
                                 to - from, depth, first - top, packed);
        });
    }

    Index factorize(const double* limits) const {
        for (Step out = 0; out < front.w; out += outer) {
            const Step last = std::min(out + outer, front.w);
            for (Step in = out; in < last; in += inner) {
                const Step stop = std::min(in + inner, last);
                if (const Index bad = factorize_columns(in, stop, limits); bad >= 0) return bad;
                if (stop < last) update_rest(in, stop, last);
            }
            if (last < front.w) update_rest(out, last, front.w);
        }
        return -1;
    }

    /// Numbers above the diagonal of the update matrix, within three rows of it, have no meaning, and some are never written.
    void clear_above_diagonal(double* u) const {
        for (Step j = 0; j < Block::rows * front.r; ++j) {
            const Step row = front.update_pad + j, top = group_of(std::max(front.update_pad, row + 1 - Block::rows));
            for (int p = 0; p < Block::planes; ++p)
                std::fill_n(u + (Block::planes * j + p) * front.update_height + top, row - top, 0.0);
        }
    }

    /// The lower triangle of -L21 L21^H.
    void update_matrix(double* u) const {
        const Step h = front.height, hu = front.update_height, depth = Block::columns * front.w;
        share(front.r, hu, depth, [&](Step from, Step to, double* packed) {
            const Step first = front.update_pad + Block::rows * from, top = group_of(first);
            product<Block, false>({u + Block::columns * from * hu + top, hu}, {x + h - hu + top, h},
                                  {x + row(front.w + from), h, 1}, hu - top, to - from, depth, first - top, packed);
        });
    }
};

/// Add the columns `from` to `to`, counted in nodes, of the update matrix of supernode c to the panel or the update matrix of
/// its parent. That begins with number `skip` of the parent's front, after `pad` unused rows.
template <class Block>
void extend(const Symbolic& t, Node c, Node from, Node to, const double* update, double* target, Step height, Step pad,
            Step skip) {
    const Front front = t.front(c);
    const Step h = front.update_height, below = t.height_below(c);
    const Node *const relative = t.relative.data() + t.row_start[c], *const run_end = t.run_end.data() + t.row_start[c];
    const double* const source = update + front.update_pad;
    // `there` and `here` tell where the numbers of nodes begin in the front of the parent, and in the update matrix
    const auto add = [&](const auto& there, const auto& here) {
        for (Step j = from; j < to; ++j) {
            const double* const own = source + Block::planes * here(j) * h;
            const Columns column{target + Block::planes * (there(relative[j]) - skip) * height + pad - skip, height};
            const bool whole = here(j + 1) - here(j) == Block::rows;
            for (Step i = j; i < below;) {
                const Step end = run_end[i];
                const Columns to_rows{column.at + there(relative[i]), height};
                const ConstColumns from_rows{own + here(i), h};
                if (whole)
                    add_rows<Block::columns>(to_rows, from_rows, here(end) - here(i));
                else
                    add_rows<Block::planes * Block::point_rows>(to_rows, from_rows, here(end) - here(i));
                i = end;
            }
        }
    };
    const auto blocks = [](Step k) { return Block::rows * k; };
    if (!t.mixed<Block>()) return add(blocks, blocks);
    const Node *const there = t.begin<Block>(t.parent[c]).list, *const here = t.begin<Block>(c).list + t.width(c);
    add([=](Step k) { return there[k]; }, [=](Step k) { return here[k] - here[0]; });
}

/// L11 y = b and r -= L21 y for the rows (0, b, r) in `work`; calls put(j, y) for block column j.
template <class Block, class Put>
void solve_forward(const Front& front, const double* x, double* work, Step plane, const Put& put) {
    const Step h = front.height;
    for (Step j = 0; j < front.w; ++j) {
        const double* const column = x + Block::columns * j * h;
        const Step row = front.pad + Block::rows * j, below = group_of(row + Block::rows);
        const auto y = Block::forward(work + row, plane, Block::Pivot::load(column + row, h));
        Block::subtract(work + below, plane, column + below, h, h - below, y);
        put(j, y);
    }
}

/// L11^H a = y - L21^H r for the rows (0, 0, r) in `work`, with y of block column j from get(j); calls put(j, row, a).
template <class Block, class Get, class Put>
void solve_backward(const Front& front, const double* x, double* work, Step plane, const Get& get, const Put& put) {
    const Step h = front.height;
    for (Step j = front.w - 1; j >= 0; --j) {
        const double* const column = x + Block::columns * j * h;
        const Step row = front.pad + Block::rows * j, below = group_of(row + Block::rows);
        typename Block::Part y = Block::minus_dot(get(j), work + below, plane, column + below, h, h - below);
        put(j, row, Block::backward(y, Block::Pivot::load(column + row, h)));
    }
}

}  // namespace vmslam::sparse
