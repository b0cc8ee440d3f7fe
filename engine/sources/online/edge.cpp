#include "vmslam/online/edge.hpp"

#include <cmath>
#include <numbers>

namespace vmslam::online {
namespace {

using edges::dot;
using edges::turned;

/// From which relative change of its weight on an edge is linearised again; see `outdated`.
constexpr double reweighted = 0.33;
/// The least curvature of a sighting with a kernel along its residual, as a part of its weight.
constexpr double least_bend = 0.1;

/// What a robust kernel makes of W e and e' W e.
[[gnu::always_inline]] inline void weigh(const Graph& graph, const Edge& edge, Present& now) {
    const edges::Kernel& kernel = graph.kernel_of(edge);
    const double squares = now.squares, w = now.weight = kernel.weight(squares);
    now.g = {w * now.g.x, w * now.g.y, w * now.g.t};
    // saves a logarithm; the trapezoidal rule is exact to 1e-10 then, and to 2e-7 across the kink of Huber's weight
    const double change = squares - edge.squares;
    now.cost = std::abs(change) < 1e-3 * (1.0 + squares) ? edge.cost + change * (w + kernel.weight(edge.squares)) / 2
                                                         : kernel.loss(squares);
}

Present with_pull(const Graph& graph, const Edge& edge, Present now, double squares) {
    now.squares = now.cost = squares;
    now.weight = 1.0;
    now.pull = now.g;
    if (edge.robust) weigh(graph, edge, now);
    return now;
}

Present present_number(const Graph& graph, const Edge& edge) {
    const Node &a = graph.nodes[edge.ends[0]], &b = graph.nodes[edge.ends[1]];
    const double c = a.axes.c, s = a.axes.s, dx = b.x[0] - a.x[0], dy = b.x[1] - a.x[1];
    const double ahead = c * dx + s * dy, left = c * dy - s * dx, omega = edge.omega.xx;
    const edges::Number kind = edge.kind == Kind::range ? edges::Number::range : edges::Number::bearing;
    const auto [e, n, distance] = edges::number_seen(kind, edge.z.x, ahead - edge.lever.x, left - edge.lever.y);
    Present now{};
    now.u = {-left, ahead};
    // turns increments of the second end, which has axes of its own where it is a pose
    const Rotation own = b.point ? Rotation() : b.axes;
    now.c = c * own.c + s * own.s, now.s = c * own.s - s * own.c;
    now.n = n;
    now.g = {omega * e * n.x, omega * e * n.y, 0.0};
    return with_pull(graph, edge, now, omega * e * e);
}

Symmetric turned_back(const Rotation& axes, const Symmetric& W) { return turned(axes.inverse(), W); }

Present present_position(const Graph& graph, const Edge& edge) {
    const Node& a = graph.nodes[edge.ends[0]];
    const double c = a.axes.c, s = a.axes.s, dx = edge.z.x - a.x[0], dy = edge.z.y - a.x[1];
    const double turn = edge.oriented ? std::remainder(edge.z.t - a.x[2], 2 * std::numbers::pi) : 0.0;
    const Vector e{c * dx + s * dy - edge.lever.x, c * dy - s * dx - edge.lever.y, turn};
    Present now{};
    now.u = {-edge.lever.y, edge.lever.x};
    now.c = c, now.s = s;
    now.one_ended = true;
    now.g = turned_back(a.axes, edge.omega) * e;
    return with_pull(graph, edge, now, dot(now.g, e));
}

// e = (R(theta_i)' (p_j - p_i) - (z_x, z_y), theta_j - theta_i - z_t), g = w W e
[[gnu::always_inline]] inline Present present(const Graph& graph, const Edge& edge) {
    if (!edge.relative()) [[unlikely]]
        return edge.one_ended() ? present_position(graph, edge) : present_number(graph, edge);
    const Node &a = graph.nodes[edge.ends[0]], &b = graph.nodes[edge.ends[1]];
    double c = a.axes.c, s = a.axes.s, turn = 0.0;
    const double dx = b.x[0] - a.x[0], dy = b.x[1] - a.x[1];
    const double ahead = c * dx + s * dy, left = c * dy - s * dx;
    if (edge.oriented) {
        turn = b.x[2] - a.x[2] - edge.z.t;
        if (std::abs(turn) > std::numbers::pi) turn = edges::wrap(turn);
        // headings of 1e300 are no multiple of a rounded turn away from zero
        if (std::abs(turn) > 4.0) [[unlikely]]
            turn = std::remainder(turn, 2 * std::numbers::pi);
        const double p = b.axes.c, q = b.axes.s, cosine = c * p + s * q;
        s = c * q - s * p;
        c = cosine;
    } else {
        s = -s;
    }
    const Vector e{ahead - edge.z.x, left - edge.z.y, turn};
    const Vector g = edge.omega * e;
    const double squares = dot(g, e);
    Present now{{-left, ahead}, c, s, 1.0, g, g, squares, squares};
    if (edge.robust) weigh(graph, edge, now);
    return now;
}

/// W of an edge at the estimate, in the axes of its first end, without the robust weight.
Symmetric information(const Graph& graph, const Edge& edge, const Present& now) {
    if (edge.one_ended()) return turned_back(graph.nodes[edge.ends[0]].axes, edge.omega);
    return edge.single_number() ? edges::along(edge.omega.xx, now.n) : edge.omega;
}

/// W of a sighting with a kernel. Gauss-Newton has w W, times what turns weights into information. The second derivative of
/// J/2 is w W + 2 w' (W e) (W e)', w' the derivative of w by r² = e' W e. Along e that is w + 2 w' r² times W, which is
/// negative far out, and kept above `least_bend` w.
Symmetric robust_information(const Graph& graph, const Edge& edge, const Present& now, bool bent) {
    const Symmetric W = information(graph, edge, now);
    if (!bent || now.squares == 0.0) return (now.weight * graph.gain_of(edge)) * W;
    const double curve = 2 * graph.kernel_of(edge).weight_slope(now.squares);
    const double slope = std::max(curve, (least_bend - 1) * now.weight / now.squares);
    // it multiplies one of the factors, so that a residual far beyond all others underflows to zero
    return now.weight * W + edges::outer(slope, now.pull);
}

/// (gamma, h) of an edge.
struct Curvature {
    double gamma = 0.0;
    Lever h{};
};
[[gnu::always_inline]] inline Curvature curvature(const Edge& edge, const Present& now, const Bent& bent) {
    if (bent.edges == Bent::Edges::none || edge.robust) return {};
    if (bent.edges == Bent::Edges::costly && now.cost < costly) return {};
    const Symmetric& W = edge.omega;
    const Vector& g = now.g;
    const double gamma = (now.u.x * g.y - now.u.y * g.x) * (edge.one_ended() ? -1.0 : 1.0);
    // a single edge is indefinite along the direction in which the residual does not change
    if (!edge.relative()) return {std::max(gamma, 0.0), {}};
    double a = W.xx, b = W.xy, c = W.yy;
    if (edge.oriented) a -= W.xt * W.xt / W.tt, b -= W.xt * W.yt / W.tt, c -= W.yt * W.yt / W.tt;
    // along the direction in which its residual does not change, the edge adds gamma + 2 h' u - h' P h, P its covariance.
    // That is -(gamma + h' P h), because h' u = -gamma
    const double least = (a * g.x * g.x + 2 * b * g.x * g.y + c * g.y * g.y) / (a * c - b * b);
    if (least + gamma > 0.0 && (bent.convex || now.cost < costly)) return {std::max(gamma, 0.0), {}};
    return {gamma, {-g.y, g.x}};
}

void add_diagonal(Graph& graph, const Edge& edge, double sign) {
    const Blocks parts = diagonal_blocks(edge);
    Triple &i = graph.nodes[edge.ends[0]].diagonal, &j = graph.nodes[edge.ends[1]].diagonal;
    i = {i[0] + sign * parts.first.xx, i[1] + sign * parts.first.yy, i[2] + sign * parts.first.tt};
    j = {j[0] + sign * parts.second.xx, j[1] + sign * parts.second.yy, j[2] + sign * parts.second.tt};
}

/// The same as `outdated` below, of a number or a position.
bool outdated_other(const Graph& graph, const Edge& edge, const Present& now, double limit) {
    const Node &i = graph.nodes[edge.ends[0]], &j = graph.nodes[edge.ends[1]];
    const Linear& then = edge.linear;
    const double turn = j.place_std * (now.s * then.c - now.c * then.s);
    if (edge.one_ended()) return (edge.omega.xx + edge.omega.yy) * turn * turn > limit;
    const double a = i.heading_std * (now.n.x * now.u.x + now.n.y * now.u.y - then.n.x * then.u.x - then.n.y * then.u.y);
    const double b = (i.place_std + j.place_std) * std::hypot(now.n.x - then.n.x, now.n.y - then.n.y);
    const double c = turn * std::hypot(now.n.x, now.n.y);
    return edge.omega.xx * (a * a + b * b + c * c) > limit;
}

/// Whether weight, lever or alpha of an edge are farther from those in the factor than `limit`: weights by a third, and lever
/// and alpha so far that an increment of one standard deviation changes the residual, squared and in its own standard
/// deviations, by that much. Poses that a stiff edge ties move together, so that a change of the lever in relation to itself
/// says nothing.
[[gnu::always_inline]] inline bool outdated(const Graph& graph, const Edge& edge, const Present& now, double limit) {
    if (edge.robust && std::abs(now.weight - edge.weight) > std::min(reweighted, 3 * limit) * edge.weight + 0.01) return true;
    if (!edge.relative()) [[unlikely]]
        return outdated_other(graph, edge, now, limit);
    const Symmetric& W = edge.omega;
    const double size = graph.nodes[edge.ends[0]].heading_std;
    const double turn = graph.nodes[edge.ends[1]].place_std * (now.s * edge.linear.c - now.c * edge.linear.s);
    const double a = size * (now.u.x - edge.linear.u.x), b = size * (now.u.y - edge.linear.u.y);
    return W.xx * a * a + 2 * W.xy * a * b + W.yy * b * b + (W.xx + W.yy) * turn * turn > limit;
}

}  // namespace

Present linearize(const Graph& graph, const Edge& edge) { return present(graph, edge); }

Pulls pulls(const Present& now) {
    const Vector& g = now.g;
    const Triple first{g.x, g.y, now.u.x * g.x + now.u.y * g.y + g.t};
    if (now.one_ended) [[unlikely]]
        return {{first, {}}};
    return {{first, {-now.c * g.x - now.s * g.y, -now.c * g.y + now.s * g.x, -g.t}}};
}

Evaluated evaluate(const Graph& graph, Edge& edge, double limit, const Bent& bent) {
    const Present now = present(graph, edge);
    const double change = now.cost - edge.cost;
    edge.cost = now.cost;
    edge.squares = now.squares;
    if (outdated(graph, edge, now, limit)) return {pulls(now), change, true};
    const double size = graph.nodes[edge.ends[0]].heading_std;
    const Curvature next = curvature(edge, now, bent);
    const double away = std::abs(next.h.x - edge.linear.h.x) + std::abs(next.h.y - edge.linear.h.y);
    const double moved =
        std::abs(next.gamma - edge.linear.gamma) * size + 2 * away / std::sqrt(edge.omega.xx + edge.omega.yy);
    return {pulls(now), change, size * moved * size * moved > limit};
}

void relinearize(Graph& graph, Edge& edge, const Bent& bent) {
    const Present now = present(graph, edge);
    add_diagonal(graph, edge, -1.0);
    const Curvature second = curvature(edge, now, bent);
    edge.weight = now.weight;
    const bool bent_kernel = edge.robust && bent.edges != Bent::Edges::none;
    edge.linear = {edge.robust ? robust_information(graph, edge, now, bent_kernel) : information(graph, edge, now),
                   bent_kernel,
                   now.u,
                   now.n,
                   now.c,
                   now.s,
                   second.gamma,
                   second.h};
    add_diagonal(graph, edge, 1.0);
}

bool differs_from_gauss_newton(const Graph& graph, const Edge& edge, double limit) {
    if (edge.linear.bent || edge.linear.gamma != 0.0 || edge.linear.h.x != 0.0 || edge.linear.h.y != 0.0) return true;
    return outdated(graph, edge, linearize(graph, edge), limit);
}

Blocks diagonal_blocks(const Edge& edge) {
    const auto& [W, bent, u, n, c, s, gamma, h] = edge.linear;
    const Vector a = W * Vector{u.x, u.y, 1.0};
    const Symmetric first{W.xx, W.xy, W.yy, a.x - h.x, a.y - h.y, u.x * a.x + u.y * a.y + a.t + gamma};
    return {first, edge.one_ended() ? Symmetric{} : turned_back({c, s}, W)};
}

// B_i' W B_j
std::array<double, 9> block_between(const Edge& edge) {
    if (edge.one_ended()) return {};
    const auto& [W, bent, u, n, c, s, gamma, h] = edge.linear;
    const Vector a = W * Vector{u.x, u.y, 1.0};
    const double x = a.x - h.x, y = a.y - h.y;
    return {-(W.xx * c + W.xy * s), W.xx * s - W.xy * c, -W.xt,  //
            -(W.xy * c + W.yy * s), W.xy * s - W.yy * c, -W.yt,  //
            -(x * c + y * s),       x * s - y * c,       -a.t};
}

}  // namespace vmslam::online
