// The factorisation run backwards: each supernode takes the inverse over its rows from its parent, extends it by its own
// columns, and hands its children their parts. By blocks of columns J with all rows R below them, from the last block to the
// first, with Y = L_RJ L_JJ^-1: Z_RJ = -Z_RR Y and Z_JJ = (L_JJ L_JJ')^-1 - Y' Z_RJ (Takahashi, Fagan and Chen 1973).
#include <algorithm>
#include <array>
#include <cstring>

#include "sparse/panel.hpp"
#include "vmslam/sparse/factor.hpp"

namespace vmslam::sparse {
namespace {

constexpr Step narrow = 4;  ///< nodes up to which one at a time is faster than a block
constexpr Step wide = 32;   ///< nodes of a block, so that Z_RR is read seldom

/// X L = B: the row solve of L' with its columns and coefficients in reverse order.
void solve_from_right(double* x, Step h, Step count, const Real3::Pivot& p) {
    Real3::Pivot reversed;
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j <= i; ++j) reversed.l[i][j] = p.l[2 - j][2 - i];
    Real3::solve_rows(x + 2 * h, -h, count, reversed);
}

/// The inverse over one front: a full symmetric matrix, of which the rows and columns are those of the panel. Rows above
/// those that a step is about hold anything: they are computed with their group of eight and written later.
class FrontInverse {
   public:
    FrontInverse(Step tallest, int threads)
        : z_(tallest * tallest),
          y_(3 * wide * tallest),
          product_(3 * wide * tallest),
          turned_(3 * wide * tallest),
          square_(3 * wide * 3 * wide) {
        // all rows may be the depth of a product
        for (int k = 0; k < threads; ++k) packed_.emplace_back(packing<Real3>(tallest / 3, tallest));
    }

    double* column(Step j) { return z_.data() + j * height_; }

    void begin(const Front& front, const double* x) {
        x_ = x;
        height_ = front.height;
        pad_ = front.pad;
    }

    /// The columns of `w` blocks, given the inverse over the rows below.
    void extend(Step w) {
        if (w <= narrow) {
            extend_by_nodes(0, w, height_);
            return;
        }
        for (Step first = (w - 1) / wide * wide; first >= 0; first -= wide) {
            const Step last = std::min(first + wide, w);
            extend_by_nodes(first, last, row(last));
            if (row(last) < height_) extend_by_block(first, last);
        }
    }

   private:
    Step row(Step node) const { return pad_ + 3 * node; }
    const double* panel(Step node) const { return x_ + 3 * node * height_; }

    /// Nodes `last` - 1 to `first`, one by one, with the rows below up to `end` only.
    void extend_by_nodes(Step first, Step last, Step end) {
        const Step h = height_;
        for (Step j = last - 1; j >= first; --j) {
            const Step at = row(j), below = at + 3, top = group_of(below), rows = grouped(end) - top;
            const double* const l = panel(j);
            const auto p = Real3::Pivot::load(l + at, h);
            double *const f = column(at), *const y = y_.data();
            if (below < end) {
                for (Step c = 0; c < 3; ++c) {
                    std::memset(y + c * h + top, 0, rows * sizeof(double));
                    std::memcpy(y + c * h + below, l + c * h + below, (end - below) * sizeof(double));
                }
                solve_from_right(y + top, h, rows, p);
                product<Real3, false>({f + top, h}, {column(below) + top, h}, {y + below, 1, h}, rows, 1, end - below, -1,
                                      packed_[0].data());
            }
            set_diagonal(f, p, at, below, end);
        }
    }

    /// Z_JJ = (L_JJ L_JJ')^-1 - Y' Z_RJ of one node, and the rows beside its columns.
    void set_diagonal(double* f, const Real3::Pivot& p, Step at, Step below, Step end) {
        const Step h = height_;
        // the inverse N of L_JJ: N' N
        const auto& [first, second, third] = p.l;
        const double i0 = first[0], i1 = second[1], i2 = third[2];
        const double n10 = -second[0] * i0 * i1, n21 = -third[1] * i1 * i2, n20 = -(third[0] * i0 + third[1] * n10) * i2;
        double z[3][3] = {{i0 * i0 + n10 * n10 + n20 * n20, 0, 0},
                          {i1 * n10 + n21 * n20, i1 * i1 + n21 * n21, 0},
                          {i2 * n20, i2 * n21, i2 * i2}};
        const double* const y = y_.data();
        for (Step i = below; i < end; ++i)
            for (int a = 0; a < 3; ++a) {
                for (int b = 0; b <= a; ++b) z[a][b] -= y[a * h + i] * f[b * h + i];
                column(i)[at + a] = f[a * h + i];
            }
        for (int a = 0; a < 3; ++a)
            for (int b = 0; b <= a; ++b) f[a * h + at + b] = f[b * h + at + a] = z[a][b];
    }

    /// The rows below a block of nodes, and their share in its diagonal block, which holds (L_JJ L_JJ')^-1.
    void extend_by_block(Step first, Step last) {
        const Step h = height_, end = row(last), top = group_of(end), rows = h - top, deep = h - end;
        const Step k = 3 * (last - first), padded = grouped(k);
        double* const y = y_.data();
        for (Step j = last - first - 1; j >= 0; --j) {
            const double* const l = panel(first + j);
            for (Step c = 0; c < 3; ++c) {
                double* const t = y + (3 * j + c) * h;
                std::memset(t + top, 0, rows * sizeof(double));
                std::memcpy(t + end, l + c * h + end, deep * sizeof(double));
            }
            const Right right{l + row(first + j) + 3, 1, h};
            product<Real3, true>({y + 3 * j * h + top, h}, {y + 3 * (j + 1) * h + top, h}, right, rows, 1, k - 3 * (j + 1),
                                 -1, packed_[0].data());
            solve_from_right(y + 3 * j * h + top, h, rows, Real3::Pivot::load(l + row(first + j), h));
        }
        double* const z = product_.data();
        // rows are shared among threads; every number is computed as on one thread
        const int count = rows * k * deep * 2 < 8 * shared_flops ? 1 : static_cast<int>(packed_.size());
        const Step part = (rows / count + pack_rows) / pack_rows * pack_rows;
        in_parallel(count, [&](int t) {
            const Step from = t * part, height = std::min(part, rows - from);
            if (height > 0)
                product<Real3, false>({z + top + from, h}, {column(end) + top + from, h}, {y + end, 1, h}, height, k / 3,
                                      deep, -1, packed_[t].data());
        });
        for (Step j = 0; j < k; ++j) std::memcpy(column(row(first) + j) + end, z + j * h + end, deep * sizeof(double));
        for (Step i = end; i < h; ++i) std::memset(turned_.data() + (i - end) * padded + k, 0, (padded - k) * sizeof(double));
        // by tiles, because the columns lie far apart
        constexpr Step tile = 8;
        for (Step j = 0; j < k; j += tile)
            for (Step i = end; i < h; ++i)
                for (Step c = j; c < std::min(j + tile, k); ++c) {
                    turned_.data()[(i - end) * padded + c] = y[c * h + i];
                    column(i)[row(first) + c] = z[c * h + i];
                }
        double* const square = square_.data();
        product<Real3, false>({square, padded}, {turned_.data(), padded}, {z + end, 1, h}, padded, k / 3, deep, -1,
                              packed_[0].data());
        for (Step j = 0; j < k; ++j)
            for (Step i = 0; i < k; ++i) column(row(first) + j)[row(first) + i] += square[j * padded + i];
    }

    const double* x_ = nullptr;
    Step height_ = 0, pad_ = 0;
    Numbers z_, y_, product_, turned_, square_;
    std::vector<Numbers> packed_;
};

}  // namespace

SelectedInverse::SelectedInverse(const Factor<Real3>& factor)
    : symbolic_(factor.shared_symbolic()), panels_(symbolic_->panel_start.back()), diagonal_(9 * symbolic_->nodes()) {
    const Symbolic& t = *symbolic_;
    Numbers updates(t.stack_size);
    FrontInverse inverse(t.tallest, t.threads);
    for (Node s = t.supernodes() - 1; s >= 0; --s) {
        const Front front = t.front(s);
        const Step h = front.height, own = 3 * front.w, below = 3 * front.r;
        inverse.begin(front, factor.panel(s));
        for (Step j = 0; j < below; ++j)
            std::memcpy(inverse.column(front.pad + own + j) + front.pad + own,
                        updates.data() + t.stack_start[s] + j * front.update_height, below * sizeof(double));
        inverse.extend(front.w);
        for (Step j = 0; j < own; ++j)
            std::memcpy(panels_.data() + t.panel_start[s] + j * h, inverse.column(front.pad + j), h * sizeof(double));
        for (Node q = t.child_start[s]; q < t.child_start[s + 1]; ++q) {
            const Node c = t.children[q];
            const Front child = t.front(c);
            const Node* const relative = t.relative.data() + t.row_start[c];
            const Node below_child = t.height_below(c), width = t.width(c);
            const auto there = t.begin<Real3>(s), all = t.begin<Real3>(c);
            const auto here = [&](Node k) { return all[width + k] - 3 * child.w; };
            double* const update = updates.data() + t.stack_start[c];
            if (t.points) std::fill_n(update, 3 * child.r * child.update_height, 0.0);
            for (Node j = 0; j < below_child; ++j)
                for (int k = 0; k < here(j + 1) - here(j); ++k) {
                    const double* const source = inverse.column(front.pad + there[relative[j]] + k) + front.pad;
                    double* const target = update + (here(j) + k) * child.update_height;
                    for (Node i = 0; i < below_child; ++i) {
                        const double* const from = source + there[relative[i]];
                        if (here(i + 1) - here(i) == 3)
                            std::copy_n(from, 3, target + here(i));
                        else
                            std::copy_n(from, Real3::point_rows, target + here(i));
                    }
                }
        }
    }
    for (Node node = 0; node < t.nodes(); ++node) {
        const auto z = block(node, node);
        std::copy(z->begin(), z->end(), diagonal_.begin() + 9 * node);
    }
}

std::optional<std::array<double, 9>> SelectedInverse::block(Node i, Node j) const {
    const Symbolic& t = *symbolic_;
    const bool transposed = t.position[i] < t.position[j];
    const auto [column, row] = std::minmax(t.position[i], t.position[j]);
    const Node s = t.owner(column);
    const Front front = t.front(s);
    Index local = row - t.first[s];
    const auto begin = t.begin<Real3>(s);
    if (row >= t.first[s + 1]) {
        const auto low = t.rows.begin() + t.row_start[s], high = t.rows.begin() + t.row_start[s + 1];
        const auto found = std::lower_bound(low, high, row);
        if (found == high || *found != row) return std::nullopt;
        local = t.width(s) + (found - low);
    }
    const double* const z =
        panels_.data() + t.panel_start[s] + begin[column - t.first[s]] * front.height + front.pad + begin[local];
    // the missing number of a point is that of the identity
    std::array<double, 9> block{};
    if (i == j) block[8] = 1.0;
    for (int a = 0; a < t.size(row); ++a)
        for (int b = 0; b < t.size(column); ++b)
            block[3 * (transposed ? b : a) + (transposed ? a : b)] = z[b * front.height + a];
    return block;
}

}  // namespace vmslam::sparse
