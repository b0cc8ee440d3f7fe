#include "vmslam/sparse/factor.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "sparse/supernode.hpp"

namespace vmslam::sparse {
namespace {

/// Right-hand sides of complex blocks are kept as two planes, the real and the imaginary parts.
template <class Value>
Value get_value(const double* b, Step plane, Step at) {
    if constexpr (std::is_same_v<Value, double>)
        return b[at];
    else
        return {b[at], b[at + plane]};
}

/// The entry of a panel in a scalar row and column.
template <class Value>
Value entry_of(const double* x, Step h, Step row, Step column) {
    return get_value<Value>(x + (std::is_same_v<Value, double> ? 1 : 2) * column * h, h, row);
}

}  // namespace

template <class Block>
Factor<Block>::Factor(std::shared_ptr<const Symbolic> symbolic)
    : symbolic_(std::move(symbolic)),
      members_(symbolic_->parts),
      panels_(symbolic_->panel_start.back()),
      updates_(symbolic_->stack_size),
      limits_(symbolic_->head.back()),
      rhs_(Block::planes * symbolic_->head.back()),
      work_(Block::planes * symbolic_->tallest) {
    std::memset(rhs_.data(), 0, rhs_.size() * sizeof(double));
    for (Node s = 0; s < symbolic_->supernodes(); ++s) members_[symbolic_->part[s]].push_back(s);
    for (int part = 0; part < std::max(symbolic_->parts, symbolic_->threads); ++part)
        packed_.emplace_back(packing<Block>(symbolic_->widest, symbolic_->tallest));
}

template <class Block>
Factor<Block>::~Factor() = default;

template <class Block>
Index Factor<Block>::factorize_supernode(Node s, std::span<const Value> values, double damping, std::span<Numbers> scratch) {
    const Symbolic& t = *symbolic_;
    const Panel<Block> panel{panels_.data() + t.panel_start[s], t.front(s), scratch};
    const auto begin = t.begin<Block>(s);
    const Step h = panel.front.height;
    std::memset(panel.x, 0, Block::columns * panel.front.w * h * sizeof(double));
    for (Index q = t.entry_start[s]; q < t.entry_start[s + 1]; ++q) {
        // the blocks of the matrix are not in the order of elimination
        __builtin_prefetch(values.data() + Block::size * t.entries[std::min(q + 8, t.entry_start.back() - 1)].block());
        const Entry& entry = t.entries[q];
        double* const at = panel.x + Block::planes * begin[entry.column] * h + panel.front.pad + begin[entry.row];
        const Value* const block = values.data() + Block::size * entry.block();
        if (entry.row_point() || entry.column_point()) [[unlikely]]
            put_of_points<Block>(at, h, block, entry);
        else
            Block::put(at, h, block, entry.transposed());
    }
    double* const limits = limits_.data() + t.head[s];
    // a front is filled up to whole blocks: rows after those that are used are rows of the identity
    const Step used = begin[t.width(s) - 1] + t.size(t.first[s + 1] - 1);
    for (Step i = 0; i < Block::rows * panel.front.w; ++i) {
        double& d = panel.x[i * (Block::planes * h + 1) + panel.front.pad];
        d = i < used ? d + damping * std::abs(d) : 1.0;
        limits[i] = d > 0.0 ? Block::tolerance * d : 0.0;
    }
    for (Node q = t.child_start[s]; q < t.child_start[s + 1]; ++q) {
        const Node c = t.children[q];
        extend<Block>(t, c, 0, t.split[c], updates_.data() + t.stack_start[c], panel.x, h, panel.front.pad, 0);
    }
    if (const Index bad = panel.factorize(limits); bad >= 0) {
        // the node of this row of the front, and its number among all
        Node k = t.width(s) - 1;
        while (begin[k] > bad) --k;
        return Block::rows * (t.first[s] + k) + t.first_number(t.first[s] + k) + bad - begin[k];
    }
    if (panel.front.r == 0) return -1;
    // only the columns are needed before the factorisation, so the update matrix is written by the product and never cleared
    double* const update = updates_.data() + t.stack_start[s];
    panel.update_matrix(update);
    if (t.mixed<Block>()) panel.clear_above_diagonal(update);
    for (Node q = t.child_start[s]; q < t.child_start[s + 1]; ++q) {
        const Node c = t.children[q];
        extend<Block>(t, c, t.split[c], t.height_below(c), updates_.data() + t.stack_start[c], update,
                      panel.front.update_height, panel.front.update_pad, Block::rows * panel.front.w);
    }
    return -1;
}

template <class Block>
Index Factor<Block>::factorize_part(int part, std::span<const Value> values, double damping) {
    // the last part has all threads for itself
    const bool last = part + 1 == symbolic_->parts;
    const auto scratch = last ? std::span(packed_).first(symbolic_->threads) : std::span(packed_).subspan(part, 1);
    for (const Node s : members_[part])
        if (const Index bad = factorize_supernode(s, values, damping, scratch); bad >= 0) return bad;
    return -1;
}

template <class Block>
Index Factor<Block>::factorize(std::span<const Value> values, double damping) {
    const int last = symbolic_->parts - 1;
    std::vector<Index> bad(last, -1);
    if (last > 0) in_parallel(last, [&](int part) { bad[part] = factorize_part(part, values, damping); });
    // the first bad pivot in the order of elimination, as on one thread
    Index first = -1;
    for (const Index pivot : bad)
        if (pivot >= 0 && (first < 0 || pivot < first)) first = pivot;
    return first >= 0 ? first : factorize_part(last, values, damping);
}

template <class Block>
bool Factor<Block>::gather(std::span<const Value> b) {
    const Symbolic& t = *symbolic_;
    const Step plane = t.head.back();
    // what fills blocks up stays zero, also after a solution that is not finite
    if (t.mixed<Block>()) std::memset(rhs_.data(), 0, rhs_.size() * sizeof(double));
    each_column<Block>(t, [&](Index node, Index at, auto count) {
        for (int c = 0; c < count; ++c) put_value(rhs_.data() + at + c, plane, b[node + c]);
    });
    return all_finite(reinterpret_cast<const double*>(b.data()), Block::planes * static_cast<Step>(b.size()));
}

template <class Block>
void Factor<Block>::forward() {
    const Symbolic& t = *symbolic_;
    constexpr int rows = Block::rows;
    const Step plane = t.head.back(), work_plane = t.tallest;
    double *const b = rhs_.data(), *const work = work_.data();
    for (Node s = 0; s < t.supernodes(); ++s) {
        const Front front = t.front(s);
        const Step h = front.height, head = t.head[s];
        const double* const x = panels_.data() + t.panel_start[s];
        for (int p = 0; p < Block::planes; ++p) {
            std::memset(work + p * work_plane, 0, h * sizeof(double));
            std::memcpy(work + p * work_plane + front.pad, b + p * plane + head, rows * front.w * sizeof(double));
        }
        solve_forward<Block>(front, x, work, work_plane, [&](Step j, const auto& y) {
            for (int c = 0; c < rows; ++c) put_value(b + head + rows * j + c, plane, y.v[c]);
        });
        each_below<Block>(t, s, [&](Index i, Index at, auto count) {
            for (int p = 0; p < Block::planes; ++p)
                for (int c = 0; c < count; ++c) b[p * plane + at + c] += work[p * work_plane + front.pad + i + c];
        });
    }
}

template <class Block>
void Factor<Block>::backward() {
    const Symbolic& t = *symbolic_;
    constexpr int rows = Block::rows;
    const Step plane = t.head.back(), work_plane = t.tallest;
    double *const b = rhs_.data(), *const work = work_.data();
    for (Node s = t.supernodes() - 1; s >= 0; --s) {
        const Front front = t.front(s);
        const Step head = t.head[s];
        const double* const x = panels_.data() + t.panel_start[s];
        // rows that are not known yet are zero, so that the unused part of the panel does not enter the sums
        for (int p = 0; p < Block::planes; ++p) {
            double* const own = work + p * work_plane + front.pad;
            std::fill(own - front.pad, own + rows * front.w, 0.0);
            if (t.mixed<Block>() && front.r > 0) std::fill_n(own + rows * (front.w + front.r - 1), rows, 0.0);
            each_below<Block>(t, s, [&](Index i, Index at, auto count) {
                for (int c = 0; c < count; ++c) own[i + c] = b[p * plane + at + c];
            });
        }
        const auto get = [&](Step j) {
            typename Block::Part y;
            for (int c = 0; c < rows; ++c) y.v[c] = get_value<Value>(b, plane, head + rows * j + c);
            return y;
        };
        solve_backward<Block>(front, x, work, work_plane, get, [&](Step j, Step row, const auto& y) {
            for (int c = 0; c < rows; ++c) {
                put_value(work + row + c, work_plane, y.v[c]);
                put_value(b + head + rows * j + c, plane, y.v[c]);
            }
        });
    }
}

template <class Block>
bool Factor<Block>::solve(std::span<const Value> b, std::span<Value> x) {
    if (!gather(b)) return false;
    forward();
    backward();
    const Symbolic& t = *symbolic_;
    if (t.mixed<Block>()) std::fill(x.begin(), x.end(), Value{});
    each_column<Block>(t, [&](Index node, Index at, auto count) {
        for (int c = 0; c < count; ++c) x[node + c] = get_value<Value>(rhs_.data(), t.head.back(), at + c);
    });
    return true;
}

template <class Block>
double Factor<Block>::forward_square(std::span<const Value> b) {
    gather(b);
    forward();
    double square = 0.0;
    for (const double value : rhs_) square += value * value;
    return square;
}

template <class Block>
double Factor<Block>::log_determinant() const {
    double total = 0.0;
    for (Node s = 0; s < symbolic_->supernodes(); ++s) {
        const Front front = symbolic_->front(s);
        const double* x = panels_.data() + symbolic_->panel_start[s] + front.pad;
        for (Step j = 0; j < Block::rows * front.w; ++j) {
            total += std::log(*x);  // the diagonal of L is stored inverted
            x += (Block::columns / Block::rows) * front.height + 1;
        }
    }
    return -2.0 * total;
}

// With v = (u, 1, 0) for the rows before the pivot, the pivot and those after it, L11^H u = -l^H, where l is the row of the
// pivot in L. Only supernodes below the pivot's take part.
template <class Block>
std::vector<typename Block::Value> Factor<Block>::null_vector(Index pivot) const {
    const Symbolic& t = *symbolic_;
    constexpr int R = Block::rows;
    std::vector<Value> v(t.head.back());
    const Node column = static_cast<Node>(pivot / R), last = t.owner(column);
    pivot = t.number_of(column) + pivot % R - t.first_number(column);
    v[pivot] = 1.0;
    std::vector<char> below(t.supernodes(), 0);
    below[last] = 1;
    for (Node s = last; s >= 0; --s) {
        below[s] |= s < last && t.parent[s] >= 0 && t.parent[s] <= last && below[t.parent[s]];
        if (!below[s]) continue;
        const Front front = t.front(s);
        const double* const x = panels_.data() + t.panel_start[s];
        const Index head = t.head[s], end = t.head[s + 1];
        for (Index j = std::min(end, pivot) - 1; j >= head; --j) {
            const Step row = front.pad + j - head;
            Value total{};
            const auto add = [&](Index i, Step at) {
                if (v[i] != Value{}) total += conjugate(entry_of<Value>(x, front.height, at, j - head)) * v[i];
            };
            for (Index i = j + 1; i < end; ++i) add(i, front.pad + i - head);
            each_below<Block>(t, s, [&](Index at, Index i, auto count) {
                for (int c = 0; c < count; ++c) add(i + c, front.pad + at + c);
            });
            v[j] = -total * entry_of<Value>(x, front.height, row, j - head);
        }
    }
    std::vector<Value> out(R * t.nodes());
    each_column<Block>(t, [&](Index node, Index at, int count) { std::copy_n(&v[at], count, &out[node]); });
    return out;
}

template class Factor<Real2>;
template class Factor<Real3>;
template class Factor<Hermitian2>;

}  // namespace vmslam::sparse
