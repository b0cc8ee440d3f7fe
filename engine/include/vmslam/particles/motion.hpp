// The motion of the particles in one step: drawn from a noisy control, or from the Gaussian of a whole motion.
//
// Source: Thrun, Burgard and Fox, Probabilistic Robotics, section 5.3.
#pragma once

#include <variant>

#include "vmslam/numbers/random.hpp"
#include "vmslam/particles/gaussian.hpp"

namespace vmslam::particles {

/// Each particle draws its own control u' ~ N(u, diag(std²)) and moves to f(x, u') + e, e ~ N(0, epsilon I).
struct ControlMotion {
    double nu, omega, nu_std, omega_std, dt, epsilon;
};

/// Each particle moves, in its own axes, by a draw of N(mean, covariance).
struct WholeMotion {
    Vector mean;
    Symmetric covariance;
};

/// A motion, and the key of its random numbers.
struct Motion {
    std::variant<ControlMotion, WholeMotion> model;
    std::uint64_t key;
};

/// The motion of a control in the axes of its chord, which lies at `angle` = omega dt / 2 to the robot.
struct Chord {
    double angle;
    /// (chord, 0, turn)
    Vector mean;
    /// the entries of df/du that are not zero: nu moves along the chord; omega moves along and across it, and turns
    double by_nu, along, across, turn;

    /// A M A' in the axes of the chord, M the diagonal of the variances of nu and omega.
    Symmetric covariance(double nu, double omega) const;
};
Chord chord(double nu, double omega, double dt);

/// A motion as a Gaussian in axes at `angle` to the robot, plus epsilon I.
struct Prediction {
    double angle;
    Vector mean;
    Symmetric covariance;
    double epsilon;

    /// The Gaussian of a pose after the motion.
    Gaussian of(const Pose& start) const;
};

/// `exact`: the prediction whose corrections `WeightedDraw` weighs.
Prediction predict(const Motion& motion, bool exact);

/// Write the moved poses of the groups from `lo` to `hi`.
void move_poses(const Motion& motion, const Rows& starts, Rows& moved, std::size_t lo, std::size_t hi);

/// The indices of the particles of a group, for their random numbers.
inline numbers::Bits particles_of(std::size_t first) {
    return numbers::Bits{0, 1, 2, 3, 4, 5, 6, 7} + static_cast<std::uint64_t>(first);
}

}  // namespace vmslam::particles
