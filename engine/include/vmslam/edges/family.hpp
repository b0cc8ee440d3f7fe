// What all edge families have in common.
#pragma once

#include <memory>
#include <span>
#include <utility>

#include "vmslam/edges/constant.hpp"
#include "vmslam/edges/robust.hpp"

namespace vmslam::edges {

/// The values of all nodes, (x, y, heading) each. Some information matrices depend on them: they are evaluated at the
/// `reference`, which a damped search keeps fixed during a step, so that the function that it minimises stays the same.
struct State {
    const double* at;
    const double* reference;

    const double* node(Index i) const { return at + 3 * i; }
    const double* reference_of(Index i) const { return reference + 3 * i; }
};

/// A measured difference of the headings of two nodes, from which initial values are computed.
struct HeadingRelation {
    Index first, second;
    double value, information;
};

/// A measured difference of the places of two nodes, in world axes, and its information.
struct PositionRelation {
    Index first, second;
    double x, y, xx, xy, yy;
};

/// Edges of one kind. All of them write e' Omega e into the cost, B' Omega B into Omega and -B' Omega e into xi.
class Family {
   public:
    virtual ~Family() = default;

    /// The edges added to a system, where one is given, and their cost. `pairs` has the block between the two ends of each
    /// edge, for the families that list their edges.
    virtual double accumulate(const State& state, System* system, std::span<const Index> pairs) const = 0;

    /// Whether they add their second derivatives where a system asks for them; no by default.
    virtual bool curves() const { return false; }

    /// The relative headings that the edges measure; none by default.
    virtual std::vector<HeadingRelation> headings() const { return {}; }
    /// The relative positions that they measure, with the headings of a state; none by default.
    virtual std::vector<PositionRelation> positions(const double* /* state */) const { return {}; }
    /// The number of measurements, each of which may be wrong by itself; 0 where none is.
    virtual std::size_t measurements() const { return 0; }
    /// The same edges with a trust from 0 to 1 in each measurement, a factor on its information. None where no measurement
    /// may be wrong.
    virtual std::unique_ptr<const Family> trusting(std::span<const double> /* trust */) const { return nullptr; }
    /// The edges between the nodes that have a new number, not -1, with these numbers. None where they cannot be divided.
    virtual std::unique_ptr<const Family> among(std::span<const Index> /* number */) const { return nullptr; }
    /// r² of each measurement at a state, as if it were fully trusted. The trust places landmarks that are no nodes.
    virtual std::vector<double> squares(const double* /* state */, std::span<const double> /* trust */) const { return {}; }
    /// Append the edges with constant information at a state of `nodes` nodes; false where there is no such form. A kernel
    /// keeps the weights that it has there, and landmarks that become nodes have the numbers from `nodes` on.
    virtual bool constant(const double* /* state */, Index /* nodes */, ConstantEdges& /* out */) const { return false; }
};

/// Edges of nodes i, or of nodes i and j, each of which has information `omega` and may be wrong, with one kernel. `Own` is the
/// family that they make.
template <class Own, class Edge>
class EdgeList : public Family {
   public:
    std::size_t measurements() const override { return edges_.size(); }
    std::unique_ptr<const Family> trusting(std::span<const double> trust) const override {
        auto out = std::make_unique<Own>(static_cast<const Own&>(*this));
        for (std::size_t k = 0; k < edges_.size(); ++k) out->edges_[k].omega = trust[k] * edges_[k].omega;
        return out;
    }
    std::unique_ptr<const Family> among(std::span<const Index> number) const override {
        auto out = std::make_unique<Own>(static_cast<const Own&>(*this));
        out->edges_.clear();
        for (Edge edge : edges_) {
            edge.i = number[edge.i];
            if constexpr (requires { edge.j; }) {
                edge.j = number[edge.j];
                if (edge.j < 0) continue;
            }
            if (edge.i >= 0) out->edges_.push_back(edge);
        }
        return out;
    }
    std::vector<double> squares(const double* state, std::span<const double> /* trust */) const override {
        std::vector<ConstantEdge> own;
        list(own);
        std::vector<double> out;
        for (const ConstantEdge& edge : own) out.push_back(edge.squares(state));
        return out;
    }
    bool constant(const double* state, Index /* nodes */, ConstantEdges& out) const override {
        const std::size_t before = out.edges.size();
        if (!list(out.edges)) return false;
        if (kernel_)
            for (ConstantEdge& edge : std::span(out.edges).subspan(before))
                edge.information = kernel_.weight(edge.squares(state)) * edge.information;
        return true;
    }

   protected:
    /// Append the edges without their kernel; false where they do not have this form.
    virtual bool list(std::vector<ConstantEdge>& /* to */) const { return false; }

    std::vector<Edge> edges_;
    Kernel kernel_;

   private:
    // only the family itself is made of it
    friend Own;
    EdgeList(std::vector<Edge> edges, Kernel kernel) : edges_(std::move(edges)), kernel_(kernel) {}
};

}  // namespace vmslam::edges
