#include "vmslam/solve/start.hpp"

#include <algorithm>
#include <cmath>

#include "vmslam/edges/rotations.hpp"

namespace vmslam::solve {

using namespace edges;

bool follow_headings(const Relations& edges, std::span<double> headings, std::span<bool> known) {
    for (std::size_t k = 0; k < edges.first.size(); ++k) {
        const Index i = edges.first[k], j = edges.second[k];
        if (known[i] == known[j] || !(edges.information[k] > 0)) return false;
        if (known[i])
            headings[j] = wrap(headings[i] + edges.value[k]);
        else
            headings[i] = wrap(headings[j] - edges.value[k]);
        known[i] = known[j] = true;
    }
    return true;
}

StartSystem::StartSystem(std::span<const Index> start, std::shared_ptr<const sparse::Symbolic> symbolic)
    : start_(start.begin(), start.end()),
      values_(4 * start.back()),
      xi_(2 * (start.size() - 1)),
      factor_(std::move(symbolic)) {}

void StartSystem::add_headings(const Relations& edges, std::span<const double> unit) {
    for (std::size_t k = 0; k < edges.first.size(); ++k) {
        const Index i = edges.first[k], j = edges.second[k];
        const double w = edges.information[k], c = w * std::cos(edges.value[k]), s = w * std::sin(edges.value[k]);
        for (const Index node : {i, j}) {
            diagonal(node)[0] += w;
            diagonal(node)[3] += w;
        }
        // the block of first and second is -w R', transposed where second < first
        double* const V = block(edges.pairs[k]);
        const double q = i < j ? s : -s;
        V[0] -= c;
        V[1] -= q;
        V[2] += q;
        V[3] -= c;
        const double *const a = unit.data() + 2 * i, *const b = unit.data() + 2 * j;
        xi_[2 * i] += c * b[0] + s * b[1] - w * a[0];
        xi_[2 * i + 1] += c * b[1] - s * b[0] - w * a[1];
        xi_[2 * j] += c * a[0] - s * a[1] - w * b[0];
        xi_[2 * j + 1] += s * a[0] + c * a[1] - w * b[1];
    }
}

void StartSystem::add_positions(const Relations& edges, std::span<const double> position) {
    for (std::size_t k = 0; k < edges.first.size(); ++k) {
        const Index i = edges.first[k], j = edges.second[k];
        const double* const W = edges.information.data() + 4 * k;
        const double *const a = position.data() + 2 * i, *const b = position.data() + 2 * j;
        const double ex = b[0] - a[0] - edges.value[2 * k], ey = b[1] - a[1] - edges.value[2 * k + 1];
        const double fx = W[0] * ex + W[1] * ey, fy = W[1] * ex + W[3] * ey;
        for (int r = 0; r < 4; ++r) {
            diagonal(i)[r] += W[r];
            diagonal(j)[r] += W[r];
            block(edges.pairs[k])[r] -= W[r];
        }
        xi_[2 * i] += fx;
        xi_[2 * i + 1] += fy;
        xi_[2 * j] -= fx;
        xi_[2 * j + 1] -= fy;
    }
}

void StartSystem::hold(std::span<const Index> blocks, std::span<const Index> nodes, std::span<const Index> untied) {
    for (const Index k : blocks) std::fill_n(block(k), 4, 0.0);
    for (const Index node : nodes) xi_[2 * node] = xi_[2 * node + 1] = 0.0;
    for (const auto rest : {nodes, untied})
        for (const Index node : rest) diagonal(node)[0] = diagonal(node)[3] = 1.0;
}

Index StartSystem::solve(std::span<double> correction) {
    const Index bad = factor_.factorize(values_);
    if (bad >= 0) return factor_.symbolic().order[bad / 2];
    const bool finite = factor_.solve(xi_, correction);
    std::fill(values_.begin(), values_.end(), 0.0);
    std::fill(xi_.begin(), xi_.end(), 0.0);
    return finite ? -1 : 0;
}

void turn_to_world(std::span<const double> state, std::span<const Index> first, std::span<const double> measured,
                   std::span<const double> information, int rows, std::span<double> offset, std::span<double> omega) {
    Rotations axes_of(first.size(), [&](std::size_t k) { return state[3 * first[k] + 2]; });
    for (std::size_t k = 0; k < first.size(); ++k) {
        const Rotation axes = axes_of[k];
        const double *const z = measured.data() + k * rows, *const W = information.data() + k * rows * rows;
        offset[2 * k] = axes.c * z[0] - axes.s * z[1];
        offset[2 * k + 1] = axes.s * z[0] + axes.c * z[1];
        const Symmetric V = turned(axes, {W[0], W[1], W[rows + 1], 0.0, 0.0, 0.0});
        omega[4 * k] = V.xx;
        omega[4 * k + 1] = omega[4 * k + 2] = V.xy;
        omega[4 * k + 3] = V.yy;
    }
}

}  // namespace vmslam::solve
