// Random numbers for samplers: normal, gamma and discrete, from any source of random bits.
//
// A seed gives the same numbers on every machine, and from NumPy's bit generators the numbers of NumPy's `Generator`.
#pragma once

#include <cstdint>
#include <span>

namespace vmslam::gibbs {

/// A source of 64 random bits: a function of some state, such as a bit generator of NumPy.
struct BitSource {
    void* state;
    std::uint64_t (*next)(void*);
};

/// A view of a source, which must live as long.
class Random {
   public:
    explicit Random(BitSource source) : source_(source) {}

    /// In [0, 1), with 53 bits.
    double uniform() { return static_cast<double>(static_cast<std::int64_t>(bits() >> 11)) * 0x1p-53; }
    double normal();
    /// Gamma with a shape of at least 1 and the scale 1.
    double gamma(double shape);
    /// An index in proportion to weights; the last one where they have no finite sum.
    std::size_t pick(std::span<const double> weights);
    /// An index in proportion to the exponentials of log weights.
    std::size_t choose(std::span<const double> log_weights);

   private:
    std::uint64_t bits() { return source_.next(source_.state); }
    double tail();

    BitSource source_;
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
