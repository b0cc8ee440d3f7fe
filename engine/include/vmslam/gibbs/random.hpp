// Random numbers for samplers, one after the other: normal, gamma and discrete.
#pragma once

#include <array>
#include <span>

#include "vmslam/numbers/random.hpp"

namespace vmslam::gibbs {

/// The numbers of `numbers/random.hpp` that belong to a key. Other keys give independent numbers.
class Random {
   public:
    explicit Random(std::uint64_t key) : key_(key) {}

    /// In [0, 1), with 53 bits.
    double uniform() { return numbers::uniform(key_, 2 * next_++); }
    double normal() {
        if (used_ == normals_.size()) draw_normals();
        return normals_[used_++];
    }
    /// Gamma with a shape of at least 1 and the scale 1.
    double gamma(double shape);
    /// An index in proportion to weights; the last one where they have no finite sum.
    std::size_t pick(std::span<const double> weights);
    /// An index in proportion to the exponentials of log weights.
    std::size_t choose(std::span<const double> log_weights);

   private:
    void draw_normals();

    std::uint64_t key_, next_ = 0;  ///< the number of the next pair
    std::array<double, 2 * numbers::lanes> normals_{};
    std::size_t used_ = normals_.size();
};

/// e^x and log x, the same on every machine; unlike those of `numbers` they have a value for every x.
double exponential(double x);
double logarithm(double x);

/// exp(w - max w) for log weights; returns their sum and that of their squares.
struct Sums {
    double weights, squares;
};
Sums exponentials(std::span<const double> log_weights, std::span<double> weights);

}  // namespace vmslam::gibbs
