#include "vmslam/solve/start.hpp"

namespace vmslam::solve {

using namespace edges;

bool follow_headings(const Relations& edges, std::span<double> headings, std::span<bool> known) {
    for (std::size_t k = 0; k < edges.first.size(); ++k) {
        const Place i = edges.first[k], j = edges.second[k];
        if (known[i] == known[j] || !(edges.information[k] > 0)) return false;
        if (known[i])
            headings[j] = wrap(headings[i] + edges.value[k]);
        else
            headings[i] = wrap(headings[j] - edges.value[k]);
        known[i] = known[j] = true;
    }
    return true;
}

void add_headings(const Relations& edges, std::span<const double> unit, System& system) {
    for (std::size_t k = 0; k < edges.first.size(); ++k) {
        const Place i = edges.first[k], j = edges.second[k];
        const double w = edges.information[k], c = w * std::cos(edges.value[k]), s = w * std::sin(edges.value[k]);
        for (const Place node : {i, j}) {
            system.diagonal(node)[0] += w;
            system.diagonal(node)[4] += w;
        }
        // the block of first and second is -w R', transposed where second < first
        double* const V = system.block(edges.pairs[k]);
        const double q = i < j ? s : -s;
        V[0] -= c;
        V[1] -= q;
        V[3] += q;
        V[4] -= c;
        const double *const a = unit.data() + 2 * i, *const b = unit.data() + 2 * j;
        system.xi[3 * i] += c * b[0] + s * b[1] - w * a[0];
        system.xi[3 * i + 1] += c * b[1] - s * b[0] - w * a[1];
        system.xi[3 * j] += c * a[0] - s * a[1] - w * b[0];
        system.xi[3 * j + 1] += s * a[0] + c * a[1] - w * b[1];
    }
}

void add_positions(const Relations& edges, std::span<const double> position, System& system) {
    for (std::size_t k = 0; k < edges.first.size(); ++k) {
        const Place i = edges.first[k], j = edges.second[k];
        const double* const omega = edges.information.data() + 4 * k;
        const Symmetric W{omega[0], omega[1], omega[3], 0.0, 0.0, 0.0};
        const double *const a = position.data() + 2 * i, *const b = position.data() + 2 * j;
        const Vector e{b[0] - a[0] - edges.value[2 * k], b[1] - a[1] - edges.value[2 * k + 1], 0.0};
        add_point(system, i, j, edges.pairs[k], W, W * e, {0.0, 0.0});
    }
}

void turn_to_world(std::span<const double> state, std::span<const Place> first, std::span<const double> measured,
                   std::span<const double> information, int rows, std::span<double> offset, std::span<double> omega) {
    for (std::size_t k = 0; k < first.size(); ++k) {
        const Rotation axes(state[3 * first[k] + 2]);
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
