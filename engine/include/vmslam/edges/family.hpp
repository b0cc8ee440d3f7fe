// What all edge families have in common.
#pragma once

#include <span>

#include "vmslam/edges/arithmetic.hpp"
#include "vmslam/edges/robust.hpp"

namespace vmslam::edges {

/// The values of all nodes, (x, y, heading) each. Some information matrices depend on them: they are evaluated at the
/// `reference`, which a damped search keeps fixed during a step, so that the function that it minimises stays the same.
struct State {
    const double* at;
    const double* reference;

    const double* node(Index i) const { return at + 3 * i; }
    const double* reference_of(Index i) const { return reference + 3 * i; }
};

/// Edges of one kind. All of them write e' Omega e into the cost, B' Omega B into Omega and -B' Omega e into xi.
class Family {
   public:
    virtual ~Family() = default;

    /// The edges added to a system, where one is given, and their cost. `pairs` has the block between the two ends of each
    /// edge, for the families that list their edges.
    virtual double accumulate(const State& state, System* system, std::span<const Index> pairs) const = 0;
};

}  // namespace vmslam::edges
