// The online solver: poses and landmarks by number, with the solution of the whole graph after every step.
#pragma once

#include <optional>
#include <string>
#include <string_view>

#include "vmslam/online/edge.hpp"
#include "vmslam/online/prior.hpp"
#include "vmslam/online/tree.hpp"

namespace vmslam::online {

/// What steps learn about the graph and keep for the next ones.
struct Memory {
    double cost = 0.0;       ///< J at the last evaluation
    double predicted = 0.0;  ///< by how much solving the supernodes that were factorised last would lower it
    double limit = 1e-4;     ///< how far an edge in the factor may be from the present one
    Bent bent;
    int hold = 0;            ///< for how many further passes second derivatives stay convex
    double shrinks = 0.0;    ///< the largest recent ratio of the predictions of two successive passes
};

class OnlineSystem {
   public:
    /// Steps end where the next pass would lower the cost by less than `tolerance` of it; after `most_passes` the batch
    /// solver takes over.
    OnlineSystem(double tolerance, int most_passes) : tolerance_(tolerance), most_passes_(most_passes) {}

    /// The robust kernel of edges with so many rows, 0 for all, and what turns their weights into information.
    void use_kernel(const edges::Kernel& kernel, double gain, int rows = 0);

    /// A new node, at the origin until an edge or a prior leads to it.
    Id add_node();
    /// A new landmark without heading at a place, for single numbers.
    Id add_point(double x, double y);
    /// Put nodes at places, with their joint information (3k, 3k) in world axes. `points` have no heading. With a `pivot` (2)
    /// the prior turns with its nodes.
    void add_prior(std::span<const Id> nodes, std::span<const Triple> places, std::vector<double> information, bool points,
                   std::vector<double> pivot = {});

    /// Add edges to new nodes, those from number `known` on, or between others, and solve; `newest` are eliminated last.
    /// False where a node is not determined: the system is as before then, without the new nodes.
    bool add(Id known, std::span<const NewEdge> added, std::span<const Id> newest);
    /// Bring the solution to the optimum after edges were added at nodes.
    bool solve(std::span<const Id> touched, std::span<const Id> fresh, std::span<const Id> newest);
    /// Put nodes elsewhere, such as a landmark at its mirror image, and solve from there; false where not all nodes are
    /// determined.
    bool solve_from(std::span<const Id> nodes, std::span<const Triple> places, std::span<const Id> newest);
    /// Give the prior that was added first, that of one pose, another place and information; `solve_from` takes it over.
    void loosen(const Triple& place, std::vector<double> information);
    /// Linearise all edges where they are now and factorise again, in the order of the tree, and solve.
    void relinearize(std::span<const Id> newest);

    /// Take a pose out of the graph, and put a prior on its neighbours in its place; returns its last value.
    ///
    /// Throws std::invalid_argument for a landmark without heading, and for a pose without neighbours.
    Triple marginalize(Id node, std::span<const Id> newest);
    /// Take a landmark and its edges out of the graph, and solve; false where a prior is on it, and nothing changes then.
    bool remove(Id landmark, std::span<const Id> newest);
    /// Whether more than half of the nodes were marginalised.
    bool crowded() const;
    /// Free what belonged to marginalised nodes; returns the new number of each node, or -1.
    std::vector<Id> renumber();

    /// The solution at some nodes.
    std::vector<Triple> values(std::span<const Id> nodes);
    /// Bring all nodes to the solution: steps leave out those that move by a small part of a standard deviation.
    void complete();
    /// The cost at the estimate, without priors, and with all of them but for a constant.
    double cost();
    double cost_with_priors();
    /// The joint covariance (3k, 3k) of k nodes in world axes, unless the edges do not determine it to double precision.
    std::optional<std::vector<double>> covariance(std::span<const Id> nodes, std::span<const Id> newest);

    const Graph& graph() const { return graph_; }
    Tree& tree() { return tree_; }
    std::size_t priors() const { return priors_.size(); }
    /// The memory of nodes, edges and tree.
    std::size_t bytes() const;

    int passes = 0;            ///< how often the last step solved the tree again because edges had to be evaluated again
    bool converged = true;     ///< whether it ended at the minimum
    int batch_solutions = 0;   ///< how many steps the batch solver had to take

    /// Graph and estimate as bytes, and back, with a tree that is built anew where the nodes are. False where the bytes are
    /// damaged, or none of a system; nothing changes then.
    std::string save();
    bool restore(std::string_view bytes);

   private:
    class Undo;
    enum class Outcome { done, unfinished, indefinite };

    /// Passes until the predicted decrease of the cost is below the tolerance.
    bool iterate(std::span<const Id> newest);
    bool descends(std::span<const Id> newest);
    Outcome advance(int& done);
    /// How the passes of a step have gone so far.
    struct Progress {
        double last = infinity;  ///< the decrease of J that the last pass predicted
        double part = 1.0;  ///< a factor on the size below which the next pass leaves out subtrees
        bool renewed = false;  ///< whether edges were linearised again after the last pass
        std::array<double, 3> earlier{};  ///< the decreases that the last three passes predicted
        std::size_t linearized = 0;  ///< how many edges were linearised again

        bool first() const { return last == infinity; }
    };
    bool is_last(double predicted, double last);
    void adapt(double predicted, bool ends, Progress& progress);
    /// One pass, but for subtrees that would change J by less than `least`: the decrease of J by the next one, and the edges
    /// and priors that are to be linearised again.
    struct Pass {
        double predicted;
        std::vector<Id> late;
        std::vector<Prior*> outdated;
    };
    Pass pass(double least);
    bool factorize_late(std::span<const Id> late, std::span<const Id> others);
    std::vector<Id> renew_priors(std::span<Prior* const> priors);

    Bent usual_bent() const;
    bool eliminate(const Changes& changes);
    /// Build the tree anew with all nodes at x; returns whether they are determined. It is empty otherwise.
    bool begin_at(std::span<const Triple> x, std::span<const Id> newest);
    /// The same, and solve from there.
    bool begin_and_solve(std::span<const Triple> x, std::span<const Id> newest);
    bool move_to(std::span<const Triple> x);
    bool factorize_all();
    bool solve_as_batch(std::span<const Id> newest);
    bool factorize_again(std::span<const Id> newest);
    bool linearize_late(std::span<const Id> newest);
    /// Whether a decrease of J is below the tolerance of a step.
    bool is_small(double decrease) const;
    void hang_prior(Prior& prior);
    void write_prior(const Prior& prior, bool renewed);
    template <class Each>
    void transfer(Each& each);
    std::vector<Triple> places() const;

    double tolerance_;
    int most_passes_;
    Graph graph_;
    Tree tree_;
    std::vector<Prior> priors_;
    Memory memory_;
    Id ordered_ = 0;  ///< the number of nodes when all were ordered last
    bool covariances_ready_ = false;  ///< whether nothing has changed since a covariance was asked for
    bool lost_ = false;  ///< whether the tree is empty, because not all nodes could be eliminated where they are
};

}  // namespace vmslam::online
