// Elementary functions and random numbers: against the C library, and every lane against the function of one number.
#include "expect.hpp"
#include "vmslam/edges/rotations.hpp"
#include "vmslam/numbers/random.hpp"

namespace {

using namespace vmslam;
using numbers::Lanes;

double difference(double a, double b) { return std::fabs(a - b) / std::fmax(1.0, std::fabs(b)); }

void test_library(double x, double y) {
    const auto [sine, cosine] = numbers::sincos(20 * x);
    expect(difference(sine, std::sin(20 * x)) < 2e-15 && difference(cosine, std::cos(20 * x)) < 2e-15, "sincos", 0);
    expect(difference(numbers::atan2(y, x), std::atan2(y, x)) < 1e-15, "atan2", 0);
    expect(difference(numbers::log(x * x), std::log(x * x)) < 1e-15, "log", 0);
    expect(difference(numbers::exp(10 * x), std::exp(10 * x)) < 1e-15, "exp", 0);
    const double wrapped = numbers::wrap_angle(10 * x);
    expect(wrapped >= -numbers::pi && wrapped < numbers::pi && std::fabs(std::sin(wrapped - 10 * x)) < 1e-13, "wrap_angle",
           0);
}

void test_lanes(std::uint64_t key, std::uint64_t first) {
    numbers::Bits particles;
    for (int k = 0; k < numbers::lanes; ++k) particles[k] = first + k;
    const auto [x, y] = numbers::normal_pair<Lanes>(key, particles, 1);
    const Lanes angles = numbers::atan2(y, x), logarithms = numbers::log(Lanes(x * x)), powers = numbers::exp(x);
    const Lanes wrapped = numbers::wrap_angle(Lanes(10 * x)), sines = numbers::sincos(x).sine;
    for (int k = 0; k < numbers::lanes; ++k) {
        const auto [a, b] = numbers::normal_pair<double>(key, particles[k], 1);
        expect(x[k] == a && y[k] == b, "normal_pair in lanes", 0);
        expect(angles[k] == numbers::atan2(b, a) && logarithms[k] == numbers::log(a * a), "atan2 and log in lanes", 0);
        expect(powers[k] == numbers::exp(a) && sines[k] == numbers::sincos(a).sine, "exp and sincos in lanes", 0);
        expect(wrapped[k] == numbers::wrap_angle(10 * a), "wrap_angle in lanes", 0);
        test_library(a, b);
    }
}

/// Also for large angles, infinite ones, and numbers that are no multiple of eight.
void test_rotations() {
    std::vector<double> angles{0.0, -0.0, 1e6, 1.1e6, -1e15, HUGE_VAL};
    for (int k = -60; k < 60; ++k) angles.push_back(k * numbers::pi / 8 + 1e-9 * k);
    edges::Rotations rotations(angles.size(), [&](std::size_t k) { return angles[k]; });
    for (std::size_t k = 0; k < angles.size(); ++k) {
        const edges::Rotation found = rotations[k], expected(angles[k]);
        const bool same = std::isfinite(angles[k])
                              ? difference(found.c, expected.c) < 2e-15 && difference(found.s, expected.s) < 2e-15
                              : std::isnan(found.c) && std::isnan(found.s);
        expect(same, "rotations of a sequence", static_cast<unsigned>(k));
    }
}

}  // namespace

void test_numbers() {
    test_rotations();
    double sum = 0.0, squares = 0.0;
    constexpr int count = 20'000;
    for (int i = 0; i < count; ++i) {
        const double n = numbers::normal_pair<double>(7, i, 2).second;
        sum += n, squares += n * n;
    }
    expect(std::fabs(sum / count) < 4 / std::sqrt(count) && std::fabs(squares / count - 1) < 4 * std::sqrt(2.0 / count),
           "standard normal numbers", 0);
    for (std::uint64_t i = 0; i < 2000; ++i) test_lanes(12345, numbers::lanes * i);
    // SplitMix64 started at 0 gives 0xE220A8397B1DCDAF first
    expect(numbers::uniform(0, std::uint64_t{0}) == static_cast<double>(0xE220A8397B1DCDAF >> 11) * 0x1p-53, "SplitMix64", 0);
    expect(numbers::exp(-800.0) == 0.0 && numbers::nearest(2.4) == 2.0, "exp and nearest", 0);
}
