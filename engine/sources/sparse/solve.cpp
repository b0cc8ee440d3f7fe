// Triangular solves with a factor, and what is read from it.
#include <algorithm>
#include <cmath>
#include <cstring>

#include "sparse/supernode.hpp"
#include "vmslam/sparse/factor.hpp"

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
