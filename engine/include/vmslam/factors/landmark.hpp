// Pairs of sightings of one landmark as factors of GTSAM: one pair, or all of them in one factor with the sums that it needs.
#pragma once

#include <array>
#include <span>
#include <vector>

#include "vmslam/edges/arithmetic.hpp"

namespace vmslam::factors {

using edges::Index;

/// Where the sightings z (l, phi[, psi]) of poses put their landmark, y = h^-1(x, z), its heading not wrapped; what turning
/// the pose does to y; and the axes of the pairs whose first sighting it is, which stand at theta + ahead, or are the
/// world's.
struct PlacedSighting {
    Index node;
    edges::Vector y;
    edges::Lever lever;
    edges::Rotation axes;
};

/// Sightings, and the pairs (a, b) of them with the information of e = y_b - y_a in the axes of a.
struct LandmarkPairs {
    std::vector<Index> nodes;
    std::vector<double> z, ahead;
    int dimension;
    double offset_x, offset_y;
    bool turning;
    std::vector<Index> a, b;
    std::vector<edges::Symmetric> information;

    std::vector<PlacedSighting> placed(std::span<const double> x) const;
    /// Of a single pair: e (d), and the columns of de/da (d, 3) and de/db (d, 3) by perturbations of the poses in their own
    /// axes.
    std::vector<double> linearized(const std::array<double, 3>& first, const std::array<double, 3>& second) const;
    /// The sum of e' Omega e.
    double cost(std::span<const double> x) const;
    /// A'A (3P, 3P) and A'b (3P) by perturbations of the P poses in their own axes, and b'b.
    struct Sums {
        std::vector<double> omega, slope;
        double total = 0.0;
    };
    Sums sums(std::span<const double> x) const;
};

}  // namespace vmslam::factors
