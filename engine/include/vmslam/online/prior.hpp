// Priors of an online solution: what a map says, or what the edges of marginalised poses have left.
//
// A prior is d' Lambda d - 2 b' d in J, with the increments d of its nodes from their centres, those of poses in the axes of
// their centres. The tree needs it for the sums of all increments since it was begun:
//
//     carry = b + Lambda d_0,   d_0 the sums when the prior was made, and 0 in a new tree, where b is shifted to its values.
#pragma once

#include <vector>

#include "vmslam/edges/family.hpp"
#include "vmslam/online/graph.hpp"

namespace vmslam::online {

struct Prior {
    std::vector<Number> members;
    std::vector<double> information, rhs;  ///< (3k, 3k) and (3k)
    std::vector<Triple> centre;
    std::vector<double> carry;  ///< `rhs` for the increments of the tree
    Number group = 0;           ///< the supernode of the prior

    /// Turn the information from world axes to those of the centres.
    void turn_to_poses();
    /// `rhs` for increments from the present values of the nodes.
    std::vector<double> carry_at(const Graph& graph) const;
};

/// y = A x for a square matrix.
std::vector<double> product(std::span<const double> A, std::span<const double> x);

/// A system (3k, 3k) and its right-hand side without the first node, which is eliminated:
/// Omega_rr - Omega_r0 Omega_00^-1 Omega_0r and rhs_r - Omega_r0 Omega_00^-1 rhs_0.
struct Reduced {
    std::vector<double> information, rhs;
};
Reduced without_first(std::span<const double> information, std::span<const double> rhs);

/// A prior as a family of a batch solution, in world axes, for nodes by their numbers there.
class PriorFamily : public edges::Family {
   public:
    PriorFamily(const Prior& prior, const Graph& graph, std::span<const Number> number);
    double accumulate(const edges::State& state, edges::System* system, std::span<const edges::Place> pairs) const override;

   private:
    std::vector<edges::Place> nodes_;
    std::vector<Triple> values_;
    std::vector<double> information_, rhs_;
    double least_;  ///< b' Lambda^-1 b, so that the cost is at least 0
};

}  // namespace vmslam::online
