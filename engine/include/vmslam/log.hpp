// What a robot has recorded: controls, and sightings of landmarks. Programs without Python begin with it.
//
// The noise models are those of the book (Ueda, LNPR, chapters 5 to 9), and so are the defaults. `solve/graph.hpp` makes a
// graph of a log; steps of the online solver and of the particle filters take the same numbers one by one.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "vmslam/edges/sightings.hpp"
#include "vmslam/particles/motion.hpp"

namespace vmslam {

/// u = (nu, omega) [m/s, rad/s], held for dt [s].
struct Control {
    double nu, omega, dt;
};

/// A landmark seen from the pose of a step: range [m], bearing [rad] and, where the sensor measures it, orientation [rad].
struct LandmarkSighting {
    std::size_t step;
    std::int64_t landmark;
    edges::Sighting z;
};

struct Log {
    std::array<double, 3> start{};      ///< the first pose [m, m, rad]
    std::vector<Control> controls;      ///< control t leads from pose t to pose t + 1, unless there are `starts`
    std::vector<LandmarkSighting> sightings;
    bool oriented = true;               ///< whether orientations are measured

    /// Of motions that consist of several controls: the first control of each, and the number of all controls.
    std::vector<std::size_t> starts;

    std::size_t poses() const { return starts.empty() ? controls.size() + 1 : starts.size(); }
    /// The controls that lead from pose t to pose t + 1.
    std::span<const Control> motion(std::size_t t) const {
        if (starts.empty()) return {&controls[t], 1};
        return std::span(controls).subspan(starts[t], starts[t + 1] - starts[t]);
    }
};

struct ControlVariances;

/// Standard deviations of the speed per root of distance driven and of angle turned (nn, no), those of the turn rate (on,
/// oo), the variance that is added to every pose, standard deviations of the speed and of the turn rate that every control
/// has, and that of the motion sideways per root of distance driven.
struct MotionNoise {
    double nn = 0.19, no = 0.001, on = 0.13, oo = 0.2, epsilon = 1e-4;
    double sigma_v = 0.0, sigma_omega = 0.0, slip = 0.0;

    /// M = diag(nn² |nu|/dt + no² |omega|/dt + sigma_v², on² |nu|/dt + oo² |omega|/dt + sigma_omega²), and slip² |nu| dt.
    ControlVariances variances(const Control& u) const;
    /// M as the particle filters take it, which have no slip.
    particles::ControlMotion of(const Control& u) const;
};

/// The variances of a control: of its speed, of its turn rate, and of the way across its chord.
struct ControlVariances {
    double nu, omega, sideways;
};

/// A sensor at the centre of the robot whose range error grows with the range.
inline constexpr edges::Sensor book_sensor{0.14 * 0.14, 0.0, 0.05 * 0.05, 0.05 * 0.05, 0.0, 0.0};

/// What a motion or a sighting measures in the axes of the pose from which it starts, with its information.
struct Measured {
    edges::Vector z;
    edges::Symmetric omega;
};

/// Where controls that follow one another lead from the origin: f(... f(0, u_1) ..., u_k), P <- F P F' + A M A' + S for each,
/// with S = s n n', s the variance sideways and n across the chord. With a noise model epsilon I is added once.
struct Moved {
    edges::Vector end;
    edges::Symmetric covariance;
};
Moved moved(std::span<const Control> controls, std::span<const ControlVariances> variances);
Moved moved(std::span<const Control> controls, const MotionNoise& noise = {});

/// The derivative of a motion by the speed and the turn rate of one of its controls, rows x, y and heading.
struct ControlSlope {
    double x[2], y[2], t[2];
};
/// Where controls lead from the origin, and the derivative of that by each of them.
edges::Vector slopes(std::span<const Control> controls, std::span<ControlSlope> by_control);
/// The relative pose f(0, u), Omega^-1 = A M A' + S + epsilon I.
Measured measured(const Control& u, const MotionNoise& noise = {});
/// The same of controls that follow one another.
Measured measured(std::span<const Control> controls, const MotionNoise& noise = {});
/// The landmark h^-1(0, z) = (l cos phi, l sin phi, phi - psi), Omega^-1 = R Q R'; without a heading unless `oriented`.
Measured measured(const edges::Sighting& z, bool oriented, const edges::Sensor& sensor = book_sensor);

/// The poses (x, y, heading) that follow from the controls alone, which is where solvers start.
std::vector<double> dead_reckoning(const Log& log);

}  // namespace vmslam
