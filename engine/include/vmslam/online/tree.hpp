// The elimination tree of an online solution: the Bayes tree of iSAM2 (Kaess et al., IJRR 2012).
//
// A supernode is a group of w nodes that are eliminated together, and r nodes, its separator, to which they are tied and
// which are eliminated later. A pose has three numbers in its front and a point two; rows of the identity fill each of the
// two parts up to blocks of three, for which the dense work is made. It keeps
//
//     panel       the columns of L, L11 over L21, with inverse pivots (`sparse::Front`),
//     update      U, what the whole subtree adds to Omega of the separator: its edges, less what eliminating its nodes takes,
//     y           L11^-1 xi of its nodes, at the last evaluation,
//     pull_then   xi of the separator from the whole subtree, at the last evaluation,
//     pull_now    the same at the estimate,
//     own_pull    what its own edges add to xi of its nodes and of the separator, at the last evaluation.
//
// An edge is assembled where its first end is eliminated, with its parts for both ends. So U and the pulls belong to the
// subtree as a whole, and J of a subtree does not change when its separator moves as a rigid body. Let m be the motion of the
// nodes of the separator since the last evaluation, relative to one of its poses, the `frame`, and in the axes that the nodes
// had then. Then
//
//     a = L11^-T (y - L21' m)     are the increments of its nodes, which first move along with the frame,
//     pull_then - U m             is pull_now, turned along with the frame.
//
// As long as the change m' U m of J is small, a pass leaves the subtree out: it moves no nodes and evaluates no edges there.
// The pull on the frame is computed from the others so that forces and torques sum to zero. Otherwise rounding would rotate
// the map, whose heading has little information.
//
// A supernode with w = 0 is a prior: a dense quadratic on its separator. Supernode 0 is the parent of all roots.
#pragma once

#include "vmslam/online/edge.hpp"
#include "vmslam/sparse/factor.hpp"

namespace vmslam::online {

using sparse::Front;
using sparse::Numbers;

/// Room for some numbers, with undefined content.
inline double* at_least(Numbers& numbers, std::size_t size) {
    if (numbers.size() < size) numbers.resize(2 * size);
    return numbers.data();
}

/// A node of the separator in the axes of the frame. The frame itself, and all nodes where there is no frame, in the world.
struct Seen {
    double x, y, angle;
    Rotation axes;
};

/// Where a supernode hangs in the tree.
struct Hanging {
    Id parent = 0, sibling = 0;
    bool ascending = true;  ///< whether `relative` ascends
    double separator_change = 0.0;  ///< abs(m' U m), by how much the motion of the separator since then changes J
    std::vector<Id> relative, run_end;  ///< where those of the separator begin in the front of the parent; ends of its runs
};

struct Supernode : Hanging {
    Id w = 0, r = 0;
    Id wide = 0, tall = 0;  ///< the blocks of three numbers that hold its w and its r nodes
    Id child = 0;
    Id frame = -1;  ///< the first pose of the separator; -1: none, or the subtree is absolute
    bool marked = false;  ///< false between the calls
    bool absolute = false;  ///< whether something in the subtree resists motions as a rigid body
    double largest_decrease = 0.0;  ///< y' y, by how much solving a supernode lowers J: the largest in the subtree
    double largest_squares = 1.0;  ///< the largest e' W e of an edge of the subtree, at least 1
    double own_squares = 1.0;  ///< the same of its own edges
    std::vector<Id> nodes;  ///< w nodes, then r nodes, both in the order of elimination
    std::vector<Id> row;  ///< (w + r + 1) where the numbers of each begin in the front, and where those of the last one end
    std::vector<Seen> seen;  ///< the separator at the last evaluation
    Numbers numbers;

    Supernode() = default;
    /// The first w of some nodes are eliminated.
    Supernode(const Graph& graph, std::vector<Id> nodes, Id w);

    Front front() const { return {{3, 3}, wide, tall}; }
    double* panel() { return numbers.data(); }
    double* update() { return panel() + 3 * wide * front().height; }
    double* y() { return update() + 3 * tall * front().update_height; }
    double* pull_then() { return y() + 3 * wide; }
    double* pull_now() { return pull_then() + 3 * tall; }
    double* own_pull() { return pull_now() + 3 * tall; }
    /// Where the numbers of a node of the separator begin among those of the separator, and how many they are.
    Id begin_of(Id k) const { return row[w + k] - 3 * wide; }
    Id size_of(Id k) const { return row[w + k + 1] - row[w + k]; }
    std::span<const Id> columns() const { return {nodes.data(), static_cast<std::size_t>(w)}; }
    std::span<const Id> separator() const { return {nodes.data() + w, static_cast<std::size_t>(r)}; }
};

/// The evaluation of edges: how, and what it finds.
struct Evaluation {
    double limit;  ///< from which an edge in the factor is outdated
    Bent bent;
    double change = 0.0, predicted = 0.0;  ///< of the cost; its decrease by a solution of the tree
    std::vector<Id> late;  ///< edges that are outdated
};

class Tree {
   public:
    Tree() : groups(1) {}

    std::vector<Supernode> groups;
    Stamp step = 1;  ///< the present step
    /// The smallest ratio of a pivot to its diagonal entry, as in batch solutions.
    double pivot_tolerance = sparse::Real3::tolerance;

    /// Without supernodes again.
    void clear();
    /// A new supernode; numbers of released ones are used again.
    Id create(const Graph& graph, std::vector<Id> nodes, Id w);
    void release(Id s);
    /// Take back the last `create`s; there were so many supernodes before.
    void take_back(std::span<const Id> created, std::size_t size_before);
    void hang(Id s, Id parent);

    /// The supernodes from `homes` up to the roots, children before their parents.
    std::vector<Id> upwards(std::span<const Id> homes);

    /// The separators of the children of s find their places in its front.
    void relate_children(Graph& graph, Id s);
    /// Factorise a supernode from its edges and children; false where a pivot is too small.
    bool factorize(Graph& graph, Id s);

    /// Move the nodes of a supernode to the solution, whose separator is there. Moving them again changes nothing.
    void move(Graph& graph, Id s);
    /// The same for all supernodes from `homes` up to the roots, and for all.
    void move_paths(Graph& graph, std::span<const Id> homes);
    void move_all(Graph& graph);
    /// Take the present values of all nodes as the solution: their steps are zero.
    void stay();
    /// Compute `pull_now` and `separator_change` of a subtree from the present place of its separator.
    void follow(const Graph& graph, Id s);
    /// Take the present values of the nodes of a supernode as those of its last evaluation: their increments become zero.
    void rest(Graph& graph, Id s);
    /// Evaluate the edges of a supernode where its nodes are now.
    void evaluate_edges(Graph& graph, Id s, Evaluation& found);
    /// Solve a supernode forward, L y = xi, after its edges were evaluated, and its children.
    void solve_forward(Id s, Evaluation& found);
    /// Both.
    void evaluate(Graph& graph, Id s, Evaluation& found) {
        evaluate_edges(graph, s, found);
        solve_forward(s, found);
    }

    /// Move supernodes to the solution from the roots down, but for subtrees that would change J by less than `least`.
    struct Moved {
        std::vector<Id> supernodes, priors;  ///< parents before their children; the priors below them
    };
    Moved descend(Graph& graph, double least);

    /// The joint covariance (3k, 3k) of k nodes in world axes.
    std::vector<double> covariance(Graph& graph, std::span<const Id> nodes);

    /// The numbers that all supernodes hold.
    std::ptrdiff_t numbers() const;

   private:
    void put_entries(const Graph& graph, const Supernode& group, double* x, std::span<Symmetric> of_separator);
    /// m of a supernode, the motion of its separator.
    const double* motion(const Graph& graph, const Supernode& group);
    void move(Graph& graph, Supernode& group, const double* m);
    /// U m, and `separator_change`.
    const double* predict(Supernode& group, const double* m);
    void follow(const Graph& graph, Supernode& group, const double* pull);

    std::vector<Id> free_;
    Numbers work_, motion_, pull_;  ///< vectors of fronts
    std::vector<Symmetric> of_separator_;  ///< what edges add to the diagonal of the separator
    std::vector<Numbers> packed_ = std::vector<Numbers>(1);
};

/// Linearise the edges `late` again, factorise their supernodes, `others` and those above them, with the same nodes in the same
/// order, and solve them forward. Their edges were evaluated where the nodes are now. Returns whether Omega is positive
/// definite. If it is not, the tree is of no use until all of it is built anew.
bool refactor(Graph& graph, Tree& tree, std::span<const Id> late, std::span<const Id> others, Evaluation& found);

/// A part of the graph that is eliminated anew.
struct Changes {
    std::span<const Id> touched, fresh;  ///< nodes and edges that are new or get other numbers
    std::span<const Id> newest;  ///< nodes that are eliminated last
    std::span<const Id> gone;  ///< supernodes that are taken out
};

/// Eliminate the top of the tree again: all supernodes from changed nodes up to the roots, in a new order. Their edges are
/// evaluated where the nodes are now. The supernodes below stay as they are and become children of the new ones. False where
/// a node is not determined; then nothing is changed.
bool rebuild(Graph& graph, Tree& tree, const Changes& changes, Evaluation& found);

}  // namespace vmslam::online
