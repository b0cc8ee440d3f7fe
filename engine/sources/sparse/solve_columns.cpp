// Triangular solves for several right-hand sides at once: `lanes` of them lie side by side, so that L is read once for all.
#include <algorithm>

#include "vmslam/sparse/factor.hpp"

namespace vmslam::sparse {
namespace {

using Row = Vector<lanes>;

/// Rows of `lanes` right-hand sides.
class Rows {
   public:
    explicit Rows(std::size_t count) : numbers_(lanes * count) {}
    Row operator[](Index row) const { return load<lanes>(numbers_.data() + lanes * row); }
    void set(Index row, const Row& value) { store<lanes>(numbers_.data() + lanes * row, value); }
    double* at(Index row) { return numbers_.data() + lanes * row; }

   private:
    Numbers numbers_;
};

/// The columns of L of a supernode, and where the rows of its front are among all.
struct Supernode {
    const double* x;
    Step h, nodes;
    std::vector<Index> rows;

    Supernode(const Factor<Real3>& factor, Node s) {
        const Symbolic& t = factor.symbolic();
        const Front front = t.front(s);
        x = factor.panel(s) + front.pad, h = front.height, nodes = front.w;
        for (Index i = 0; i < 3 * nodes; ++i) rows.push_back(t.head[s] + i);
        each_below<Real3>(t, s, [&](Index, Index at, auto count) {
            for (int c = 0; c < count; ++c) rows.push_back(at + c);
        });
    }

    /// L y = b for the rows of the nodes; what they add to those below is subtracted there.
    void forward(Rows& b) const {
        for (Step j = 0; j < nodes; ++j) {
            const double* const l = x + 3 * j * h;
            const auto p = Real3::Pivot::load(l + 3 * j, h);
            Row y[3];
            for (int c = 0; c < 3; ++c) {
                y[c] = b[rows[3 * j + c]];
                for (int k = 0; k < c; ++k) y[c] -= y[k] * p.l[c][k];
                b.set(rows[3 * j + c], y[c] *= p.l[c][c]);
            }
            for (std::size_t i = 3 * (j + 1); i < rows.size(); ++i)
                b.set(rows[i], b[rows[i]] - y[0] * l[i] - y[1] * l[h + i] - y[2] * l[2 * h + i]);
        }
    }

    /// L' a = y for the rows of the nodes, those below being known.
    void backward(Rows& b) const {
        for (Step j = nodes - 1; j >= 0; --j) {
            const double* const l = x + 3 * j * h;
            const auto p = Real3::Pivot::load(l + 3 * j, h);
            Row y[3] = {b[rows[3 * j]], b[rows[3 * j + 1]], b[rows[3 * j + 2]]};
            for (std::size_t i = 3 * (j + 1); i < rows.size(); ++i) {
                const Row a = b[rows[i]];
                y[0] -= a * l[i], y[1] -= a * l[h + i], y[2] -= a * l[2 * h + i];
            }
            for (int c = 2; c >= 0; --c) {
                for (int k = c + 1; k < 3; ++k) y[c] -= y[k] * p.l[k][c];
                b.set(rows[3 * j + c], y[c] *= p.l[c][c]);
            }
        }
    }
};

}  // namespace

bool solve_columns(const Factor<Real3>& factor, std::span<const double> b, Index columns, std::span<double> x) {
    const Symbolic& t = factor.symbolic();
    if (!all_finite(b.data(), static_cast<Step>(b.size()))) return false;
    std::vector<Supernode> supernodes;
    for (Node s = 0; s < t.supernodes(); ++s) supernodes.emplace_back(factor, s);
    Rows all(t.head.back());
    std::fill(x.begin(), x.end(), 0.0);
    for (Index begin = 0; begin < columns; begin += lanes) {
        const Index count = std::min<Index>(lanes, columns - begin);
        for (Index row = 0; row < t.head.back(); ++row) all.set(row, Row{});
        each_column<Real3>(t, [&](Index node, Index at, auto rows) {
            for (int c = 0; c < rows; ++c) std::copy_n(b.data() + (node + c) * columns + begin, count, all.at(at + c));
        });
        for (const Supernode& s : supernodes) s.forward(all);
        for (auto s = supernodes.rbegin(); s != supernodes.rend(); ++s) s->backward(all);
        each_column<Real3>(t, [&](Index node, Index at, auto rows) {
            for (int c = 0; c < rows; ++c) std::copy_n(all.at(at + c), count, x.data() + (node + c) * columns + begin);
        });
    }
    return true;
}

}  // namespace vmslam::sparse
