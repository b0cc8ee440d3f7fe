// Sparse Cholesky factorisation, multifrontal and supernodal, for the blocks of block.hpp.
#pragma once

#include <array>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "vmslam/sparse/block.hpp"
#include "vmslam/sparse/symbolic.hpp"

namespace vmslam::sparse {

/// L with L L^H = A + damping abs(diag(A)). Factorising again reuses all memory. Not to be shared by threads.
///
/// Multifrontal (Duff and Reid 1983; Liu 1990): the columns of a front are assembled from the matrix and from the update
/// matrices of its children, factorised, and the update matrix -L21 L21^H plus those of the children is passed on.
///
/// A pivot must be greater than `Block::tolerance` times its (damped) diagonal entry. The smallest ratios of public graphs
/// that are held: INTEL 4e-11, a path of 10^5 poses held at one end 1e-10, CSAIL 1e-7, others above 1e-6. Of graphs that are
/// not held: negative, or M3500 9e-14; CSAIL, which is badly scaled, 2e-11, so that its missing anchor is not noticed here.
template <class Block>
class Factor {
   public:
    using Value = typename Block::Value;

    explicit Factor(std::shared_ptr<const Symbolic> symbolic);
    explicit Factor(Symbolic symbolic) : Factor(std::make_shared<const Symbolic>(std::move(symbolic))) {}
    // not inline: the bindings are compiled with -O1, with which the numbers would be visited one by one to destroy nothing
    ~Factor();

    const Symbolic& symbolic() const { return *symbolic_; }
    const std::shared_ptr<const Symbolic>& shared_symbolic() const { return symbolic_; }
    /// The columns of L of a supernode, the diagonal inverted; see `Front`.
    const double* panel(Node s) const { return panels_.data() + symbolic_->panel_start[s]; }

    /// Factorise blocks given by rows, of which only the upper triangle of diagonal ones is read. Returns the first bad
    /// pivot, as a scalar in the order of elimination, or -1.
    Index factorize(std::span<const Value> values, double damping = 0.0);

    /// After a bad pivot: the vector with a one there that the rows eliminated before map to zero, in node order.
    std::vector<Value> null_vector(Index pivot) const;

    /// Solve A x = b, both in node order; false where b is not finite.
    bool solve(std::span<const Value> b, std::span<Value> x);

    /// The square of the norm of L^-1 b.
    double forward_square(std::span<const Value> b);

    double log_determinant() const;

   private:
    Index factorize_supernode(Node s, std::span<const Value> values, double damping, std::span<Numbers> scratch);
    Index factorize_part(int part, std::span<const Value> values, double damping);
    bool gather(std::span<const Value> b);
    void forward();
    void backward();

    std::shared_ptr<const Symbolic> symbolic_;
    std::vector<std::vector<Node>> members_;  ///< the supernodes of each part
    Numbers panels_, updates_;
    std::vector<Numbers> packed_;  ///< of each thread: right factors
    std::vector<double> limits_;   ///< the least pivots
    Numbers rhs_, work_;           ///< planes in the order of elimination; of one front
};

/// Solve A X = B for the columns of B (n, 3, columns), in node order; false where B is not finite. X must not be B.
bool solve_columns(const Factor<Real3>& factor, std::span<const double> b, Index columns, std::span<double> x);

/// The blocks of the inverse on the pattern of L (Takahashi, Fagan and Chen 1973; Erisman and Tinney 1975).
class SelectedInverse {
   public:
    explicit SelectedInverse(const Factor<Real3>& factor);

    /// The diagonal blocks (n, 3, 3) in node order.
    const std::vector<double>& diagonal() const { return diagonal_; }

    /// Block (i, j), by rows, where the pattern of L has it.
    std::optional<std::array<double, 9>> block(Node i, Node j) const;

   private:
    std::shared_ptr<const Symbolic> symbolic_;
    Numbers panels_;
    std::vector<double> diagonal_;
};

extern template class Factor<Real2>;
extern template class Factor<Real3>;
extern template class Factor<Hermitian2>;

}  // namespace vmslam::sparse
