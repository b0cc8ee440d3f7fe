// Inverses of covariances, and edges that also depend on parameters, against dense matrices; second derivatives of edges against
// differences.
#include <algorithm>
#include <cmath>
#include <limits>
#include <random>
#include <vector>

#include "expect.hpp"
#include "vmslam/edges/inverses.hpp"
#include "vmslam/edges/linearized.hpp"
#include "vmslam/edges/polar.hpp"
#include "vmslam/edges/single_numbers.hpp"
#include "vmslam/solve/graph.hpp"
#include "vmslam/sparse/pattern.hpp"

namespace {

using namespace vmslam;
using edges::Index;
using Numbers = std::vector<double>;

Numbers drawn(std::mt19937& random, std::size_t count) {
    Numbers numbers(count);
    for (double& number : numbers) number = std::normal_distribution<>()(random);
    return numbers;
}

/// F F' + I for a random F, scaled by 10 to the power of -6 to 6 in each row and column.
Numbers covariance(std::mt19937& random, std::size_t d) {
    const Numbers F = drawn(random, d * d);
    Numbers scale(d), C(d * d);
    for (double& s : scale) s = std::pow(10.0, std::uniform_real_distribution<>(-6, 6)(random));
    for (std::size_t i = 0; i < d; ++i)
        for (std::size_t j = 0; j < d; ++j) {
            C[i * d + j] = i == j;
            for (std::size_t k = 0; k < d; ++k) C[i * d + j] += F[i * d + k] * F[j * d + k];
            C[i * d + j] *= scale[i] * scale[j];
        }
    return C;
}

void test_inverses(std::mt19937& random, unsigned seed) {
    const std::size_t d = 1 + random() % 3;
    const Numbers C = covariance(random, d);
    Numbers W(d * d);
    expect(edges::inverses(C, d, 1e-13, W) == -1, "a covariance has an inverse", seed);
    for (std::size_t i = 0; i < d; ++i)
        for (std::size_t j = 0; j < d; ++j) {
            double product = 0.0;
            for (std::size_t k = 0; k < d; ++k) product += C[i * d + k] * W[k * d + j];
            const double size = std::sqrt(C[i * d + i] / C[j * d + j]);
            expect(std::abs(product - (i == j)) < 1e-11 * size, "C W = I", seed);
        }
}

void test_limits() {
    constexpr double infinite = std::numeric_limits<double>::infinity(), unknown = std::numeric_limits<double>::quiet_NaN();
    Numbers W(1);
    for (const double good : {1e-300, 1.0, 1.7e308})
        expect(edges::inverses(Numbers{good}, 1, 1e-13, W) == -1 && std::abs(W[0] * good - 1) < 1e-12, "limits", 0);
    for (const double bad : {-1.0, 0.0, 1e-320, infinite, -infinite, unknown})
        expect(edges::inverses(Numbers{bad}, 1, 1e-13, W) == 0, "no inverse", 0);
    Numbers several(2);
    expect(edges::inverses(Numbers{1.0, 0.0}, 1, 1e-13, several) == 1, "the number of the wrong one", 0);
    expect(edges::inverses({}, 3, 1e-13, {}) == -1, "no matrices", 0);
}

/// Edges between random pairs of nodes, the lower or the upper one first, against the product of dense Jacobians.
void test_sums(std::mt19937& random, unsigned seed) {
    const std::size_t d = 2 + random() % 2, E = random() % 20, K = random() % 12, n = 2 + random() % 6, N = 3 * n + K;
    std::vector<Index> first(E), second(E), members;
    for (std::size_t k = 0; k < E; ++k) {
        first[k] = static_cast<Index>(random() % n);
        second[k] = static_cast<Index>((first[k] + 1 + random() % (n - 1)) % n);
        members.insert(members.end(), {std::min(first[k], second[k]), std::max(first[k], second[k])});
    }
    const auto pattern = sparse::pattern_of_groups(static_cast<Index>(n), std::vector<Index>(E, 2), members);
    std::vector<Index> pairs(E);
    for (std::size_t k = 0; k < E; ++k) pairs[k] = sparse::block_between(pattern, first[k], second[k]);
    const Numbers e = drawn(random, E * d), A = drawn(random, 3 * E * d), B = drawn(random, 3 * E * d);
    const Numbers P = drawn(random, E * d * K);
    Numbers W;
    for (std::size_t k = 0; k < E; ++k) {
        const Numbers one = covariance(random, d);
        W.insert(W.end(), one.begin(), one.end());
    }
    Numbers values(9 * pattern.rows.size()), xi(3 * n), mixed(3 * n * K), own(K * K), gradient(K);
    edges::System system{pattern, values.data(), xi.data()};
    edges::add({first, second, pairs, d, K, e.data(), A.data(), B.data(), P.data(), W.data()}, system,
               {mixed.data(), own.data(), gradient.data()});

    Numbers whole(N * N), right(N), size(N * N), right_size(N);
    for (std::size_t k = 0; k < E; ++k) {
        Numbers jacobian(d * N);
        for (std::size_t r = 0; r < d; ++r) {
            for (std::size_t c = 0; c < 3; ++c) {
                jacobian[r * N + 3 * first[k] + c] = A[3 * (k * d + r) + c];
                jacobian[r * N + 3 * second[k] + c] = B[3 * (k * d + r) + c];
            }
            for (std::size_t c = 0; c < K; ++c) jacobian[r * N + 3 * n + c] = P[(k * d + r) * K + c];
        }
        for (std::size_t i = 0; i < N; ++i)
            for (std::size_t r = 0; r < d; ++r)
                for (std::size_t q = 0; q < d; ++q) {
                    const double pull = jacobian[r * N + i] * W[(k * d + r) * d + q];
                    right[i] -= pull * e[k * d + q];
                    right_size[i] += std::abs(pull * e[k * d + q]);
                    for (std::size_t j = 0; j < N; ++j) {
                        whole[i * N + j] += pull * jacobian[q * N + j];
                        size[i * N + j] += std::abs(pull * jacobian[q * N + j]);
                    }
                }
    }
    const auto same = [&](double found, std::size_t i, std::size_t j, const char* what) {
        expect(std::abs(found - whole[i * N + j]) <= 1e-12 * size[i * N + j], what, seed);
    };
    for (std::size_t j = 0; j < n; ++j)
        for (Index p = pattern.start[j]; p < pattern.start[j + 1]; ++p)
            for (std::size_t c = 0; c < 9; ++c) same(values[9 * p + c], 3 * pattern.rows[p] + c / 3, 3 * j + c % 3, "Omega");
    for (std::size_t i = 0; i < 3 * n; ++i)
        for (std::size_t c = 0; c < K; ++c) same(mixed[i * K + c], i, 3 * n + c, "mixed");
    for (std::size_t i = 0; i < K; ++i)
        for (std::size_t c = 0; c < K; ++c) same(own[i * K + c], 3 * n + i, 3 * n + c, "own");
    for (std::size_t i = 0; i < N; ++i) {
        const double found = i < 3 * n ? xi[i] : gradient[i - 3 * n];
        expect(std::abs(found - right[i]) <= 1e-12 * right_size[i], "the right-hand side", seed);
    }
}

/// A graph of three nodes with edges of one family.
solve::Graph graph_of_family(std::mt19937& random) {
    solve::Graph graph(3);
    const auto normal = [&] { return std::normal_distribution<>()(random); };
    const edges::Kernel kernel{static_cast<edges::Robust>(random() % 4), 1.0 + 0.5 * normal() * normal()};
    const std::vector<Index> first{0, 2, 1}, second{1, 0, 2};
    const unsigned kind = random() % 6;
    std::vector<edges::RelativeEdge> relative;
    std::vector<edges::Position> positions;
    std::vector<edges::NumberEdge> numbers;
    edges::Sightings seen{{}, {}, {}, {0.02, 0.1, 0.3, 0.2, 0.3, -0.2}, kernel, random() % 2 == 0};
    for (std::size_t k = 0; k < 3; ++k) {
        const edges::Vector z{normal(), normal(), normal()};
        const edges::Lever lever{normal(), normal()};
        const bool oriented = kind == 0;
        edges::Symmetric omega = edges::outer(1.0, {normal(), normal(), oriented ? normal() : 0.0});
        omega = omega + edges::Symmetric{1.0, 0.0, 1.0, 0.0, 0.0, oriented ? 1.0 : 0.0};
        relative.push_back({first[k], second[k], z, omega});
        positions.push_back({first[k], z, omega, lever});
        numbers.push_back({first[k], second[k], std::abs(z.x), 2.0 + z.y * z.y, lever});
        seen.z.push_back({1.0 + z.x * z.x, z.y, z.t});
        seen.noisy.push_back({1.0 + z.y * z.y, 0.0, 0.0});
        seen.trust.push_back(0.3 + 0.1 * static_cast<double>(k));
    }
    if (kind < 2) graph.add_relative(relative, kernel, kind == 0);
    if (kind == 2) graph.add_pairs(std::make_unique<edges::PositionEdges>(positions, kernel));
    if (kind == 3 || kind == 4) {
        const auto number = kind == 3 ? edges::Number::range : edges::Number::bearing;
        graph.add_pairs(std::make_unique<edges::NumberEdges>(number, numbers, kernel), first, second);
    }
    if (kind == 5) graph.add_pairs(std::make_unique<edges::PolarEdges>(first, second, seen), first, second);
    return graph;
}

/// Omega with second derivatives is the derivative of -xi.
void test_second_derivatives(std::mt19937& random, unsigned seed) {
    const solve::Graph graph = graph_of_family(random);
    solve::Graph::Assembled assembled(graph);
    solve::GraphObjective& objective = *assembled.objective;
    expect(objective.curves(), "the family has second derivatives", seed);
    Numbers state = drawn(random, 9);
    objective.curve(true);
    objective.linearize(state, state);
    const edges::System& system = objective.system();
    const Numbers values(system.values, system.values + 9 * system.rows.size());
    double largest = 1.0;
    for (const double value : values) largest = std::max(largest, std::abs(value));
    for (std::size_t j = 0; j < 9; ++j) {
        constexpr double h = 1e-6;
        const double at = state[j];
        Numbers difference(9);
        for (const double sign : {-1.0, 1.0}) {
            state[j] = at + sign * h;
            objective.linearize(state, state);
            for (std::size_t i = 0; i < 9; ++i) difference[i] -= sign * objective.xi()[i] / (2 * h);
        }
        state[j] = at;
        for (Index p = system.start[j / 3]; p < system.start[j / 3 + 1]; ++p)
            for (std::size_t r = 0; r < 3; ++r) {
                const double found = values[9 * p + 3 * r + j % 3], expected = difference[3 * system.rows[p] + r];
                expect(std::abs(found - expected) < 1e-5 * largest, "second derivatives", seed);
            }
    }
}

}  // namespace

void test_linearized() {
    std::mt19937 random(1);
    for (unsigned seed = 0; seed < 300; ++seed) {
        random.seed(seed);
        test_inverses(random, seed);
        test_sums(random, seed);
        test_second_derivatives(random, seed);
    }
    test_limits();
}
