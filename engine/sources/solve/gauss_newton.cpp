#include "vmslam/solve/run.hpp"

namespace vmslam::solve {
namespace {

using State = std::vector<double>;

/// Gauss-Newton that has not converged after so many plain steps converges slowly, or oscillates: the iterates are mixed.
constexpr int plain_steps = 8;
/// Newton's method follows after so many plain steps where one promises less than the part `near` of J, so that the minimum
/// is not far, and more than the part `slow` of what the step before it promised.
constexpr int before_newton = 4;
constexpr double near = 0.01, slow = 0.01;
/// Plain and mixed steps without progress after which the steps are damped.
constexpr int patience = 10, patience_mixed = 30;
/// So many damped steps follow, and then undamped ones again.
constexpr int damped_steps = 20;
/// A kept factor is renewed where the gain that it predicts, or the square of the step's length, is more than this part of
/// that of the step before it.
constexpr double shrinking = 0.1;

/// Delta = Omega^-1 xi, with the factor of an earlier state where Omega hardly changes.
class Step {
   public:
    std::vector<double> delta;
    double predicted = 0.0;  ///< the quadratic model predicts that J falls by Delta' Omega Delta = xi' Delta

    Step(Objective& objective, Run& run) : delta(run.state.size()), objective_(objective), run_(run) {}

    /// The correction at the present state; false where there is none. `enough` is a decrease that ends the iteration.
    bool compute(double enough) {
        if (kept_) {
            if (!solve()) return false;
            const double longest = shrinking * run_.norms.back() * run_.norms.back();
            if (predicted > enough && (predicted > shrinking * run_.predicted || inner(delta, delta) > longest))
                kept_ = false;
        }
        if (kept_) return true;
        ++run_.factorizations;
        kept_ = objective_.factorize(0.0) && solve();
        return kept_;
    }
    void renew() { kept_ = false; }

   private:
    bool solve() {
        if (!objective_.solve(delta)) return false;
        predicted = inner(objective_.xi(), delta);
        return true;
    }

    Objective& objective_;
    Run& run_;
    bool kept_ = false;
};

/// How undamped steps end.
enum class Pass {
    over,         ///< the run has stopped
    no_progress,  ///< neither the lowest J nor the shortest step has improved for a while
    slow,         ///< the minimum is near, and second derivatives lead there faster
};

/// Steps until one of these ends; the last two leave the best state in the run. The iterates are mixed after `plain` steps.
/// Without plain steps, a run that takes all its iterations also ends at the best state.
Pass undamped(Objective& objective, Run& run, int plain) {
    const bool newton = objective.curves();
    const int mixed_from = newton ? plain : objective.state_dependent || objective.reweighted ? 0 : plain;
    run.anderson.reset();
    Step step(objective, run);
    State best = run.state;
    const auto leave = [&](Pass pass) {
        run.state = best;
        return pass;
    };
    double lowest = std::numeric_limits<double>::infinity(), shortest = lowest;
    int progress = 0;
    const int most = run.rules.most_steps - run.steps();
    for (int k = 0; k < most; ++k) {
        if (k == mixed_from) run.anderson.emplace();
        const double cost = objective.linearize(run.state, run.state);
        if (run.diverged(cost) || run.settled(cost)) return Pass::over;
        if (cost < lowest) best = run.state, lowest = cost, progress = k;
        const double enough = confirmed * run.rules.cost_tolerance * cost;
        if (!step.compute(enough)) {
            run.end = End::not_determined;
            return Pass::over;
        }
        if (newton && k >= before_newton && step.predicted < near * cost && step.predicted > slow * run.predicted)
            return leave(Pass::slow);
        run.step(cost, step.delta);
        if (run.finished(step.predicted, objective)) {
            if (cost <= lowest * (1 + promise) || objective.state_dependent) return Pass::over;
            // mixed steps may also end at a maximum, or in a higher minimum
            run.converged = false;
            return leave(Pass::no_progress);
        }
        if (run.norms.back() < shortest) shortest = run.norms.back(), progress = k;
        if (k - progress >= (run.mixed() ? patience_mixed : patience)) return leave(Pass::no_progress);
        if (step.predicted > (run.anderson ? enough : run.rules.kept * cost)) step.renew();
    }
    if (plain) return Pass::over;
    return leave(Pass::no_progress);
}

/// At the end of its life, `linearize` of an objective adds no second derivatives.
struct Plain {
    Objective& objective;
    ~Plain() { objective.curve(false); }
};

}  // namespace

void gauss_newton(Objective& objective, Run& run) {
    run.end = End::most_steps;
    Pass pass = undamped(objective, run, plain_steps);
    const int damped_from = run.steps();
    while (pass == Pass::no_progress) {
        run.end = End::most_steps;
        if (run.steps() == run.rules.most_steps || !levenberg_marquardt(objective, run, damped_steps)) break;
        // damped steps that lower J by a small part are slow, too
        const double fall = run.costs.rbegin()[1] - run.costs.back();
        const bool small = objective.curves() && fall < near * run.costs.back();
        pass = small ? Pass::slow : undamped(objective, run, 0);
    }
    if (run.steps() > damped_from) run.damped_from = damped_from;
    if (pass != Pass::slow) return;
    // an observer may throw, and the objective may serve further runs
    const Plain afterwards{objective};
    run.curved_from = run.steps();
    levenberg_marquardt(objective, run, run.rules.most_steps, true);
    // rounding may leave no damping with which Omega is definite and J falls
    if (run.end == End::no_lower_cost) levenberg_marquardt(objective, run, run.rules.most_steps);
}

}  // namespace vmslam::solve
