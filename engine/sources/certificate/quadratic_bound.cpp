#include "vmslam/certificate/quadratic_bound.hpp"
#include "vmslam/sparse/pattern.hpp"

namespace vmslam::certificate {
namespace {

/// The function in work.
struct Sum {
    const sparse::Pattern& pattern;
    QuadraticBound& out;

    Complex* block(Index k) { return out.values.data() + 4 * k; }
    Complex* diagonal(Index node) { return block(pattern.start[node + 1] - 1); }

    /// Add [position, corner; conj(corner), beta] to a diagonal block.
    void add_diagonal(Index node, double position, Complex corner, double beta) {
        Complex* const d = diagonal(node);
        d[0] += position;
        d[1] += corner;
        d[2] += conj(corner);
        d[3] += beta;
    }

    /// Half the gradient at a node.
    void pull(Index node, Complex by_heading, Complex by_position) {
        out.gradient[2 * node] += by_heading;
        out.gradient[2 * node + 1] += by_position;
    }

    /// Add the block [q00, q01; q10, -beta] of the nodes a and b, which is stored above the diagonal.
    void add_between(Index a, Index b, Complex q00, Complex q01, Complex q10, double beta) {
        Complex* const V = block(sparse::block_between(pattern, a, b));
        V[0] += a < b ? q00 : conj(q00);
        V[1] += a < b ? q01 : conj(q10);
        V[2] += a < b ? q10 : conj(q01);
        V[3] -= beta;
    }
};

}  // namespace

void write_quadratic_bound(const State& state, std::span<const Edge> edges, std::span<const char> free,
                           const sparse::Pattern& pattern, std::span<const Force> forces,
                           std::span<const Curvature> curvatures, QuadraticBound& out) {
    const std::size_t n = state.size();
    Sum sum{pattern, out};
    out.values.assign(4 * pattern.rows.size(), 0.0);
    out.gradient.assign(2 * n, 0.0);
    out.scale.assign(2 * n, 0.0);
    out.error.assign(2 * n, 0.0);
    out.touched = out.slack = 0.0;
    double rest = 0.0;
    for (std::size_t e = 0; e < edges.size(); ++e) {
        const auto& [a, b, start, d_b, turn, oriented, information] = edges[e];
        const Force& force = forces[e];
        const auto [beta, A, A_error, split_slack] = curvatures[e];
        const Complex p = force.p, reached = force.reached;
        const double g = force.g;
        // J_e >= 0 is the bound that remains
        if (beta < 0) continue;
        const Exact touched = two_sum(out.touched, force.cost);
        out.touched = touched.value;
        rest += touched.error;
        out.slack += force.slack + split_slack + 8 * roundoff * std::abs(force.cost);
        // a constant
        if (a == b) continue;
        const Complex za = state[a].z, zb = state[b].z;
        const double strength = length(p), reach = length(reached), pulled = strength * (reach + length(d_b));
        // of p times the rounding error of the place, in units of 64
        const double far = strength * force.place_error / (64 * roundoff);
        const double curved = 4 * A_error + 4 * std::abs(g) + (beta > 0 ? strength * strength / beta : 0.0);
        if (a >= 0 && free[a]) {
            sum.add_diagonal(a, beta * (reach * reach) + A - (conj(p) * reached).real(), beta * conj(reached) - conj(p),
                             beta);
            sum.pull(a, za * Complex{0.0, -(p * conj(reached)).imag() - g}, -(p * za));
            out.scale[2 * a] += 4 * beta * (reach * reach) + curved + 2 * pulled;
            out.scale[2 * a + 1] += 8 * beta;
            out.error[2 * a] += 2 * pulled + std::abs(g) + far;
            out.error[2 * a + 1] += 2 * strength;
        }
        if (free[b]) {
            const Complex force_b = conj(zb) * za * p * conj(d_b);
            sum.add_diagonal(b, beta * square(d_b) + A - force_b.real(), beta * conj(d_b), beta);
            sum.pull(b, zb * Complex{0.0, force_b.imag() + g}, p * za);
            // without a heading row and a lever, the node has no heading
            if (oriented || !(d_b == Complex{})) out.scale[2 * b] += 4 * beta * square(d_b) + curved + 2 * pulled;
            out.scale[2 * b + 1] += 8 * beta;
            out.error[2 * b] += 2 * pulled + std::abs(g);
            out.error[2 * b + 1] += 2 * strength;
        }
        if (a >= 0 && free[a] && free[b]) {
            const Complex to = conj(p) - beta * conj(reached);
            sum.add_between(a, b, to * d_b + Complex{-A, -g} * za * conj(zb), to, -(beta * d_b), beta);
        }
    }
    out.touched += rest;
    out.slack *= 1 + 4 * static_cast<double>(edges.size()) * roundoff;
}

}  // namespace vmslam::certificate
