#include "vmslam/gibbs/random.hpp"

#include <cmath>
#include <limits>
#include <vector>

namespace vmslam::gibbs {

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

void Random::draw_normals() {
    numbers::Bits pairs{};
    for (int k = 0; k < numbers::lanes; ++k) pairs[k] = next_++;
    const auto [first, second] = numbers::normal_pair<numbers::Lanes>(key_, pairs);
    numbers::store(normals_.data(), first);
    numbers::store(normals_.data() + numbers::lanes, second);
    used_ = 0;
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
