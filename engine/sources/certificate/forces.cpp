#include <algorithm>
#include <numbers>

#include "vmslam/certificate/quadratic_bound.hpp"
#include "vmslam/edges/rotations.hpp"

namespace vmslam::certificate {

constexpr double pi = std::numbers::pi;
/// The part of beta and of kappa that absorbs rounding errors.
constexpr double absorbed = 1e-9;
/// How far abs(u) must stay below pi.
constexpr double half_turn = pi - 1e-6;
/// Shares to try for one edge, where its own split leaves no curvature in the heading.
constexpr double more_shares[] = {0.5, 0.8, 0.95, 0.99};

void State::set(std::span<const double> values, Complex origin) {
    const std::size_t count = values.size() / 3;
    nodes_.resize(1 + count);
    // the errors of z, up to 1e-15 or rounding of the heading, are part of those of places and headings in `force`
    edges::Rotations axes(count, [&](std::size_t i) { return values[3 * i + 2]; });
    for (std::size_t i = 0; i < count; ++i) {
        const double* const x = values.data() + 3 * i;
        nodes_[1 + i] = {{axes[i].c, axes[i].s}, Complex{x[0], x[1]} - origin, x[2]};
    }
}

Split split(const edges::Symmetric& w, double share) {
    const double o00 = w.xx, o01 = w.xy, o11 = w.yy, o02 = w.xt, o12 = w.yt, o22 = w.tt;
    const double mean = (o00 + o11) / 2, half = (o00 - o11) / 2, largest = mean + std::sqrt(half * half + o01 * o01);
    // the determinant has an error of 3 units in o00 o11, and largest, of 4 units, is at least as large as both
    const double smallest = largest > 0 ? (o00 * o11 - o01 * o01) / largest - 16 * roundoff * std::min(o00, o11) : 0.0;
    if (o02 == 0 && o12 == 0) return {smallest > 0 ? smallest : -1.0, o22};
    if (!(smallest > 0)) return {-1.0, 0.0};
    const double beta = (1 - share) * smallest;
    const double determinant = (smallest - beta) * (largest * (1 - 8 * roundoff) - beta);
    if (!(determinant > 0)) return {-1.0, 0.0};
    const double m00 = o00 - beta, m11 = o11 - beta;
    const double first = o02 * o02 * m11, second = 2 * o02 * o12 * o01, third = o12 * o12 * m00;
    const double size = (first + std::abs(second) + third) / determinant;
    return {beta, o22 - (first - second + third) / determinant - 16 * roundoff * (o22 + size)};
}

Force force(const Node& a, const Node& b, const Edge& edge) {
    const edges::Symmetric& w = edge.information;
    Force f;
    f.reached = conj(a.z) * (b.t + b.z * edge.d_b - a.t);
    const Complex v = f.reached - edge.d_a;
    const double size = length(a.t) + length(b.t) + length(edge.d_a) + 2 * length(edge.d_b) + length(f.reached) + length(v);
    f.place_error = 16 * roundoff * size;
    f.heading_error = 0.0;
    double h = 0.0;
    if (edge.oriented) {
        h = edges::wrap(b.heading - a.heading - edge.turn);
        f.heading_error = 16 * roundoff * (std::abs(a.heading) + std::abs(b.heading) + std::abs(edge.turn) + pi);
    }
    f.p = {dot(w.xx, w.xy, w.xt, v.real(), v.imag(), h), dot(w.xy, w.yy, w.yt, v.real(), v.imag(), h)};
    f.g = dot(w.xt, w.yt, w.tt, v.real(), v.imag(), h);
    f.cost = f.p.real() * v.real() + f.p.imag() * v.imag() + f.g * h;
    f.zero = (f.p == Complex{} || length(v) <= f.place_error) && (f.g == 0 || std::abs(h) <= f.heading_error);
    // The function touches J_e at the computed residual. Its value at the state differs by the errors of v times p and g.
    // An error of g counts by the range of e_theta; those of p are absorbed by beta.
    const double rows = std::abs(w.xx) + 2 * std::abs(w.xy) + std::abs(w.yy) + std::abs(w.xt) + std::abs(w.yt);
    const double p_size = length(f.p), v_size = length(v), unit = 4 * roundoff * (4 * roundoff);
    f.p_error = 2 * roundoff * p_size + unit * rows * (v_size + std::abs(h));
    const double g_error =
        2 * roundoff * std::abs(f.g) + unit * ((std::abs(w.xt) + std::abs(w.yt)) * v_size + std::abs(w.tt * h));
    f.slack = 3 * p_size * f.place_error + 3 * std::abs(f.g) * f.heading_error + f.p_error * v_size + 16 * g_error;
    return f;
}

Curvature curvature(const Edge& edge, const Force& force, double share) {
    const edges::Symmetric& w = edge.information;
    const bool oriented = edge.oriented;
    const bool coupled = w.xt != 0 || w.yt != 0;
    const double g = std::abs(force.g);
    auto [beta, kappa] = split(w, share);
    for (const double other : more_shares) {
        if (!oriented || !coupled || !(beta > 0) || g < half_turn * kappa) break;
        if (other > share) {
            const Split again = split(w, other);
            beta = again.beta, kappa = again.kappa;
        }
    }
    Curvature out{beta, 0.0, 0.0, 0.0};
    // an edge may measure the heading alone, or nothing about it
    if (w.xx == 0 && w.xy == 0 && w.yy == 0 && !coupled) {
        out.beta = 0.0;
    } else if (beta > 0) {
        // with w0 the rounding error of w, beta |w|² - 2 p_error |w| is at least (1 - absorbed) beta |w - w0|² - slack
        const double lost = force.p_error + beta * force.place_error;
        out.slack = lost * lost / (absorbed * beta) + beta * (force.place_error * force.place_error);
        out.beta *= 1 - absorbed;
    }
    if (!oriented || (force.g == 0 && kappa == 0)) return out;
    const double absorbing = absorbed * kappa;
    kappa -= absorbing;
    if (!(g < half_turn * kappa)) {
        out.beta = -1.0;
        return out;
    }
    const double u = force.g / kappa;
    if (std::abs(u) < 1e-4) {
        // u / tan u >= 1 - u² for these u
        out.A = kappa * (1 - u * u);
        out.error = kappa;
    } else {
        const double sine = std::sin(u), ratio = u / sine;
        out.A = kappa * u * (std::cos(u) / sine);
        out.error = kappa + std::abs(out.A) + kappa * (ratio * ratio);
    }
    // cos f changes with the rounding of f by less than a part of f²
    const double lost = std::abs(out.A) * force.heading_error;
    out.slack += lost * lost / absorbing + 2 * lost * force.heading_error;
    return out;
}

}  // namespace vmslam::certificate
