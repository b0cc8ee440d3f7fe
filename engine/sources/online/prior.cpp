#include "vmslam/online/prior.hpp"

#include <algorithm>
#include <cmath>

#include "vmslam/sparse/pattern.hpp"

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
    std::vector<double> least(n);
    for (std::size_t j = 0; j < n; ++j) least[j] = 1e-12 * A[j * n + j];
    for (std::size_t j = 0; j < n; ++j) {
        const double pivot = A[j * n + j];
        // what rounding leaves of the diagonal, whatever the unit
        if (!(pivot > least[j])) continue;
        total += b[j] * b[j] / pivot;
        for (std::size_t i = j + 1; i < n; ++i) {
            const double f = A[i * n + j] / pivot;
            b[i] -= f * b[j];
            for (std::size_t k = j + 1; k <= i; ++k) A[i * n + k] -= f * A[k * n + j];
        }
    }
    return total;
}

std::vector<char> points_of(const Graph& graph, std::span<const Id> members) {
    std::vector<char> point;
    for (const Id node : members) point.push_back(graph.nodes[node].point);
    return point;
}

/// A place in the axes of a node.
Lever in_axes(const Rotation& axes, const Triple& node, const Triple& place) {
    const double x = place[0] - node[0], y = place[1] - node[1];
    return {axes.c * x + axes.s * y, axes.c * y - axes.s * x};
}

/// How far the Jacobian of a way may turn, in radians, or be stretched, as a part, before the tree takes the present one.
constexpr double most_turned = 3e-3;

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

double Prior::cost(const Graph& graph) const {
    return Way(*this, graph.values(members), points_of(graph, members)).cost(*this);
}

void Prior::evaluate(const Graph& graph, bool renew) {
    const std::vector<char> point = points_of(graph, members);
    std::vector<Triple> x = graph.values(members);
    const Way way(*this, x, point);
    pull = way.gradient(*this);
    if (!renew) return;
    linear = way.information(*this);
    at = std::move(x);
}

bool Prior::outdated(const Graph& graph) const {
    const std::vector<char> point = points_of(graph, members);
    return Way(*this, graph.values(members), point).turned_from(Way(*this, at, point)) > most_turned;
}

Way::Way(const Prior& prior, std::span<const Triple> x, const std::vector<char>& point)
    : v(3 * x.size(), 0.0), relative_(prior.relative), point_(point), own_(x.size()), of_first_(x.size()), seen_(x.size()) {
    if (!prior.pivot.empty()) {
        turn_with(prior, x);
        return;
    }
    const Triple &first = x[0], &centre = prior.centre[0];
    const Rotation axes(first[2]), axes_of_centre(centre[2]);
    for (std::size_t k = relative_ ? 1 : 0; k < x.size(); ++k) {
        const Triple& c = prior.centre[k];
        double *const to = v.data() + 3 * k, turned = x[k][2] - c[2];
        Lever moved{x[k][0] - c[0], x[k][1] - c[1]};
        if (relative_) {
            seen_[k] = in_axes(axes, first, x[k]);
            const Lever before = in_axes(axes_of_centre, centre, c);
            moved = {seen_[k].x - before.x, seen_[k].y - before.y};
            turned -= first[2] - centre[2];
            of_first_[k] = Rotation(point[k] ? centre[2] : centre[2] - c[2]);
            own_[k] = Rotation(point[k] ? centre[2] - first[2] : turned);
        } else if (!point[k]) {
            of_first_[k] = Rotation(-c[2]);
            own_[k] = Rotation(turned);
        }
        const auto [cosine, sine] = of_first_[k];
        to[0] = cosine * moved.x - sine * moved.y;
        to[1] = sine * moved.x + cosine * moved.y;
        to[2] = point[k] ? 0.0 : edges::wrap(turned);
    }
}

void Way::turn_with(const Prior& prior, std::span<const Triple> x) {
    const std::size_t count = x.size();
    Lever middle{0.0, 0.0};
    for (const Triple& c : prior.centre) middle = {middle.x + c[0] / double(count), middle.y + c[1] / double(count)};
    // the cosine and the sine of t, times a common length
    double cosine = 0.0, sine = 0.0;
    for (std::size_t k = 0; k < count; ++k) {
        const double sx = prior.centre[k][0] - middle.x, sy = prior.centre[k][1] - middle.y;
        cosine += sx * x[k][0] + sy * x[k][1];
        sine += sx * x[k][1] - sy * x[k][0];
    }
    const double t = std::atan2(sine, cosine), square = cosine * cosine + sine * sine;
    const Rotation back(-t);
    along_.assign(3 * count, 0.0), gradient_.assign(3 * count, 0.0);
    const auto put = [](const Rotation& R, double a, double b, double* to) {
        to[0] = R.c * a - R.s * b;
        to[1] = R.s * a + R.c * b;
    };
    for (std::size_t k = 0; k < count; ++k) {
        const Triple& c = prior.centre[k];
        const double turned = x[k][2] - c[2];
        const double ax = c[0] - prior.pivot[0], ay = c[1] - prior.pivot[1];
        double moved[2];
        put(back, x[k][0] - prior.pivot[0], x[k][1] - prior.pivot[1], moved);
        const Rotation axes(point_[k] ? 0.0 : -c[2]);
        own_[k] = Rotation(point_[k] ? -t : turned - t);
        put(axes, moved[0] - ax - t * ay, moved[1] - ay + t * ax, v.data() + 3 * k);
        v[3 * k + 2] = point_[k] ? 0.0 : edges::wrap(turned);
        put(axes, moved[1] - ay, ax - moved[0], along_.data() + 3 * k);
        const double sx = c[0] - middle.x, sy = c[1] - middle.y;
        put(Rotation(point_[k] ? 0.0 : -x[k][2]), -(cosine * sy + sine * sx) / square, (cosine * sx - sine * sy) / square,
            gradient_.data() + 3 * k);
    }
}

double Way::turned_from(const Way& other) const {
    double most = 0.0, stretched = 0.0, steepest = 0.0;
    for (std::size_t k = 0; k < own_.size(); ++k) {
        const Rotation &now = own_[k], &then = other.own_[k];
        const Lever &seen = seen_[k], &before = other.seen_[k];
        most = std::max({most, std::abs(now.s * then.c - now.c * then.s),
                         std::hypot(seen.x - before.x, seen.y - before.y) / (1.0 + std::hypot(before.x, before.y))});
    }
    for (std::size_t k = 0; k < along_.size(); ++k) {
        stretched = std::max(stretched, std::abs(along_[k] - other.along_[k]));
        steepest = std::max(steepest, std::abs(gradient_[k]));
    }
    return std::max(most, stretched * steepest);
}

// With u, phi the increments of the first node and B, A the rotations `of_first_` and `own_` of node k, relative ways change
// by
//
//     dv_k = A d_k - B (u + phi perp(seen_k)),    dtheta_k = d_theta_k - phi.
void Way::times_jacobian(const double* row, double* product) const {
    Triple first{};
    for (std::size_t k = relative_ ? 1 : 0; k < own_.size(); ++k) {
        const double *const a = row + 3 * k, c = own_[k].c, s = own_[k].s;
        double* const to = product + 3 * k;
        to[0] = c * a[0] + s * a[1];
        to[1] = c * a[1] - s * a[0];
        to[2] = a[2];
        if (!relative_) continue;
        const auto [cosine, sine] = of_first_[k];
        const double x = cosine * a[0] + sine * a[1], y = cosine * a[1] - sine * a[0];
        first[0] -= x;
        first[1] -= y;
        first[2] -= seen_[k].x * y - seen_[k].y * x + (point_[k] ? 0.0 : a[2]);
    }
    if (relative_) std::copy_n(first.data(), 3, product);
    if (along_.empty()) return;
    double of_turn = 0.0;
    for (std::size_t i = 0; i < along_.size(); ++i) of_turn += row[i] * along_[i];
    for (std::size_t i = 0; i < along_.size(); ++i) product[i] += of_turn * gradient_[i];
}

double Way::cost(const Prior& prior) const {
    const std::vector<double> pull = product(prior.information, v);
    double total = 0.0;
    for (std::size_t k = 0; k < v.size(); ++k) total += v[k] * (pull[k] - 2 * prior.rhs[k]);
    return total;
}

std::vector<double> Way::gradient(const Prior& prior) const {
    std::vector<double> left = prior.rhs, result(left.size());
    const std::vector<double> pull = product(prior.information, v);
    for (std::size_t k = 0; k < left.size(); ++k) left[k] -= pull[k];
    times_jacobian(left.data(), result.data());
    return result;
}

std::vector<double> Way::information(const Prior& prior) const {
    const std::size_t n = v.size();
    std::vector<double> J = prior.information;
    for (int side = 0; side < 2; ++side) {
        std::vector<double> product(n * n);
        for (std::size_t i = 0; i < n; ++i) times_jacobian(J.data() + i * n, product.data() + i * n);
        J = transposed(product, n);
    }
    return J;
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

PriorFamily::PriorFamily(const Prior& prior, const Graph& graph, std::span<const Id> number)
    : prior_(prior), point_(points_of(graph, prior.members)), least_(square_in(prior.information, prior.rhs)) {
    for (const Id node : prior.members) nodes_.push_back(number[node]);
}

double PriorFamily::accumulate(const edges::State& state, edges::System* system, std::span<const edges::Index>) const {
    const std::size_t k = nodes_.size(), n = 3 * k;
    std::vector<Triple> x;
    for (const edges::Index node : nodes_) x.push_back({state.node(node)[0], state.node(node)[1], state.node(node)[2]});
    const Way way(prior_, x, point_);
    const double total = least_ + way.cost(prior_);
    if (!system) return total;
    std::vector<double> xi = way.gradient(prior_), information = way.information(prior_);
    turn_rows(xi, 1, x, point_, false);
    for (int side = 0; side < 2; ++side) {
        turn_rows(information, n, x, point_, false);
        information = transposed(information, n);
    }
    for (std::size_t b = 0; b < k; ++b) {
        for (int c = 0; c < 3; ++c) system->xi[3 * nodes_[b] + c] += xi[3 * b + c];
        for (std::size_t a = 0; a < k; ++a) {
            if (nodes_[a] > nodes_[b]) continue;
            double* const block = system->block(sparse::block_between(*system, nodes_[a], nodes_[b]));
            for (int r = 0; r < 3; ++r)
                for (int c = 0; c < 3; ++c) block[3 * r + c] += information[(3 * a + r) * n + 3 * b + c];
        }
    }
    return total;
}

}  // namespace vmslam::online
