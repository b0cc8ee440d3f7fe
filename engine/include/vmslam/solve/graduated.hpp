// Graduated non-convexity: which measurements are wrong, found together with the state.
//
// Truncated least squares counts r² = e' Omega e of a measurement as at most c². This cost has very many minima. A good one is
// searched by rounds in which mu grows from near 0, where the cost is nearly that of least squares. In each the trust
//
//     w = 1 for r² <= mu / (mu + 1) c²,   w = 0 for r² >= (mu + 1) / mu c²,   w = c sqrt(mu (mu + 1)) / r - mu between,
//
// multiplies the information of every measurement, and some damped steps lower the cost.
//
// Source: Yang, Antonante, Tzoumas and Carlone, Graduated non-convexity for robust spatial perception, RA-L 2020.
#pragma once

#include <optional>
#include <vector>

#include "vmslam/solve/run.hpp"

namespace vmslam::solve {

/// mu grows by this factor from one round to the next.
inline constexpr double growth = 1.4;
/// The most rounds in which the trust is all or nothing and may still change.
inline constexpr int last_rounds = 20;
/// The least factor on information: a landmark all of whose sightings are wrong must still be somewhere.
inline constexpr double least_trust = 1e-9;

/// w of a measurement with the square r² / c²; 0 or 1 for infinite mu.
double truncated_trust(double square, double mu);

/// A family of a graph whose measurements may be wrong. In the graph they are fully trusted.
struct Doubted {
    std::size_t member, measurements;  ///< its place among the families, and the number of its measurements
    double limit;  ///< c²
    const edges::Family* measured;  ///< the edges that give the squares of the measurements
};

class Graduation {
   public:
    /// `steps` are the rules of the damped steps in a round.
    Graduation(const GraphObjective& graph, std::vector<Doubted> doubted, Rules steps, std::vector<double> state,
               std::vector<double> trust)
        : state(std::move(state)), trust(std::move(trust)), graph_(graph), doubted_(std::move(doubted)), steps_(steps) {}

    std::vector<double> state, trust;  ///< the trust in the measurements of all families, one after another
    int rounds = 0;
    bool settled = false;  ///< whether each measurement is fully trusted or rejected
    std::optional<double> stuck;  ///< the damping with which Omega has no factor, where the edges do not determine the state

    /// The rounds from full trust to truncated squares, at most so many.
    void graduate(int most_rounds);
    /// Rounds with infinite mu, to the nearest minimum of the truncated squares.
    void settle();
    /// Let the trust follow from the squares at the state.
    void judge(double mu);
    /// r² / c² of each measurement, as if it were fully trusted.
    std::vector<double> squares() const;
    /// The sum of r² of all measurements, each at most c².
    double truncated() const;

   private:
    /// Damped steps with the trust; false where the edges do not determine the state.
    bool descend();
    /// Call use(family, factors on the information of its measurements).
    template <class Use>
    void for_each(Use use) const;

    const GraphObjective& graph_;
    std::vector<Doubted> doubted_;
    Rules steps_;
};

}  // namespace vmslam::solve
