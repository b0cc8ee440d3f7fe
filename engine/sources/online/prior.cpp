#include "vmslam/online/prior.hpp"

#include <cmath>

namespace vmslam::online {
namespace {

/// Turn the rows of the poses of a (3k, columns) matrix to the world's axes, or (`back`) from these to their own.
void turn_rows(std::span<double> A, std::size_t columns, std::span<const Triple> centre, const std::vector<char>& point,
               bool back) {
    for (std::size_t k = 0; k < centre.size(); ++k) {
        if (point[k]) continue;
        const Rotation axes(centre[k][2]);
        const double c = axes.c, s = back ? -axes.s : axes.s;
        double *const x = A.data() + 3 * k * columns, *const y = x + columns;
        for (std::size_t q = 0; q < columns; ++q) {
            const double ahead = x[q];
            x[q] = c * ahead - s * y[q];
            y[q] = s * ahead + c * y[q];
        }
    }
}

std::vector<double> transposed(std::span<const double> A, std::size_t n) {
    std::vector<double> B(n * n);
    for (std::size_t i = 0; i < n; ++i)
        for (std::size_t j = 0; j < n; ++j) B[j * n + i] = A[i * n + j];
    return B;
}

/// b' A^+ b for a positive semidefinite A, by a Cholesky factorisation without the columns of tiny pivots.
double square_in(std::vector<double> A, std::vector<double> b) {
    const std::size_t n = b.size();
    double total = 0.0;
    for (std::size_t j = 0; j < n; ++j) {
        const double pivot = A[j * n + j];
        if (!(pivot > 1e-12 * (1.0 + pivot))) continue;
        total += b[j] * b[j] / pivot;
        for (std::size_t i = j + 1; i < n; ++i) {
            const double f = A[i * n + j] / pivot;
            b[i] -= f * b[j];
            for (std::size_t k = j + 1; k <= i; ++k) A[i * n + k] -= f * A[k * n + j];
        }
    }
    return total;
}

std::vector<char> points_of(const Graph& graph, std::span<const Number> members) {
    std::vector<char> point;
    for (const Number node : members) point.push_back(graph.nodes[node].point);
    return point;
}

}  // namespace

std::vector<double> product(std::span<const double> A, std::span<const double> x) {
    std::vector<double> y(x.size(), 0.0);
    for (std::size_t i = 0; i < x.size(); ++i)
        for (std::size_t j = 0; j < x.size(); ++j) y[i] += A[i * x.size() + j] * x[j];
    return y;
}

void Prior::turn_to_poses() {
    const std::vector<char> point(members.size(), 0);
    for (int side = 0; side < 2; ++side) {
        turn_rows(information, rhs.size(), centre, point, true);
        information = transposed(information, rhs.size());
    }
}

std::vector<double> Prior::carry_at(const Graph& graph) const {
    std::vector<double> move(rhs.size());
    for (std::size_t k = 0; k < members.size(); ++k) {
        const Node& node = graph.nodes[members[k]];
        for (int c = 0; c < 3; ++c) move[3 * k + c] = node.x[c] - centre[k][c];
        if (!node.point) move[3 * k + 2] = edges::wrap(move[3 * k + 2]);
    }
    turn_rows(move, 1, centre, points_of(graph, members), true);
    std::vector<double> result = rhs;
    const std::vector<double> pull = product(information, move);
    for (std::size_t k = 0; k < result.size(); ++k) result[k] -= pull[k];
    return result;
}

Reduced without_first(std::span<const double> information, std::span<const double> rhs) {
    const std::size_t n = rhs.size(), m = n - 3;
    // Gaussian elimination of three columns, with the largest pivot of each
    std::vector<double> A(information.begin(), information.end()), b(rhs.begin(), rhs.end());
    std::size_t order[3] = {0, 1, 2};
    for (std::size_t k = 0; k < 3; ++k) {
        for (std::size_t q = k + 1; q < 3; ++q)
            if (std::abs(A[order[q] * n + order[q]]) > std::abs(A[order[k] * n + order[k]])) std::swap(order[k], order[q]);
        const std::size_t p = order[k];
        for (std::size_t i = 0; i < n; ++i) {
            if (i < 3 && (i == order[0] || (k > 0 && i == order[1]) || (k > 1 && i == order[2]))) continue;
            const double f = A[i * n + p] / A[p * n + p];
            for (std::size_t j = 0; j < n; ++j) A[i * n + j] -= f * A[p * n + j];
            b[i] -= f * b[p];
        }
    }
    Reduced left{std::vector<double>(m * m), {b.begin() + 3, b.end()}};
    for (std::size_t i = 0; i < m; ++i)
        for (std::size_t j = 0; j < m; ++j)
            left.information[i * m + j] = (A[(i + 3) * n + j + 3] + A[(j + 3) * n + i + 3]) / 2;
    return left;
}

// With v the way of the nodes from their centres in world axes and T what turns it to their own: v' T' Lambda T v - 2 b' T v.
PriorFamily::PriorFamily(const Prior& prior, const Graph& graph, std::span<const Number> number)
    : values_(prior.centre), information_(prior.information), rhs_(prior.rhs) {
    for (const Number node : prior.members) nodes_.push_back(number[node]);
    least_ = square_in(information_, rhs_);
    const std::vector<char> point = points_of(graph, prior.members);
    const std::size_t n = rhs_.size();
    for (int side = 0; side < 2; ++side) {
        turn_rows(information_, n, values_, point, false);
        information_ = transposed(information_, n);
    }
    turn_rows(rhs_, 1, values_, point, false);
}

double PriorFamily::accumulate(const edges::State& state, edges::System* system, std::span<const edges::Place>) const {
    const std::size_t k = nodes_.size(), n = 3 * k;
    std::vector<double> v(n);
    for (std::size_t a = 0; a < k; ++a) {
        for (int c = 0; c < 3; ++c) v[3 * a + c] = state.node(nodes_[a])[c] - values_[a][c];
        v[3 * a + 2] = edges::wrap(v[3 * a + 2]);
    }
    const std::vector<double> pull = product(information_, v);
    double total = least_;
    for (std::size_t i = 0; i < n; ++i) total += v[i] * (pull[i] - 2 * rhs_[i]);
    if (!system) return total;
    for (std::size_t b = 0; b < k; ++b) {
        system->open(nodes_[b]);
        for (int c = 0; c < 3; ++c) system->xi[3 * nodes_[b] + c] += rhs_[3 * b + c] - pull[3 * b + c];
        for (std::size_t a = 0; a < k; ++a) {
            if (nodes_[a] > nodes_[b]) continue;
            double* const block = system->block(system->slot_of[nodes_[a]]);
            for (int r = 0; r < 3; ++r)
                for (int c = 0; c < 3; ++c) block[3 * r + c] += information_[(3 * a + r) * n + 3 * b + c];
        }
    }
    return total;
}

}  // namespace vmslam::online
