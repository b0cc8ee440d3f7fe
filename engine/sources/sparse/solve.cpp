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
void put_value(double* b, Step plane, Step at, Value value) {
    if constexpr (std::is_same_v<Value, double>) {
        b[at] = value;
    } else {
        b[at] = value.real();
        b[at + plane] = value.imag();
    }
}

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

double conjugate(double a) { return a; }
std::complex<double> conjugate(std::complex<double> a) { return std::conj(a); }

}  // namespace

template <class Block>
bool Factor<Block>::gather(std::span<const Value> b) {
    const Step plane = Block::rows * symbolic_->nodes();
    Value zero{};  // NaN for what is not finite
    for (Node k = 0; k < symbolic_->nodes(); ++k)
        for (int c = 0; c < Block::rows; ++c) {
            const Value value = b[Block::rows * symbolic_->order[k] + c];
            put_value(rhs_.data(), plane, Block::rows * k + c, value);
            zero += 0.0 * value;
        }
    return zero == Value{};
}

template <class Block>
void Factor<Block>::forward() {
    const Symbolic& t = *symbolic_;
    constexpr int rows = Block::rows;
    const Step plane = rows * t.nodes(), work_plane = t.tallest;
    double *const b = rhs_.data(), *const work = work_.data();
    for (Node s = 0; s < t.supernodes(); ++s) {
        const Front front = t.front(s);
        const Step h = front.height, head = rows * t.first[s];
        const double* const x = panels_.data() + t.panel_start[s];
        for (int p = 0; p < Block::planes; ++p) {
            std::memset(work + p * work_plane, 0, h * sizeof(double));
            std::memcpy(work + p * work_plane + front.pad, b + p * plane + head, rows * front.w * sizeof(double));
        }
        solve_forward<Block>(front, x, work, work_plane, [&](Step j, const auto& y) {
            for (int c = 0; c < rows; ++c) put_value(b, plane, head + rows * j + c, y.v[c]);
        });
        Step i = front.pad + rows * front.w;
        for (Index q = t.row_start[s]; q < t.row_start[s + 1]; ++q, i += rows)
            for (int p = 0; p < Block::planes; ++p)
                for (int c = 0; c < rows; ++c) b[p * plane + rows * t.rows[q] + c] += work[p * work_plane + i + c];
    }
}

template <class Block>
void Factor<Block>::backward() {
    const Symbolic& t = *symbolic_;
    constexpr int rows = Block::rows;
    const Step plane = rows * t.nodes(), work_plane = t.tallest;
    double *const b = rhs_.data(), *const work = work_.data();
    for (Node s = t.supernodes() - 1; s >= 0; --s) {
        const Front front = t.front(s);
        const Step head = rows * t.first[s];
        const double* const x = panels_.data() + t.panel_start[s];
        // rows that are not known yet are zero, so that the unused part of the panel does not enter the sums
        for (int p = 0; p < Block::planes; ++p) {
            std::memset(work + p * work_plane, 0, (front.pad + rows * front.w) * sizeof(double));
            double* const below = work + p * work_plane + front.pad + rows * front.w;
            for (Index q = t.row_start[s], i = 0; q < t.row_start[s + 1]; ++q, i += rows)
                for (int c = 0; c < rows; ++c) below[i + c] = b[p * plane + rows * t.rows[q] + c];
        }
        const auto get = [&](Step j) {
            typename Block::Part y;
            for (int c = 0; c < rows; ++c) y.v[c] = get_value<Value>(b, plane, head + rows * j + c);
            return y;
        };
        solve_backward<Block>(front, x, work, work_plane, get, [&](Step j, Step row, const auto& y) {
            for (int c = 0; c < rows; ++c) {
                put_value(work, work_plane, row + c, y.v[c]);
                put_value(b, plane, head + rows * j + c, y.v[c]);
            }
        });
    }
}

template <class Block>
bool Factor<Block>::solve(std::span<const Value> b, std::span<Value> x) {
    if (!gather(b)) return false;
    forward();
    backward();
    const Step plane = Block::rows * symbolic_->nodes();
    for (Node k = 0; k < symbolic_->nodes(); ++k)
        for (int c = 0; c < Block::rows; ++c)
            x[Block::rows * symbolic_->order[k] + c] = get_value<Value>(rhs_.data(), plane, Block::rows * k + c);
    return true;
}

template <class Block>
double Factor<Block>::forward_square(std::span<const Value> b) {
    gather(b);
    forward();
    double square = 0.0;
    for (Step i = 0; i < rhs_.size(); ++i) square += rhs_.data()[i] * rhs_.data()[i];
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
    std::vector<Value> v(R * t.nodes());
    v[pivot] = 1.0;
    const Node last = t.owner(static_cast<Node>(pivot / R));
    std::vector<char> below(t.supernodes(), 0);
    below[last] = 1;
    for (Node s = last; s >= 0; --s) {
        below[s] |= s < last && t.parent[s] >= 0 && t.parent[s] <= last && below[t.parent[s]];
        if (!below[s]) continue;
        const Front front = t.front(s);
        const double* const x = panels_.data() + t.panel_start[s];
        const Index head = R * t.first[s], end = R * t.first[s + 1];
        for (Index j = std::min(end, pivot) - 1; j >= head; --j) {
            const Step row = front.pad + j - head;
            Value total{};
            const auto add = [&](Index i, Step at) {
                if (v[i] != Value{}) total += conjugate(entry_of<Value>(x, front.height, at, j - head)) * v[i];
            };
            for (Index i = j + 1; i < end; ++i) add(i, front.pad + i - head);
            for (Index q = t.row_start[s], at = front.pad + R * front.w; q < t.row_start[s + 1]; ++q)
                for (int c = 0; c < R; ++c, ++at) add(R * t.rows[q] + c, at);
            v[j] = -total * entry_of<Value>(x, front.height, row, j - head);
        }
    }
    std::vector<Value> out(v.size());
    for (Node k = 0; k < t.nodes(); ++k) std::copy_n(v.begin() + R * k, R, out.begin() + R * t.order[k]);
    return out;
}

template <class Block>
std::vector<double> Factor<Block>::magnitude_square(std::span<const double> v) const {
    const Symbolic& t = *symbolic_;
    constexpr int R = Block::rows;
    std::vector<double> result(v.size(), 0.0), size(t.tallest), local(t.tallest), sums(t.tallest);
    std::vector<Index> where(t.tallest);
    for (Node s = 0; s < t.supernodes(); ++s) {
        const Front front = t.front(s);
        const Step width = R * front.w, height = width + R * front.r;
        for (Step i = 0; i < width; ++i) where[i] = R * t.first[s] + i;
        for (Index q = t.row_start[s], i = width; q < t.row_start[s + 1]; ++q)
            for (int c = 0; c < R; ++c, ++i) where[i] = R * t.rows[q] + c;
        for (Step i = 0; i < height; ++i) {
            local[i] = v[where[i]];
            sums[i] = 0.0;
        }
        for (Step j = 0; j < width; ++j) {
            const double* const re = panel(s) + (Block::columns / R) * j * front.height + front.pad;
            const double* const im = re + front.height;
            for (Step i = j; i < height; ++i) {
                // the larger part and sqrt(2) - 1 of the smaller one are at least the magnitude, and at most 8 % more
                const double a = std::abs(re[i]), b = Block::planes == 2 ? std::abs(im[i]) : 0.0;
                size[i] = std::max(a, b) + 0.41421356237309515 * std::min(a, b);
            }
            size[j] = 1.0 / size[j];  // pivots are stored inverted
            double w[4] = {};
            Step i = j;
            for (; i + 4 <= height; i += 4)
                for (int k = 0; k < 4; ++k) w[k] += size[i + k] * local[i + k];
            for (; i < height; ++i) w[0] += size[i] * local[i];
            const double total = (w[0] + w[1]) + (w[2] + w[3]);
            for (i = j; i < height; ++i) sums[i] += size[i] * total;
        }
        for (Step i = 0; i < height; ++i) result[where[i]] += sums[i];
    }
    return result;
}

template class Factor<Real2>;
template class Factor<Real3>;
template class Factor<Hermitian2>;

}  // namespace vmslam::sparse
