// Inputs of the fuzzer: every number follows from a seed. Most numbers are typical, some are at the limits of floating point.
#pragma once

#include <cmath>
#include <cstdint>
#include <numbers>
#include <random>

#include "vmslam/log.hpp"

namespace fuzz {

class Input {
   public:
    explicit Input(std::uint64_t seed) : random_(seed), hostile_(1 << (random_() % 12)) {}

    std::size_t below(std::size_t limit) { return random_() % limit; }
    std::size_t between(std::size_t least, std::size_t most) { return least + below(most - least + 1); }
    bool one_in(std::size_t n) { return below(n) == 0; }
    std::uint64_t bits() { return random_(); }

    /// A normal number of this size, or one that nobody expects.
    double number(double size) {
        if (!one_in(hostile_)) return size * std::normal_distribution<>()(random_);
        static constexpr double limits[]{0.0, 5e-324, 1e-300, 1e-154,   1e-9, std::numbers::pi,
                                         1e9, 1e154,  1e300,  HUGE_VAL, NAN};
        return (one_in(3) ? -1.0 : 1.0) * limits[below(std::size(limits))];
    }
    double positive(double size) { return std::fabs(number(size)); }
    /// A place up to about `size` away, with a heading.
    vmslam::edges::Vector place(double size, double heading) { return {number(size), number(size), number(heading)}; }

   private:
    std::mt19937_64 random_;
    std::size_t hostile_;  ///< one in so many numbers is at a limit: from nearly all to nearly none
};

inline vmslam::edges::Sighting sighting(Input& input) { return {input.positive(3.0), input.number(1.0), input.number(2.0)}; }

inline vmslam::edges::Sensor sensor(Input& input) {
    return {input.positive(0.02),  input.one_in(2) ? 0.0 : input.positive(0.01), input.positive(0.003),
            input.positive(0.003), input.one_in(2) ? 0.0 : input.number(0.3),    0.0};
}

inline vmslam::edges::Kernel kernel(Input& input) {
    return {static_cast<vmslam::edges::Robust>(input.below(4)), input.positive(2.0)};
}

/// A log of up to `most` motions, whose sightings come in any order and may be doubled.
inline vmslam::Log log(Input& input, std::size_t most) {
    vmslam::Log log;
    log.oriented = input.one_in(2);
    for (double& x : log.start) x = input.number(1.0);
    for (std::size_t t = input.below(most + 1); t > 0; --t)
        log.controls.push_back({input.number(0.5), input.number(0.5), input.positive(1.0)});
    const std::size_t landmarks = input.between(1, 10);
    for (std::size_t k = input.below(4 * log.poses()); k > 0; --k)
        log.sightings.push_back(
            {input.below(log.poses()), static_cast<std::int64_t>(input.below(landmarks)), sighting(input)});
    return log;
}

/// Count a failure where something does not hold.
void expect(bool holds, const char* what);

void fuzz_solve(Input& input);
void fuzz_online(Input& input);
void fuzz_filter(Input& input);

}  // namespace fuzz
