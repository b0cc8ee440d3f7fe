#include <algorithm>
#include <cmath>

#include "vmslam/solve/run.hpp"

namespace vmslam::solve {
namespace {

/// The damping with which steps with second derivatives begin where those without any fail.
constexpr double least_damping = 1e-6;
/// A good step multiplies the damping by at least this, Nielsen's part; with second derivatives by less, because good steps are
/// those where the damping is hardly needed any more.
constexpr double eased = 1.0 / 3, eased_curved = 0.1;

/// Whether the iteration ends here: an undamped Gauss-Newton step promises little, too, or Omega is singular (not converged).
bool confirmed_end(Objective& objective, Run& run) {
    objective.curve(false);
    objective.linearize(run.state, run.state);
    std::vector<double> delta(run.state.size());
    ++run.factorizations;
    if (!objective.factorize(0.0) || !objective.solve(delta)) {
        run.converged = false;
        run.end = End::singular;
        return true;
    }
    run.converged = run.negligible(inner(objective.xi(), delta), objective);
    if (!run.converged) run.end = End::most_steps;
    return run.converged;
}

/// A step that was tried: the state that it leads to, its cost, and by how much J should fall.
struct Trial {
    std::vector<double> delta, state;
    double cost = 0.0, predicted = 0.0;

    /// False where there is no step.
    bool compute(Objective& objective, Run& run, double damping, std::span<const double> diagonal,
                 const std::vector<double>* reference) {
        delta.resize(run.state.size());
        ++run.factorizations;
        if (!objective.factorize(damping) || !objective.solve(delta)) return false;
        state = run.state;
        for (std::size_t k = 0; k < state.size(); ++k) state[k] += delta[k];
        cost = objective.cost(state, reference ? *reference : state);
        // the damped quadratic model predicts that J falls by Delta'(xi + lambda diag(Omega) Delta)
        const std::span<const double> xi = objective.xi();
        predicted = 0.0;
        for (std::size_t k = 0; k < delta.size(); ++k) predicted += delta[k] * (xi[k] + damping * diagonal[k] * delta[k]);
        return true;
    }
};

}  // namespace

bool levenberg_marquardt(Objective& objective, Run& run, int most, bool curved) {
    run.anderson.reset();
    if (objective.state_dependent && !run.rules.descend) run.anderson.emplace();
    run.end = End::most_steps;
    // with second derivatives, damping makes steps slow, and is only for where Omega is indefinite
    double damping = curved ? 0.0 : 1e-4, growth = 2.0;
    const int last = std::min(run.rules.most_steps, run.steps() + most);
    Trial trial;
    while (run.steps() < last) {
        // state-dependent information is evaluated once per step and kept while the step is tried
        const std::vector<double> reference = run.state;
        objective.curve(curved);
        const double cost = objective.linearize(run.state, reference);
        if (run.diverged(cost) || (damping < 1e-6 && run.settled(cost))) return false;
        const std::vector<double> diagonal = objective.diagonal();
        const double floor = rounding(run.state, diagonal);
        bool negligible = false, ever_solved = false;
        while (true) {
            const bool solved = trial.compute(objective, run, damping, diagonal, run.rules.descend ? nullptr : &reference);
            // below the rounding error of J the costs cannot be compared, but no step may raise J beyond it
            negligible = solved && std::abs(trial.predicted) <= std::max(1e-12 * cost, floor) &&
                         trial.cost <= std::max(cost * (1 + 1e-9), floor);
            if (negligible || (solved && std::isfinite(trial.cost) && trial.cost < cost)) break;
            ever_solved = ever_solved || solved;
            const double tried = damping;
            // more damping also makes definite what rounding made indefinite
            damping = std::max(growth * damping, curved ? least_damping : 0.0);
            growth *= 2;
            if (damping > 1e16) {
                run.end = ever_solved || curved ? End::no_lower_cost : End::not_determined;
                run.cost_at_end = cost;
                run.damping = tried;
                return false;
            }
        }
        const double gain = negligible ? 1.0 : (cost - trial.cost) / trial.predicted, bent = 2 * gain - 1;
        damping = std::max(damping * std::max(curved ? eased_curved : eased, 1 - bent * bent * bent), 1e-15);
        growth = 2.0;
        run.step(cost, trial.delta);
        // a short step counts only where damping does not shorten it
        if (damping < 1e-6 && run.finished(trial.predicted, objective) && confirmed_end(objective, run)) return false;
    }
    return true;
}

}  // namespace vmslam::solve
