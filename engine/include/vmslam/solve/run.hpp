// An iteration Omega Delta = xi, x <- x + Delta, and the rules that stop it.
#pragma once

#include <functional>
#include <limits>
#include <optional>
#include <vector>

#include "vmslam/solve/anderson.hpp"
#include "vmslam/solve/objective.hpp"

namespace vmslam::solve {

/// A step shorter than the tolerance ends the iteration only where it promises to lower J by less than this part of it, or
/// less than the tolerance itself where that is greater: a rough tolerance asks for a rough end.
inline constexpr double promise = 1e-6;
/// A step is confirmed where its predicted decrease of J is below this many times the cost tolerance.
inline constexpr double confirmed = 1e3;

/// How an iteration ended.
enum class End {
    most_steps,        ///< it has taken all its steps
    diverged,          ///< the cost is infinite or not a number
    cost_settled,      ///< the last step changed the cost by less than the tolerance
    short_step,        ///< the last step was short and promised little
    small_decrease,    ///< the last step promised less than the cost tolerance
    rounding_floor,    ///< the steps are no longer than rounding makes them
    no_lower_cost,     ///< no step lowers the cost, however short
    singular,          ///< damped steps lead to a state where Omega is singular
    not_determined,    ///< Omega has no factor at the last state
};

/// The end in words.
const char* describe(End end);

struct Rules {
    double tolerance;              ///< the step norm below which the iteration has converged
    int most_steps = 100;          ///< the most steps to take
    double cost_tolerance = 0.0;   ///< the relative change of J below which it has converged; 0 for none
    bool descend = false;          ///< damped steps must lower J itself, with information evaluated at both ends
    double kept = 0.01;  ///< the factor is kept after a plain step that should lower J by at most this part of it
};

/// An iteration under way.
class Run {
   public:
    Rules rules;
    std::vector<double> state;
    std::optional<AndersonAcceleration> anderson;  ///< of the steps, or none for plain steps
    std::vector<double> costs, norms;  ///< J before each step, and the norm of each step
    double predicted = std::numeric_limits<double>::infinity();  ///< how much the last step should lower J
    bool converged = false;
    End end = End::most_steps;
    double cost_at_end = 0.0, damping = 0.0;  ///< of `diverged` and `no_lower_cost`; of `not_determined`
    int damped_from = -1;  ///< the first step of damped ones that followed plain ones, or -1
    int curved_from = -1;  ///< the first step with second derivatives, or -1
    int factorizations = 0;
    std::function<void(const Run&)> observer;  ///< called after each step

    int steps() const { return static_cast<int>(norms.size()); }
    /// Whether the last step was a mixture of iterates.
    bool mixed() const { return anderson && anderson->active(); }

    /// Take a correction from a state with this cost.
    void step(double cost, std::span<const double> delta);
    /// Whether the cost is infinite or not a number.
    bool diverged(double cost);
    /// Whether the last step changed the cost by less than the cost tolerance, and was predicted to.
    bool settled(double cost);
    /// Whether the last step, which should lower J by `decrease`, was short enough to stop.
    bool finished(double decrease, Objective& objective);
    /// Whether a predicted decrease is a small part of J, or no more than rounding makes of it.
    bool negligible(double decrease, Objective& objective) const;

   private:
    bool converge(End reason);
};

/// How much rounding of the coordinates adds to J: the sum of diag(Omega) errors², with errors of 1e-15 of one plus the
/// largest coordinate.
double rounding(std::span<const double> state, std::span<const double> diagonal);
double inner(std::span<const double> a, std::span<const double> b);

/// Iterate x <- x + Omega^-1 xi with Omega = sum B' Omega_e B and xi = - sum B' Omega_e e.
///
/// Plain steps converge slowly, or oscillate, where residuals are large or have a kernel, because Omega leaves out second
/// derivatives. Where steps promise little of J, but shrink slowly, Omega has these (Newton's method), if all edges of the
/// graph can add them.
///
/// Where they cannot, or information depends on the state, the iterates are mixed instead. Where neither the lowest J nor the
/// shortest step improves for a while, damped steps lead on from the best state. They converge slowly, too, so that after
/// some of them undamped steps follow, or second derivatives once they lower J by little. Far from a minimum steps with second
/// derivatives would be slower than damped ones.
///
/// Source: Nocedal and Wright, Numerical Optimization, section 10.3.
void gauss_newton(Objective& objective, Run& run);

/// Iterate (Omega + lambda diag(Omega)) Delta = xi, with lambda chosen so that J falls. Returns whether it only ended
/// because it has taken `most` steps.
///
/// lambda is Marquardt's damping by the diagonal, updated by Nielsen's rule from the gain, the actual decrease of J divided
/// by the predicted one. The end counts as converged only where an undamped step confirms it: beside very large entries of
/// Omega (a pose on a landmark) even the smallest damping hides the other directions.
///
/// `curved`: Newton's method. Omega has the second derivatives of residuals and kernels, and lambda is 0 where that is positive
/// definite and J falls; after a good step it falls by up to a factor of 10 instead of 3.
///
/// Source: Madsen, Nielsen and Tingleff, Methods for non-linear least squares problems (2004), section 3.2.
bool levenberg_marquardt(Objective& objective, Run& run, int most, bool curved = false);

}  // namespace vmslam::solve
