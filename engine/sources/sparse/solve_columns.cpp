// Triangular solves for several right-hand sides at once: `lanes` of them lie side by side, so that L is read once for all.
#include <algorithm>

#include "sparse/panel.hpp"
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

/// The columns of L of one node in a panel, from the node's own rows on.
struct Column {
    const double* x;
    Step h;
    Real3::Pivot p;

    Column(const Front& front, const double* panel, Step j)
        : x(panel + 3 * j * front.height + front.pad), h(front.height), p(Real3::Pivot::load(x + 3 * j, h)) {}
};

/// L y = b for the rows of one front; those below get what is subtracted from them.
void forward(const Front& front, const double* panel, Rows& b) {
    const Step rows = 3 * (front.w + front.r);
    for (Step j = 0; j < front.w; ++j) {
        const auto [x, h, p] = Column(front, panel, j);
        const Row y0 = b[3 * j] * p.i0, y1 = (b[3 * j + 1] - y0 * p.l10) * p.i1;
        const Row y2 = (b[3 * j + 2] - y0 * p.l20 - y1 * p.l21) * p.i2;
        b.set(3 * j, y0), b.set(3 * j + 1, y1), b.set(3 * j + 2, y2);
        for (Step i = 3 * (j + 1); i < rows; ++i) b.set(i, b[i] - y0 * x[i] - y1 * x[h + i] - y2 * x[2 * h + i]);
    }
}

/// L' a = y, the rows below being known.
void backward(const Front& front, const double* panel, Rows& b) {
    const Step rows = 3 * (front.w + front.r);
    for (Step j = front.w - 1; j >= 0; --j) {
        const auto [x, h, p] = Column(front, panel, j);
        Row y0 = b[3 * j], y1 = b[3 * j + 1], y2 = b[3 * j + 2];
        for (Step i = 3 * (j + 1); i < rows; ++i) {
            const Row a = b[i];
            y0 -= a * x[i], y1 -= a * x[h + i], y2 -= a * x[2 * h + i];
        }
        y2 = y2 * p.i2;
        y1 = (y1 - y2 * p.l21) * p.i1;
        b.set(3 * j, (y0 - y1 * p.l10 - y2 * p.l20) * p.i0), b.set(3 * j + 1, y1), b.set(3 * j + 2, y2);
    }
}

}  // namespace

bool solve_columns(const Factor<Real3>& factor, std::span<const double> b, Index columns, std::span<double> x) {
    const Symbolic& t = factor.symbolic();
    if (!all_finite(b.data(), static_cast<Step>(b.size()))) return false;
    Rows all(t.head.back()), front_rows(t.tallest);
    std::fill(x.begin(), x.end(), 0.0);
    for (Index begin = 0; begin < columns; begin += lanes) {
        const Index count = std::min<Index>(lanes, columns - begin);
        for (Index row = 0; row < t.head.back(); ++row) all.set(row, Row{});
        each_column<Real3>(t, [&](Index node, Index at, auto rows) {
            for (int c = 0; c < rows; ++c) std::copy_n(b.data() + (node + c) * columns + begin, count, all.at(at + c));
        });
        for (Node s = 0; s < t.supernodes(); ++s) {
            const Front front = t.front(s);
            const Index own = 3 * front.w, head = t.head[s];
            for (Index i = 0; i < own; ++i) front_rows.set(i, all[head + i]);
            for (Index i = own; i < own + 3 * front.r; ++i) front_rows.set(i, Row{});
            forward(front, factor.panel(s), front_rows);
            for (Index i = 0; i < own; ++i) all.set(head + i, front_rows[i]);
            each_below<Real3>(t, s, [&](Index i, Index at, auto rows) {
                for (int c = 0; c < rows; ++c) all.set(at + c, all[at + c] + front_rows[i + c]);
            });
        }
        for (Node s = t.supernodes() - 1; s >= 0; --s) {
            const Front front = t.front(s);
            const Index own = 3 * front.w, head = t.head[s];
            for (Index i = 0; i < own; ++i) front_rows.set(i, all[head + i]);
            for (Index i = own; i < own + 3 * front.r; ++i) front_rows.set(i, Row{});
            each_below<Real3>(t, s, [&](Index i, Index at, auto rows) {
                for (int c = 0; c < rows; ++c) front_rows.set(i + c, all[at + c]);
            });
            backward(front, factor.panel(s), front_rows);
            for (Index i = 0; i < own; ++i) all.set(head + i, front_rows[i]);
        }
        each_column<Real3>(t, [&](Index node, Index at, auto rows) {
            for (int c = 0; c < rows; ++c) std::copy_n(all.at(at + c), count, x.data() + (node + c) * columns + begin);
        });
    }
    return true;
}

}  // namespace vmslam::sparse
