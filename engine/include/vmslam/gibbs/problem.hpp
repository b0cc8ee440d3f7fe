// What a sampler of trajectories and maps is given: the motions and sightings of a log, and their density.
#pragma once

#include <vector>

#include "vmslam/gibbs/gaussian.hpp"

namespace vmslam::gibbs {

using Number = std::size_t;
using Trajectory = std::vector<Vector>;
using Map = std::vector<Vector>;

/// d_t = x_t seen from x_{t-1}, d_t ~ N(mean, information^-1).
struct Motion {
    Vector mean;
    Symmetric information;
};

/// The numbers of a sighting.
struct Seen {
    Gaussian seen;     ///< the relative place y of the landmark, and its covariance C
    Symmetric weight;  ///< its information; without psi nothing of the headings
    Vector z, q;       ///< range, bearing and psi as measured, and their variances
};

struct Sighting : Seen {
    Number step, mark;
};

struct Problem {
    std::vector<Motion> motions;  ///< (T)
    std::vector<Sighting> sightings;
    std::vector<Number> first;  ///< (T + 2) those of step t are first[t] to first[t + 1] - 1
    Number marks;               ///< the number of landmarks
    bool oriented;              ///< whether psi is measured
    bool exact;                 ///< whether sightings have the density of range and bearing, or the linearised one
    double degrees;             ///< of freedom of Student's t distribution of the sightings; 0: Gaussian

    Number steps() const { return motions.size(); }
    double coordinates() const { return oriented ? 3.0 : 2.0; }
};

/// The sightings of some steps.
inline std::span<const Sighting> seen_at(const Problem& problem, std::span<const Sighting> sightings, Number from,
                                         Number to) {
    return sightings.subspan(problem.first[from], problem.first[to + 1] - problem.first[from]);
}

/// work(frame of the pose, sighting) for each of some sightings; those of a step follow each other.
template <class Work>
void each_with_pose(const Trajectory& x, std::span<const Sighting> sightings, const Work& work) {
    Frame pose;
    Number step = x.size();
    for (const Sighting& s : sightings) {
        if (s.step != step) pose = Frame(x[step = s.step]);
        work(pose, s);
    }
}

/// -log of the posterior of a trajectory and a map, without constants, with the precisions of the sightings integrated out.
/// `squares`, where not empty, receives e' C^-1 e of the sightings.
double cost(const Problem& problem, const Trajectory& x, const Map& m, bool exact, std::span<double> squares);

/// The errors of range, bearing and psi of a sighting whose landmark is at a relative place, squared, over their variances.
double exact_squares(const Vector& z, const Vector& q, const Vector& place, bool oriented);

/// A draw of the landmarks given a trajectory.
Map draw_map(Random& random, const Trajectory& x, std::span<const Sighting> sightings, Number marks, bool oriented);

}  // namespace vmslam::gibbs
