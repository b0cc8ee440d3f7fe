// Whether a state is a global minimum of a cost of edges with constant information, without Python.
//
// The bound is that of `graphslam/solvers/certificate.py`, with one split of the information for all edges; the first of a few
// that proves it counts. Where edges have to choose their splits, only Python finds the proof.
#pragma once

#include <algorithm>
#include <cmath>
#include <memory>
#include <numeric>
#include <utility>
#include <vector>

#include "vmslam/certificate/minorant.hpp"
#include "vmslam/certificate/proof.hpp"
#include "vmslam/edges/relative.hpp"
#include "vmslam/sparse/factor.hpp"
#include "vmslam/sparse/ordering.hpp"
#include "vmslam/sparse/pattern.hpp"

namespace vmslam::certificate {

/// Edges with constant information in the axes of their first node, one after another.
class EdgeList {
   public:
    void add(Place first, Place second, const edges::Vector& start, const edges::Vector& end, double turn, bool oriented,
             const edges::Symmetric& W) {
        first_.push_back(first), second_.push_back(second);
        start_.insert(start_.end(), {start.x, start.y}), end_.insert(end_.end(), {end.x, end.y});
        turn_.push_back(turn), oriented_.push_back(oriented);
        information_.insert(information_.end(), {W.xx, W.xy, W.yy, W.xt, W.yt, W.tt});
    }
    /// The edges, with the place where their marks are kept; both live as long as this list.
    Edges edges() {
        marks_ = std::make_unique<bool[]>(oriented_.size());
        std::copy(oriented_.begin(), oriented_.end(), marks_.get());
        return {first_, second_, start_, end_, turn_, {marks_.get(), oriented_.size()}, information_};
    }

   private:
    std::vector<Place> first_, second_;
    std::vector<double> start_, end_, turn_, information_;
    std::vector<bool> oriented_;
    std::unique_ptr<bool[]> marks_;
};

/// The lower bound on the cost of all states from one split, -inf where S is not proven positive definite.
class Bound {
   public:
    Bound(std::span<const double> state, const Edges& edges)
        : state_(state),
          edges_(edges),
          nodes_(static_cast<Place>(state.size() / 3)),
          free_(std::make_unique<bool[]>(nodes_)),
          forces_(forces(state, edges)) {
        std::fill_n(free_.get(), nodes_, true);
        for (const Place ends : hold_roots(edges.first, edges.second, free()))
            summation_.push_back(roundoff * (128.0 + 4.0 * static_cast<double>(ends)));
        std::vector<Place> sizes, tied;
        for (Place e = 0; e < edges.size(); ++e) {
            if (edges.first[e] < 0) continue;
            sizes.push_back(2);
            tied.push_back(std::min(edges.first[e], edges.second[e]));
            tied.push_back(std::max(edges.first[e], edges.second[e]));
        }
        pattern_ = sparse::pattern_of_groups(nodes_, sizes, tied);
        const std::vector<Node> rows(pattern_.rows.begin(), pattern_.rows.end());
        const sparse::Pattern narrow{pattern_.start, rows};
        symbolic_ = std::make_shared<const sparse::Symbolic>(
            analyze(narrow, fill_reducing(narrow), {sparse::Hermitian2::rows, sparse::Hermitian2::columns}, 1));
        for (const Node length : symbolic_->row_length) rounding_.push_back(2 * roundoff * (16.0 + 4.0 * length));
    }

    bool zero() const {
        return std::all_of(forces_.begin(), forces_.end(), [](const Force& force) { return force.zero; });
    }

    double operator()(double share) const {
        const std::vector<Curvature> curves = curvatures(edges_, forces_, share);
        const Minorant f = minorant(state_, edges_, free(), pattern_.start, pattern_.rows, forces_, curves);
        const std::vector<double> none(nodes_, 0.0);
        auto [assembled, margin] = margins(f.scale, none, summation_, rounding_, symbolic_->order);
        sparse::Factor<sparse::Hermitian2> factor(symbolic_);
        for (bool enough = false; !enough;) {
            const auto values = changed(f.values, pattern_.start, f.scale, none, assembled, margin);
            if (factor.factorize(values) >= 0) return -INFINITY;
            enough = true;
            const std::vector<double> error = errors(factor, values);
            for (std::size_t k = 0; k < margin.size(); ++k) enough = enough && error[k] <= margin[k];
            for (std::size_t k = 0; !enough && k < margin.size(); ++k)
                margin[k] = f.scale[k] > 0 ? std::max(margin[k], assembled[k] + 2 * error[k]) : 1.0;
        }
        double square = 0.0;
        for (std::size_t k = 0; k < margin.size(); ++k) {
            const double term = summation_[k / 2] * f.error[k];
            square += term * term / margin[k];
        }
        const double step = std::sqrt(factor.forward_square(f.gradient)) + 1.001 * std::sqrt(square);
        return f.touched - step * step - f.slack;
    }

   private:
    std::span<bool> free() const { return {free_.get(), static_cast<std::size_t>(nodes_)}; }

    /// A bound on the rounding errors of the factor (N, 2), see `factorize` in graphslam/linear/cholesky.py.
    std::vector<double> errors(const sparse::Factor<sparse::Hermitian2>& factor,
                               std::span<const std::complex<double>> values) const {
        const std::span<const Node> order = symbolic_->order;
        std::vector<double> weight(2 * order.size()), error(2 * order.size());
        for (std::size_t k = 0; k < order.size(); ++k)
            for (int c = 0; c < 2; ++c) {
                const double diagonal = values[4 * (pattern_.start[order[k] + 1] - 1) + 3 * c].real();
                weight[2 * k + c] = std::sqrt(rounding_[k] / diagonal);
            }
        const std::vector<double> square = factor.magnitude_square(weight);
        for (std::size_t k = 0; k < order.size(); ++k)
            for (int c = 0; c < 2; ++c)
                error[2 * order[k] + c] = 1.001 * rounding_[k] * square[2 * k + c] / weight[2 * k + c];
        return error;
    }

    std::span<const double> state_;
    Edges edges_;
    Place nodes_;
    std::unique_ptr<bool[]> free_;
    std::vector<Force> forces_;
    std::vector<double> summation_, rounding_;
    sparse::WidePattern pattern_;
    std::shared_ptr<const sparse::Symbolic> symbolic_;
};

/// The relative gap (J - bound) / J from which on a state is no proven global minimum.
inline constexpr double proven = 1e-6;

/// The best lower bound on the cost of all states that a split gives.
inline double best_bound(std::span<const double> state, EdgeList& list, double cost) {
    const Bound bound(state, list.edges());
    if (cost <= proven && bound.zero()) return cost;
    double best = 0.0;
    for (const double share : {0.3, 0.1, 0.6, 0.02, 0.8, 0.95}) {
        best = std::max(best, std::min(bound(share), cost));
        if (cost - best <= proven * cost) break;
    }
    return best;
}

}  // namespace vmslam::certificate
