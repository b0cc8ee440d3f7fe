// Move the whole trajectory and map at once along the directions in which the log determines them least.
//
// Pivots and stretches change a few poses at a time. A long log holds each of them tightly, while its whole trajectory may
// still shift, turn and bend by much more: it then takes them very many small steps. Here the posterior of trajectory and map
// is approximated by a Gaussian N(s, (J' J)^-1) at its mode s, as graph SLAM does. Its r widest directions, the columns of V
// with standard deviations d, are independent of all others under the Gaussian. Their coordinates a are proposed anew,
//
//     a' = sqrt(1 - b²) a + b n,    n ~ N(0, I),
//
// which leaves the Gaussian unchanged, and accepted with the probability exp(F(before) - F(after)), F = -log posterior + log
// Gaussian. So the target is exact, whatever the Gaussian. The step b is adapted in the warm-up and fixed afterwards.
//
// Sources: Cotter, Roberts, Stuart and White, MCMC methods for functions: modifying old algorithms to make them faster,
// Statistical Science 2013 (preconditioned Crank-Nicolson); Cui, Law and Marzouk, Dimension-independent likelihood-informed
// MCMC, Journal of Computational Physics 2016, for a subspace.
#pragma once

#include "vmslam/gibbs/problem.hpp"

namespace vmslam::gibbs {

/// -log of the posterior of a trajectory and a map, without constants, with the precisions of the sightings integrated out.
/// `squares`, where not empty, receives e' C^-1 e of the sightings.
double cost(const Problem& problem, const Trajectory& x, const Map& m, bool exact, std::span<double> squares);

/// A Gaussian's mode and its widest directions.
///
/// A state is a vector of 3 T + n J numbers: the poses after the first, and the n numbers of each landmark. Without psi n is
/// 2: nothing depends on the headings of landmarks, so that they must not be among the directions.
struct Directions {
    Trajectory poses;
    Map marks;
    std::span<const double> rows;  ///< (r, 3 T + n J), V'
    std::span<const double> deviations;  ///< (r) d
};

/// Moves of a state, which they change in place.
class Bends {
   public:
    Bends(const Problem& problem, const Directions& directions, Trajectory& x, Map& m);

    /// A number of moves with the step b; returns how many were accepted.
    int move(Random& random, double step, int moves);

   private:
    std::size_t width() const { return away_.size(); }
    std::size_t each() const { return problem_.oriented ? 3 : 2; }
    std::vector<double> difference() const;
    bool beyond_half_a_turn(std::span<const double> away) const;
    void displace(Trajectory& x, Map& m, std::span<const double> step) const;

    const Problem& problem_;
    const Directions& directions_;
    Trajectory& x_;
    Map& m_;
    std::vector<double> away_;  ///< the state less the mode
    std::vector<double> a_;  ///< its coordinates
};

}  // namespace vmslam::gibbs
