// Priors of an online solution: what a map says, or what the edges of marginalised poses have left.
//
// A prior is v' Lambda v - 2 b' v in J, with v(x) the way of its nodes from their centres. Three kinds:
//
//     absolute   v_k = R_ck' (p_k - c_k), theta_k - theta_ck, in the axes of the centre; of points in those of the world,
//     relative   the same for what the first node sees, R_0' (p_k - p_0), so that turning all nodes together costs nothing,
//     turning    R_ck' (R_t' (p_k - q) - (c_k - q) + t perp(c_k - q)), theta_k - theta_ck: turning all nodes together about
//                the pivot q counts as the angle t, which turns the centres about their centroid onto the nodes. The joint
//                prior of a map is of this kind, because the heading of the whole map is known worst (`Way` in
//                edges/priors.py).
//
// What edges between nodes leave is relative: after a long way the heading of the first node is uncertain, and an absolute
// way is not linear in it. The tree has Lambda_x = J' Lambda J, J = dv/dx, and
//
//     pull = J' (b - Lambda v).
#pragma once

#include <vector>

#include "vmslam/edges/family.hpp"
#include "vmslam/online/graph.hpp"

namespace vmslam::online {

struct Prior {
    std::vector<Id> members;
    std::vector<double> information, rhs;  ///< Lambda (3k, 3k) and b (3k)
    std::vector<Triple> centre;
    bool relative = false;
    std::vector<double> pivot;  ///< q (2) of a prior that turns with its nodes, otherwise empty
    std::vector<double> linear, pull;  ///< Lambda_x and `pull` of the tree
    std::vector<Triple> at;  ///< the values of the nodes at which Lambda_x was evaluated
    Id group = 0;  ///< the supernode of the prior

    /// Turn the information from world axes to those of the centres.
    void turn_to_poses();
    /// `pull` at the present values of the nodes, and Lambda_x, if it is to be renewed.
    void evaluate(const Graph& graph, bool renew);
    /// v' Lambda v - 2 b' v at the present values of the nodes.
    double cost(const Graph& graph) const;
    /// Whether v is linear in the increments of points.
    bool linear_in_places() const { return !relative && pivot.empty(); }
    /// Whether the nodes have turned or moved so far against each other that Lambda_x is no good approximation.
    bool outdated(const Graph& graph) const;
};

/// v (3k) of a prior at values of its nodes, and its Jacobian by their increments, each in its own axes.
class Way {
   public:
    Way(const Prior& prior, std::span<const Triple> x, const std::vector<char>& point);
    std::vector<double> v;
    /// v' Lambda v - 2 b' v.
    double cost(const Prior& prior) const;
    /// J' (b - Lambda v) and J' Lambda J.
    std::vector<double> gradient(const Prior& prior) const;
    std::vector<double> information(const Prior& prior) const;
    /// How far the Jacobian is turned against another one, or stretched.
    double turned_from(const Way& other) const;

   private:
    /// v and its Jacobian of a prior that turns with its nodes.
    void turn_with(const Prior& prior, std::span<const Triple> x);
    /// a J of a row vector.
    void times_jacobian(const double* row, double* product) const;

    bool relative_;
    const std::vector<char>& point_;
    std::vector<Rotation> own_, of_first_;  ///< what turns increments of a node, and those of the first, to the axes of v
    std::vector<Lever> seen_;  ///< where the first node sees the others
    std::vector<double> along_, gradient_;  ///< dv/dt and dt/dx of a prior that turns with its nodes
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
    PriorFamily(const Prior& prior, const Graph& graph, std::span<const Id> number);
    double accumulate(const edges::State& state, edges::System* system, std::span<const edges::Index> pairs) const override;
    /// Absolute priors have none, and those of the others are left out.
    bool curves() const override { return true; }

   private:
    const Prior& prior_;
    std::vector<char> point_;
    std::vector<edges::Index> nodes_;
    double least_;  ///< b' Lambda^-1 b, so that the cost is at least 0
};

}  // namespace vmslam::online
