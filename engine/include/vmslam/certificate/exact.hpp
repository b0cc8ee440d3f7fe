// Sums with twice the digits, and complex numbers.
// These files are compiled without contraction to fused multiply-adds, because the bounds count every rounding.
#pragma once

#include <cmath>
#include <complex>

namespace vmslam::certificate {

/// The unit roundoff of double precision.
inline constexpr double roundoff = 0x1p-53;

/// A sum or product as its rounded value and the error of that.
struct Exact {
    double value, error;
};

/// a + b, exactly (Knuth).
inline Exact two_sum(double a, double b) {
    const double s = a + b, t = s - a;
    return {s, (a - (s - t)) + (b - t)};
}

/// a b, exactly (Dekker 1971).
inline Exact two_product(double a, double b) {
    const double p = a * b;
#ifdef FP_FAST_FMA
    return {p, std::fma(a, b, -p)};
#else
    const double s = 134217729.0 * a, t = 134217729.0 * b;
    const double a_high = s - (s - a), b_high = t - (t - b), a_low = a - a_high, b_low = b - b_high;
    return {p, a_low * b_low - (((p - a_high * b_high) - a_low * b_high) - a_high * b_low)};
#endif
}

/// a' b for three numbers each, as if computed with twice the digits: Omega may have entries 1e11 times its smallest
/// eigenvalue (INTEL). The error is at most u |a' b| + (3 u)² |a|' |b| (Ogita, Rump and Oishi, Accurate sum and dot product,
/// 2005).
inline double dot(double a0, double a1, double a2, double b0, double b1, double b2) {
    const Exact first = two_product(a0, b0), second = two_product(a1, b1), third = two_product(a2, b2);
    const Exact two = two_sum(first.value, second.value);
    const Exact three = two_sum(two.value, third.value);
    return three.value + (first.error + (second.error + two.error) + (third.error + three.error));
}

using Complex = std::complex<double>;

inline double square(Complex a) { return a.real() * a.real() + a.imag() * a.imag(); }
/// abs(a), without care for overflow; coordinates are at most 1e20.
inline double length(Complex a) { return std::sqrt(square(a)); }

}  // namespace vmslam::certificate
