// Initial values by rotation first: headings by linear least squares on unit vectors, then positions with the headings known.
//
// With r_i = (cos theta_i, sin theta_i), every edge that measures a relative heading d asks for R(d) r_i = r_j. With the
// headings known, the positions are linear, too. Both systems have the pattern of Omega, so that its ordering serves them.
//
// Source: Carlone, Tron, Daniilidis and Dellaert, Initialization techniques for 3D SLAM, ICRA 2015 (there called chordal
// relaxation, for the plane).
#pragma once

#include <span>
#include <vector>

#include "vmslam/solve/objective.hpp"

namespace vmslam::solve {

/// Initial values, or why there are none.
struct Start {
    std::vector<double> state;
    std::vector<Index> unturned;  ///< poses of which no edge measures the heading; then the state has no meaning
    Index untied = -1;  ///< a node that the edges do not tie to the others; then neither, -1 for none
    Index unlisted = -1;  ///< a node of a relation that the pattern of the graph does not have; then neither, -1 for none

    bool found() const { return unturned.empty() && untied < 0 && unlisted < 0; }
};

/// Initial values of the nodes of a graph, the first `poses` of which have headings; `held` nodes keep those of the state.
Start rotation_first(const GraphObjective& graph, std::vector<double> state, std::span<const Index> held, Index poses);

}  // namespace vmslam::solve
