#include "vmslam/factors/whitened_edges.hpp"

namespace vmslam::factors {

using namespace edges;

namespace {

/// e of an edge before whitening, in axes that stand at an angle: those of the first pose, or frozen ones.
struct Seen {
    Rotation axes;
    Vector e;
    Lever lever;  ///< the derivative of e by the heading of the first end

    Seen(const WhitenedEdge& edge, const double* a, const double* b, bool world) : axes(world ? edge.frozen : a[2]) {
        const Rotation ahead(world ? a[2] - edge.frozen : 0.0);
        const double dx = b[0] - a[0], dy = b[1] - a[1], c = axes.c, s = axes.s;
        const double sx = c * dx + s * dy, sy = -s * dx + c * dy;
        const double mx = ahead.c * edge.z.x - ahead.s * edge.z.y, my = ahead.s * edge.z.x + ahead.c * edge.z.y;
        e = {sx - mx, sy - my, wrap(b[2] - a[2] - edge.z.t)};
        // the world's axes stay, and the measurement turns; the robot's axes turn, and the measurement stays
        lever = world ? Lever{my, -mx} : Lever{sy, -sx};
    }
};

/// Row r of R v.
double whitened(const WhitenedEdge& edge, const double (&v)[3], int r) {
    double value = 0.0;
    for (int k = r; k < edge.rows; ++k) value += edge.root[3 * r + k] * v[k];
    return value;
}

/// R e into `out`; the sum of the squares.
double whiten(const WhitenedEdge& edge, const Vector& e, double* out) {
    const double v[3] = {e.x, e.y, e.t};
    double squares = 0.0;
    for (int r = 0; r < edge.rows; ++r) {
        out[r] = whitened(edge, v, r);
        squares += out[r] * out[r];
    }
    return squares;
}

}  // namespace

WhitenedEdges::WhitenedEdges(std::vector<WhitenedEdge> edges, Index poses, bool world)
    : edges_(std::move(edges)), poses_(poses), world_(world) {
    for (const WhitenedEdge& edge : edges_) rows_ += edge.rows;
}

std::vector<double> WhitenedEdges::residuals(std::span<const double> x) const {
    std::vector<double> out(rows_);
    double* at = out.data();
    for (const WhitenedEdge& edge : edges_) {
        const Seen seen(edge, x.data() + 3 * edge.i, x.data() + 3 * edge.j, world_);
        const double squares = whiten(edge, seen.e, at);
        if (edge.kernel && squares > 0) {
            const double factor = std::sqrt(edge.kernel.loss(squares) / squares);
            for (int r = 0; r < edge.rows; ++r) at[r] *= factor;
        }
        at += edge.rows;
    }
    return out;
}

WhitenedEdges::Linearized WhitenedEdges::linearized(std::span<const double> x) const {
    Linearized out{std::vector<double>(rows_), std::vector<double>(x.size() * rows_, 0.0)};
    Index start = 0;
    for (const WhitenedEdge& edge : edges_) {
        const double *const a = x.data() + 3 * edge.i, *const b = x.data() + 3 * edge.j;
        const Seen seen(edge, a, b, world_);
        // a pose moves in its own axes, a point in the world's
        const Rotation own(a[2] - (world_ ? edge.frozen : a[2]));
        const double heading = edge.j < poses_ ? b[2] : 0.0;
        const Rotation other(heading - (world_ ? edge.frozen : a[2]));
        const double by_first[3][3] = {{-own.c, -own.s, 0.0}, {own.s, -own.c, 0.0}, {seen.lever.x, seen.lever.y, -1.0}};
        const double by_second[3][3] = {{other.c, other.s, 0.0}, {-other.s, other.c, 0.0}, {0.0, 0.0, 1.0}};
        double* const e = out.residuals.data() + start;
        const double squares = whiten(edge, seen.e, e);
        const double factor = edge.kernel ? std::sqrt(edge.kernel.weight(squares)) : 1.0;
        for (int r = 0; r < edge.rows; ++r) {
            e[r] *= factor;
            for (int column = 0; column < 3; ++column) {
                out.jacobians[(3 * edge.i + column) * rows_ + start + r] += factor * whitened(edge, by_first[column], r);
                if (column < edge.rows)
                    out.jacobians[(3 * edge.j + column) * rows_ + start + r] += factor * whitened(edge, by_second[column], r);
            }
        }
        start += edge.rows;
    }
    return out;
}

}  // namespace vmslam::factors
