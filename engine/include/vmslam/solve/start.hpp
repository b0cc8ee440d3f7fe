// The linear systems of rotation-first starts: headings by unit vectors, then positions with the headings known.
//
// Source: Carlone, Tron, Daniilidis and Dellaert, Initialization techniques for 3D SLAM, ICRA 2015.
#pragma once

#include <span>

#include "vmslam/edges/arithmetic.hpp"

namespace vmslam::solve {

using edges::Place;
using edges::System;

/// Linear relations between two nodes each, u_second - u_first = value, and the block that each pair shares.
struct Relations {
    std::span<const Place> first, second, pairs;
    std::span<const double> value, information;
};

/// Write the headings along edges between a known node and another one, which is known then; false at any other edge.
bool follow_headings(const Relations& edges, std::span<double> headings, std::span<bool> known);

/// Add edges with the residual R(value) r_first - r_second, r = (cos theta, sin theta) in the first two coordinates of nodes.
void add_headings(const Relations& edges, std::span<const double> unit, System& system);

/// Add edges with the residual p_second - p_first - value in the first two coordinates; the information is 2 x 2.
void add_positions(const Relations& edges, std::span<const double> position, System& system);

/// Measured positions (2) and their information (2 x 2), turned from the frame of the first node to the world's.
/// `rows` are those of the measurements.
void turn_to_world(std::span<const double> state, std::span<const Place> first, std::span<const double> measured,
                   std::span<const double> information, int rows, std::span<double> offset, std::span<double> omega);

}  // namespace vmslam::solve
