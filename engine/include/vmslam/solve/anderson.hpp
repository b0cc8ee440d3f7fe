// Anderson acceleration of an iteration x -> g(x) that converges linearly.
//
// With f = g(x) - x and the differences dX, dF of the last iterates, gamma = argmin |f - dF gamma| gives the next iterate
// x + f - (dX + dF) gamma. A fixed point of g stays one.
//
// Source: Anderson, Iterative procedures for nonlinear integral equations, J. ACM 12 (1965); Walker and Ni, Anderson
// acceleration for fixed-point iterations, SIAM J. Numer. Anal. 49 (2011).
#pragma once

#include <deque>
#include <span>
#include <vector>

namespace vmslam::solve {

class AndersonAcceleration {
   public:
    /// Whether the last iterate was mixed.
    bool active() const { return kept_.size() > 1; }

    /// The next iterate, from x and f = g(x) - x. It starts anew where the root mean square of f is above 0.1, so that g is
    /// not nearly linear, or has doubled.
    std::vector<double> next(std::span<const double> x, std::span<const double> f);

   private:
    struct Iterate {
        std::vector<double> x, f;
    };
    std::deque<Iterate> kept_;
};

}  // namespace vmslam::solve
