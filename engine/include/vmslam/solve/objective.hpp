// What an iteration needs of the cost that it minimises.
#pragma once

#include <span>
#include <vector>

#include "vmslam/edges/family.hpp"
#include "vmslam/sparse/factor.hpp"
#include "vmslam/sparse/pattern.hpp"

namespace vmslam::solve {

using edges::Index;

/// A cost J with the linear system Omega Delta = xi. States have three numbers for each node; `reference` is the one at which
/// information that depends on the state is evaluated.
class Objective {
   public:
    virtual ~Objective() = default;

    /// Omega and xi at a state; returns J.
    virtual double linearize(std::span<const double> state, std::span<const double> reference) = 0;
    virtual double cost(std::span<const double> state, std::span<const double> reference) = 0;
    /// L L' = Omega + damping abs(diag(Omega)) of the last `linearize`; false where there is no such factor.
    virtual bool factorize(double damping) = 0;
    /// Omega^-1 xi with the last factor and the last xi; false where xi is not finite.
    virtual bool solve(std::span<double> delta) = 0;
    virtual std::span<const double> xi() = 0;
    /// The scalar diagonal of Omega, without signs.
    virtual std::vector<double> diagonal() = 0;
    /// Whether Omega can have the second derivatives of residuals and kernels, too, and whether `linearize` adds them.
    virtual bool curves() const { return false; }
    virtual void curve(bool /* on */) {}

    bool state_dependent = false;  ///< whether some information depends on the state
    bool reweighted = false;       ///< whether some edges have a robust kernel
};

/// Nodes that do not move, whose rows and columns become those of the identity, and nodes without a heading.
struct Held {
    std::span<const Index> nodes, without_heading;
};

/// The system of a graph with the memory for its numbers and its factor.
class OwnedSystem {
   public:
    /// `points` are the nodes without a heading.
    explicit OwnedSystem(sparse::OwnedPattern pattern, int threads = 1, std::span<const Index> points = {});
    OwnedSystem(const OwnedSystem&) = delete;
    OwnedSystem& operator=(const OwnedSystem&) = delete;

    edges::System view() { return {pattern_, values_.data(), xi_.data()}; }
    sparse::Factor<sparse::Real3>& factor() { return factor_; }

   private:
    sparse::OwnedPattern pattern_;
    std::vector<double> values_, xi_;
    sparse::Factor<sparse::Real3> factor_;
};

/// A graph of edge families.
class GraphObjective : public Objective {
   public:
    struct Member {
        const edges::Family* family;
        std::span<const Index> pairs;  ///< the blocks of its pairs, see `Family::accumulate`
    };

    /// `constant` is added to J, such as priors of what is not solved for.
    GraphObjective(std::vector<Member> families, edges::System system, Held held, double constant,
                   sparse::Factor<sparse::Real3>& factor)
        : families_(std::move(families)),
          system_(system),
          held_(held),
          held_blocks_(sparse::blocks_of_nodes(system, held.nodes)),
          constant_(constant),
          factor_(factor) {}
    GraphObjective(std::vector<Member> families, OwnedSystem& system, Held held = {})
        : GraphObjective(std::move(families), system.view(), held, 0.0, system.factor()) {}

    double linearize(std::span<const double> state, std::span<const double> reference) override;
    double cost(std::span<const double> state, std::span<const double> reference) override;
    bool factorize(double damping) override;
    bool solve(std::span<double> delta) override;
    std::span<const double> xi() override { return {system_.xi, 3 * nodes()}; }
    std::vector<double> diagonal() override;
    bool curves() const override;
    void curve(bool on) override { system_.curved = on; }

    const std::vector<Member>& families() const { return families_; }
    /// The same graph with other edges between the same nodes. Both use one system and one factor.
    GraphObjective with(std::vector<Member> families) const {
        GraphObjective out = *this;
        out.families_ = std::move(families);
        return out;
    }
    const edges::System& system() const { return system_; }
    const Held& held() const { return held_; }
    /// The ordering and structure of the factor.
    const sparse::Symbolic& symbolic() const { return factor_.symbolic(); }

   private:
    std::size_t nodes() const { return system_.size(); }
    std::span<const double> values() const { return {system_.values, 9 * system_.rows.size()}; }

    std::vector<Member> families_;
    edges::System system_;
    Held held_;
    std::vector<Index> held_blocks_;
    double constant_;
    sparse::Factor<sparse::Real3>& factor_;
};

}  // namespace vmslam::solve
