// A proof: lower bounds on the cost of all states, from factorisations of S with all rounding errors.
#pragma once

#include <limits>
#include <memory>
#include <optional>

#include "vmslam/certificate/quadratic_bound.hpp"
#include "vmslam/sparse/factor.hpp"
#include "vmslam/sparse/pattern.hpp"

namespace vmslam::certificate {

using HermitianFactor = sparse::Factor<sparse::Hermitian2>;

/// c of each row in the order of elimination.
///
/// A row i of b blocks has c_i = 2 u (16 + 4 b): the real and the imaginary part of an entry of L L^H are sums of at most
/// 4 min(b_i, b_j) products, which are rounded together with as many additions and those of at most min(b_i, b_j) update
/// matrices, in any order, so that its error is at most min(c_i, c_j) (|L| |L|^H)_ij.
std::vector<double> rounding_of(const sparse::Symbolic& symbolic);

/// A bound on the rounding errors of the factor of a matrix A, from its structure alone: for each node, in the order of
/// elimination, a part of A_ii.
///
/// For every positive w the errors of `rounding_of` are, as a matrix, at most the diagonal matrix of the quotients
/// (C |L| |L|^H C w)_i / w_i with C = diag(c)^1/2, because 2 x y <= r x² + y² / r. Take w = diag(A)^-1/2, let l_i be the
/// norm of row i of L within the columns of a supernode s, and S_s the sum of sqrt(c) over the rows of s. By the inequality of
/// Cauchy and Schwarz, (|L| |L|^H C w)_i is at most the sum of l_i S_s over the supernodes that have row i, and that is at most
/// A_ii^1/2 times the root of the sum of S_s², because the sum of l_i² is A_ii.
std::vector<double> factor_errors(const sparse::Symbolic& symbolic, std::span<const double> rounding);

/// A bound on b^H (A + diag(e))^-1 b for any e of at least the errors of the factor, rounding errors included.
///
/// The computed x = L^-1 b solves L x = b - f exactly, with |f_i| <= c_i (|L| |x|)_i <= c_i sqrt(d_i) |x|, d the diagonal of
/// L L^H. As the errors are at least c d, f adds at most |x| times the root of the sum of c.
double square_bound(HermitianFactor& factor, std::span<const Complex> b, std::span<const double> rounding);

/// What is proven about a state of edges with constant information. The memory is used again for further states: new memory
/// takes a third of the time of a proof.
class Proof {
   public:
    /// The pattern must live as long.
    Proof(const sparse::Pattern& pattern, std::shared_ptr<const sparse::Symbolic> symbolic)
        : pattern_(pattern),
          factor_(std::move(symbolic)),
          rounding_(rounding_of(factor_.symbolic())),
          errors_(factor_errors(factor_.symbolic(), rounding_)) {}

    std::vector<Edge> edges;

    /// Evaluate the edges at a state, once: those from the world become relative to the first node. `free` nodes may move,
    /// but one node is held in every piece that nothing ties to the world: the cost does not change when such a piece moves.
    void begin(std::span<const double> state, std::vector<char> free);

    /// The splits of the edges that are tried first.
    std::span<const Curvature> curvatures() const { return curves_; }
    /// The function below J for another split, the same for all edges.
    QuadraticBound function_of(double share) const;
    /// The cost of the edges, and a bound on its rounding errors.
    double cost() const;
    double slack() const { return function_.slack; }
    /// Whether all residuals are zero up to rounding, or small beside what the edges measure, so that J is no guide.
    bool zero() const;

    /// A lower bound on the cost of all states; -inf where S is not proven positive definite.
    double bound() { return shifted_bound(0.0); }
    /// After that a vector (N, 2) v with v^H S v <= 0 up to rounding, otherwise empty.
    const std::vector<Complex>& negative() const { return negative_; }
    /// The best lower bound after each edge has chosen its split for the directions in which S is the smallest.
    ///
    /// S is linear in beta and A, and the split of an edge may be any average of splits. Each round finds the smallest
    /// direction of S, in which every edge takes the split that is best there, and averages it with the ones before
    /// (Frank and Wolfe 1956, for the smallest eigenvalue). That takes some 50 factorisations.
    double raised_bound();

   private:
    struct Shifted {
        double best = -std::numeric_limits<double>::infinity();
        double shift = 0.0;    ///< the least one that was found with which S is positive definite
        bool factored = false;  ///< whether there is one; the factor is then that with `shift`
    };
    double shifted_bound(double shift);
    bool factorize(std::span<const double> shifts, std::vector<double>& margin);
    Shifted least_shift();
    std::vector<Complex> smallest();
    void choose_splits(std::span<const std::vector<Curvature>> choices, double part);

    std::vector<Curvature> curvatures_for(double share) const;
    void write_function(QuadraticBound& out, std::span<const Curvature> curves) const;

    sparse::Pattern pattern_;
    HermitianFactor factor_;
    std::vector<double> rounding_, errors_;
    State state_;
    std::vector<char> free_;
    /// (N) bounds on the rounding errors of the sums over the edges of a node, as parts of their terms.
    std::vector<double> summation_;
    std::vector<Force> forces_;
    std::vector<Curvature> curves_;
    QuadraticBound function_;
    std::vector<Complex> values_, negative_;
};

/// The relative gap (J - bound) / J up to which a state is proven to be a global minimum, and J itself where it is zero.
inline constexpr double proven = 1e-6;

/// The pattern that edges give their nodes, and which of the nodes are points: no edge depends on their headings.
sparse::OwnedPattern pattern_of(std::span<const Edge> edges, Index nodes);
std::vector<char> points_of(std::span<const Edge> edges, Index nodes);

/// What a proof finds about a state.
enum class Finding {
    global,           ///< a global minimum: `proven` of its cost is above the lower bound at most
    zero,             ///< a global minimum: all residuals are zero up to rounding
    other_cost,       ///< the edges have another cost than the one that was given
    unsplit,          ///< not proven: edges without a split leave the bound low
    not_stationary,   ///< not proven: a step from the state promises a lower cost
    negative,         ///< not proven: the matrix S has a negative direction
    without_bound,    ///< an edge has singular information, with an eigenvalue that is negative by rounding
    indefinite,       ///< an edge has information with a negative eigenvalue, so that the cost has no lower bound
};

struct Judgement {
    Finding finding;
    double lowest = 0.0;  ///< no state has a lower cost; 0 where nothing better is known
    Index unsplit = 0;    ///< the number of edges without a split
    Index edge = -1;      ///< of `without_bound` and `indefinite`: which one
    std::vector<Complex> direction;    ///< (N, 2) in which S is not positive; or empty

    bool global() const { return finding == Finding::global || finding == Finding::zero; }
};
/// Judge the state at which a proof has begun, whose cost is `cost`. A `thorough` judgement tries other splits where the
/// first ones prove nothing, some 50 factorisations.
Judgement judge(Proof& proof, double cost, bool thorough);

/// The cost of a state, a lower bound on the cost of all states, and whether the state is a global minimum.
struct Bound {
    double lowest, cost;
    bool global;
};
/// Of edges that are no part of a larger system. `state` has their landmarks, too. None where information is not positive
/// semidefinite, so that the cost may have no lower bound, or where the cost is not finite.
std::optional<Bound> lower_bound(std::span<const double> state, std::vector<Edge> edges);

/// Whether a symmetric matrix is positive semidefinite, by the exact signs of its principal minors; also false where its
/// entries differ by so many orders of magnitude that these are below the smallest numbers.
bool semidefinite(const edges::Symmetric& w);

}  // namespace vmslam::certificate
