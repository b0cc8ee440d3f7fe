// The robust mean of the sightings of one landmark.
#pragma once

#include <span>

#include "vmslam/edges/marginal.hpp"

namespace vmslam::edges {

/// Sightings of one landmark: where each places it, relative to the first sighting, and the trust in it.
struct Cluster {
    std::span<const Vector> places;
    std::span<const double> trust;
    Kernel kernel;
    bool oriented;

    /// What replaces the heading row of S where no sighting has one.
    double filling() const { return oriented ? 0.0 : 1.0; }
};

/// Where the search for the mean heading starts: 0, or the weighted circular mean of headings that lie more than a quarter
/// turn from the first. Within a quarter turn no heading wraps, and the mean is the same from anywhere.
double start_heading(const Cluster& cluster, std::span<const AroundMean> sightings);

/// The robust mean from a start, and its cost; fills e and the factor of the sightings.
struct Mean {
    Vector at;
    double cost;
};
Mean robust_mean(const Cluster& cluster, const Vector& start, std::span<AroundMean> sightings);

}  // namespace vmslam::edges
