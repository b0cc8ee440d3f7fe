// Move the whole trajectory and map at once along the directions in which the log determines them least.
//
// Motion moves and block moves change a few poses at a time. A long log holds each of them tightly, while its whole
// trajectory may still shift, turn and bend by much more: it then takes them very many small steps. Here the posterior of
// trajectory and map is approximated by a Gaussian N(s, (J' J)^-1) at its mode s, as graph SLAM does. Its r widest
// directions, the columns of V with standard deviations d, are independent of all others under the Gaussian. Their
// coordinates a are proposed anew,
//
//     a' = sqrt(1 - b²) a + b n,    n ~ N(0, I),
//
// which leaves the Gaussian unchanged, and accepted with the probability exp(F(before) - F(after)), F = -log posterior + log
// Gaussian. So the target is exact, whatever the Gaussian. The step b is adapted in the warm-up and fixed afterwards.
//
// Sources: Cotter, Roberts, Stuart and White, MCMC methods for functions: modifying old algorithms to make them faster,
// Statistical Science 2013 (preconditioned Crank-Nicolson); Cui, Law and Marzouk, Dimension-independent likelihood-informed
// MCMC, Journal of Computational Physics 2016, for a subspace.
#include <algorithm>

#include "moves.hpp"

namespace vmslam::gibbs {
namespace {

/// a' b in eight sums, always the same ones.
double product(const double* a, const double* b, std::size_t size) {
    numbers::Lanes sums{};
    std::size_t i = 0;
    for (; i + numbers::lanes <= size; i += numbers::lanes) sums += numbers::load(a + i) * numbers::load(b + i);
    double sum = 0.0;
    for (int k = 0; k < numbers::lanes; ++k) sum += sums[k];
    for (; i < size; ++i) sum += a[i] * b[i];
    return sum;
}

double square(std::span<const double> a) { return product(a.data(), a.data(), a.size()); }

/// Moves of a state, which they change in place.
class LowRankMoves {
   public:
    LowRankMoves(const Problem& problem, const Directions& directions, Trajectory& x, Map& m)
        : problem_(problem), directions_(directions), x_(x), m_(m), away_(difference()), a_(directions.deviations.size()) {
        // a = V' (state - mode) / d
        for (std::size_t k = 0; k < a_.size(); ++k)
            a_[k] = product(directions.rows.data() + k * width(), away_.data(), width()) / directions.deviations[k];
    }

    int move(Random& random, double step, int moves) {
        const double stay = std::sqrt(1.0 - step * step);
        double value = cost(problem_, x_, m_, problem_.exact, {}) - 0.5 * square(a_);
        std::vector<double> proposed(a_.size()), moved(width()), reached(width());
        int accepted = 0;
        for (int k = 0; k < moves; ++k) {
            std::fill(moved.begin(), moved.end(), 0.0);
            for (std::size_t i = 0; i < a_.size(); ++i) {
                // a' = sqrt(1 - b²) a + b n, and the state moves by V d (a' - a)
                proposed[i] = stay * a_[i] + step * random.normal();
                const double along = directions_.deviations[i] * (proposed[i] - a_[i]);
                const double* const direction = directions_.rows.data() + i * width();
                for (std::size_t j = 0; j < moved.size(); ++j) moved[j] += along * direction[j];
            }
            for (std::size_t j = 0; j < moved.size(); ++j) reached[j] = away_[j] + moved[j];
            // half a turn from the mode, the way back would begin at other coordinates: such moves are rejected
            if (beyond_half_a_turn(reached)) continue;
            Trajectory x = x_;
            Map m = m_;
            displace(x, m, moved);
            const double excess = cost(problem_, x, m, problem_.exact, {}) - 0.5 * square(proposed);
            if (!(logarithm(random.uniform()) < value - excess)) continue;
            x_ = std::move(x), m_ = std::move(m);
            std::swap(away_, reached), std::swap(a_, proposed);
            value = excess;
            ++accepted;
        }
        return accepted;
    }

   private:
    std::size_t width() const { return away_.size(); }
    std::size_t each() const { return problem_.oriented ? 3 : 2; }

    /// The state less the mode.
    std::vector<double> difference() const {
        std::vector<double> out;
        out.reserve(3 * x_.size() + each() * m_.size());
        for (Number t = 1; t < x_.size(); ++t) {
            const Vector d = deviation(directions_.poses[t], x_[t]);
            out.insert(out.end(), {d.x, d.y, d.t});
        }
        for (Number j = 0; j < m_.size(); ++j) {
            const Vector d = deviation(directions_.marks[j], m_[j]);
            out.insert(out.end(), {d.x, d.y});
            if (problem_.oriented) out.push_back(d.t);
        }
        return out;
    }

    bool beyond_half_a_turn(std::span<const double> away) const {
        const std::size_t end = problem_.oriented ? away.size() : 3 * problem_.steps();
        for (std::size_t i = 2; i < end; i += 3)
            if (std::abs(away[i]) > numbers::pi) return true;
        return false;
    }

    void displace(Trajectory& x, Map& m, std::span<const double> step) const {
        const double* at = step.data();
        for (Number t = 1; t < x.size(); ++t, at += 3) x[t] = {x[t].x + at[0], x[t].y + at[1], wrap_angle(x[t].t + at[2])};
        for (Vector& mark : m) {
            mark.x += at[0], mark.y += at[1];
            if (problem_.oriented) mark.t = wrap_angle(mark.t + at[2]);
            at += each();
        }
    }

    const Problem& problem_;
    const Directions& directions_;
    Trajectory& x_;
    Map& m_;
    std::vector<double> away_;  ///< the state less the mode
    std::vector<double> a_;  ///< its coordinates
};

}  // namespace

int move_along(Random& random, const Problem& problem, const Directions& directions, double step, int moves, Trajectory& x,
               Map& m) {
    return LowRankMoves(problem, directions, x, m).move(random, step, moves);
}

}  // namespace vmslam::gibbs
