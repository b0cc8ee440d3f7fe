// The elimination tree of an online solution: the Bayes tree of iSAM2 (Kaess et al., IJRR 2012).
//
// A supernode is a group of w nodes that are eliminated together, and r nodes, its separator, to which they are tied and which
// are eliminated later. It keeps
//
//     panel    the columns of L, L11 over L21, with inverse pivots (`sparse::Front`),
//     update   what eliminating the whole subtree adds to Omega of the separator; the parts of the edges are in the nodes,
//     y        the forward solution L11^-1 of the right-hand side,
//     carry    what eliminating the whole subtree adds to the right-hand side of the separator.
//
// A supernode with w = 0 is a prior: a dense quadratic on its separator. Supernode 0 is the parent of all roots.
#pragma once

#include "vmslam/online/graph.hpp"
#include "vmslam/sparse/factor.hpp"

namespace vmslam::online {

using sparse::Front;
using sparse::Numbers;

struct Supernode {
    Number w = 0, r = 0;
    Number parent = 0, child = 0, sibling = 0;
    Number split = 0;  ///< the first row of the separator that is not among the columns of the parent
    bool marked = false;  ///< false between the calls
    bool changed = false;  ///< whether y has changed since the last backward pass
    bool ascending = true;  ///< whether `relative` ascends
    std::vector<Number> nodes;  ///< w nodes, then r nodes, both in the order of elimination
    std::vector<Number> relative, run_end;  ///< where the separator stands in the front of the parent; ends of its runs
    Numbers numbers;

    Supernode() = default;
    Supernode(Number w, Number r);

    Front front() const { return {{3, 3}, w, r}; }
    double* panel() { return numbers.data(); }
    double* update() { return panel() + 3 * w * front().height; }
    double* y() { return update() + 3 * r * front().update_height; }
    double* carry() { return y() + 3 * w; }
    std::span<const Number> columns() const { return {nodes.data(), static_cast<std::size_t>(w)}; }
    std::span<const Number> separator() const { return {nodes.data() + w, static_cast<std::size_t>(r)}; }
};

class Tree {
   public:
    Tree() : groups(1) {}

    std::vector<Supernode> groups;
    Stamp stamp = 0, step = 1;  ///< of the last visit and of the present step
    /// The smallest ratio of a pivot to its diagonal entry, as in batch solutions.
    double pivot_tolerance = sparse::Real3::tolerance;

    /// A new supernode; numbers of released ones are used again.
    Number create(Number w, Number r);
    void release(Number s);
    /// Take back the last `create`s; there were so many supernodes before.
    void take_back(std::span<const Number> created, std::size_t size_before);
    void hang(Number s, Number parent);

    /// The supernodes from `homes` up to the roots, children before their parents.
    std::vector<Number> upwards(std::span<const Number> homes);

    /// The separators of the children of s find their places in its front.
    void relate_children(Graph& graph, Number s);
    /// Factorise a supernode from its edges and children; false where a pivot is too small.
    bool factorize(Graph& graph, Number s);

    /// y and carry of a supernode from its right-hand sides and its children; returns the squared change of y.
    double forward(const Graph& graph, Number s);
    /// The same from supernodes up to the roots: the sum is the decrease of the cost that is predicted.
    double forward(const Graph& graph, std::span<const Number> homes);
    /// Increments and values of the nodes of a supernode, from y and the increments of its separator.
    void backward(Graph& graph, Number s);

    /// Solve from the roots down wherever y changed or a separator moved by `share` standard deviations, or everywhere for a
    /// negative `share`. Nodes that are `apart` standard deviations from where their edges were evaluated join `moved`.
    void backward(Graph& graph, double share, double apart, std::vector<Number>& moved);
    /// Solve on the paths from the roots down to supernodes only. What hangs below is visited by the next `backward`, if a
    /// node has moved by `share` standard deviations.
    void solve_paths(Graph& graph, std::span<const Number> homes, double share);

    /// The joint covariance (3k, 3k) of k nodes in world axes.
    std::vector<double> covariance(Graph& graph, std::span<const Number> nodes);

    std::span<const Number> released() const { return free_; }
    void set_released(std::vector<Number> free) { free_ = std::move(free); }
    /// The numbers that all supernodes hold.
    std::ptrdiff_t numbers() const;

   private:
    /// Room for vectors of fronts and for packing, with undefined content.
    double* work(sparse::Place rows);
    void put_entries(const Graph& graph, const Supernode& group, double* x);

    std::vector<Number> free_;
    Numbers work_;
    std::vector<Numbers> packed_;
};

/// Factorise supernodes again where edges are linearised again, `others`, and those above them: the same nodes in the same
/// order, other numbers. Returns whether Omega is positive definite. If it is not, the tree is of no use until all of it is built anew.
struct Bent;
bool refactor(Graph& graph, Tree& tree, std::span<const Number> late, std::span<const Number> others, const Bent& bent,
              double& cost);

/// A part of the graph that is eliminated anew.
struct Changes {
    std::span<const Number> touched, fresh;  ///< nodes and edges that are new or get other numbers
    std::span<const Number> newest;  ///< nodes that are eliminated last
    std::span<const Number> gone;  ///< supernodes that are taken out
};

/// Eliminate the top of the tree again: all supernodes from changed nodes up to the roots, in a new order. What hangs below
/// stays as it is, and enters as further children. False where a node is not determined; nothing is changed then.
bool rebuild(Graph& graph, Tree& tree, const Changes& changes, const Bent& bent, double& cost);

}  // namespace vmslam::online
