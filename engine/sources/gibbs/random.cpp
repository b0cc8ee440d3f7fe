#include "vmslam/gibbs/random.hpp"

#include <array>
#include <cmath>
#include <limits>
#include <vector>

#include "vmslam/numbers/elementary.hpp"

namespace vmslam::gibbs {
namespace {

/// The ziggurat of the standard normal density f(x) = exp(-x²/2): 256 layers of the same area, the lowest with the tail.
///
/// Source: Marsaglia and Tsang, The ziggurat method for generating random variables, Journal of Statistical Software 2000,
/// with the constants and the order of layers of NumPy.
struct Ziggurat {
    static constexpr double tail = 3.6541528853610087963519472518, area = 0.0049286732339746571;
    std::array<double, 256> scale, density;  ///< layer i has |x| < 2^52 scale[i], and f there is density[i]
    std::array<std::uint64_t, 256> inside;   ///< numbers below this are below the density

    Ziggurat() {
        const auto f = [](double x) { return numbers::exp(-0.5 * x * x); };
        double x = tail;
        scale[255] = tail * 0x1p-52, density[255] = f(tail);
        scale[0] = area / f(tail) * 0x1p-52, density[0] = 1.0;
        inside[0] = static_cast<std::uint64_t>(tail * f(tail) / area * 0x1p52);
        inside[1] = 0;
        for (int i = 254; i > 0; --i) {
            const double above = std::sqrt(-2.0 * numbers::log(area / x + density[i + 1]));
            inside[i + 1] = static_cast<std::uint64_t>(above / x * 0x1p52);
            scale[i] = above * 0x1p-52, density[i] = f(above);
            x = above;
        }
    }
};

const Ziggurat& ziggurat() {
    static const Ziggurat layers;
    return layers;
}

}  // namespace

double exponential(double x) { return std::isnan(x) ? x : numbers::exp(x); }

double logarithm(double x) {
    if (x >= std::numeric_limits<double>::min() && x < std::numeric_limits<double>::infinity()) return numbers::log(x);
    // zero and numbers next to it, infinity; NaN for the others
    return std::log(x);
}

Sums exponentials(std::span<const double> log_weights, std::span<double> weights) {
    double most = log_weights[0];
    for (const double w : log_weights)
        if (!(w <= most)) most = w;
    Sums sums{0.0, 0.0};
    for (std::size_t i = 0; i < weights.size(); ++i) {
        weights[i] = exponential(log_weights[i] - most);
        sums.weights += weights[i];
        sums.squares += weights[i] * weights[i];
    }
    return sums;
}

double Random::normal() {
    const Ziggurat& layers = ziggurat();
    while (true) {
        // 8 bits for the layer, 1 for the sign, 52 for the place in it
        const std::uint64_t drawn = bits(), place = (drawn >> 9) & 0xFFFFFFFFFFFFF;
        const std::size_t i = drawn & 0xFF;
        const double size = static_cast<double>(place) * layers.scale[i], x = drawn & 0x100 ? -size : size;
        if (place < layers.inside[i]) return x;
        if (i == 0) return (place >> 8) & 1 ? -tail() : tail();
        const double height = layers.density[i] + (layers.density[i - 1] - layers.density[i]) * uniform();
        if (height < numbers::exp(-0.5 * x * x)) return x;
    }
}

/// Beyond the last layer: r - log(u) / r, accepted with the probability exp(-(log(u) / r)² / 2).
double Random::tail() {
    while (true) {
        const double beyond = -logarithm(1.0 - uniform()) / Ziggurat::tail, level = -logarithm(1.0 - uniform());
        if (level + level > beyond * beyond) return Ziggurat::tail + beyond;
    }
}

// Marsaglia and Tsang, A simple method for generating gamma variables, ACM Transactions on Mathematical Software 2000:
// b v³ with v = 1 + c x, b = shape - 1/3, c = 1 / sqrt(9 b), accepted if log u < x²/2 + b (1 - v³ + log v³).
double Random::gamma(double shape) {
    const double b = shape - 1.0 / 3.0, c = 1.0 / std::sqrt(9 * b);
    while (true) {
        double x, v;
        do {
            x = normal();
            v = 1.0 + c * x;
        } while (v <= 0.0);
        v = v * v * v;
        const double u = uniform();
        if (u < 1.0 - 0.0331 * (x * x) * (x * x)) return b * v;
        if (logarithm(u) < 0.5 * x * x + b * (1.0 - v + logarithm(v))) return b * v;
    }
}

std::size_t Random::pick(std::span<const double> weights) {
    double sum = 0.0, total = 0.0;
    for (const double w : weights) sum += w;
    const double level = uniform() * sum;
    for (std::size_t i = 0; i < weights.size(); ++i) {
        total += weights[i];
        if (level < total) return i;
    }
    return weights.size() - 1;
}

std::size_t Random::choose(std::span<const double> log_weights) {
    std::vector<double> weights(log_weights.size());
    exponentials(log_weights, weights);
    return pick(weights);
}

}  // namespace vmslam::gibbs
