// Elementary functions without branches, which the compiler can inline and compute in all lanes at once.
//
// The C library computes sin, cos, atan2 and log one number at a time, and differently on different machines. The functions
// here contain only arithmetic and selections; their errors are below 1e-15. Their domain is smaller: finite numbers, angles
// up to 1e6 rad, and logarithms of normal positive numbers.
//
// The coefficients of the polynomials are those of Sun Microsystems' fdlibm (k_sin.c, k_cos.c, s_atan.c, e_log.c, e_exp.c).
// The argument reductions are our own.
#pragma once

#include <numbers>

#include "vmslam/numbers/lanes.hpp"

namespace vmslam::numbers {

inline constexpr double pi = std::numbers::pi;

/// Adding this to a number below 2^51 rounds away its fractional part, which is then a whole number in the lowest bits.
inline constexpr double rounding = 1.5 * 4503599627370496.0;
/// pi / 2 and log 2, each in two parts
inline constexpr double quarter_high = 1.57079632673412561417, quarter_low = 6.07710050650619224932e-11;
inline constexpr double ln2_high = 6.93147180369123816490e-01, ln2_low = 1.90821492927058770002e-10;

/// c[0] + x c[1] + x² c[2] + ...
template <class Real>
VMSLAM_INLINE Real polynomial(const Real&, double c) {
    return all<Real>(c);
}
template <class Real, class... Rest>
VMSLAM_INLINE Real polynomial(const Real& x, double c, double next, Rest... rest) {
    return c + x * polynomial(x, next, rest...);
}

/// x rounded to the nearest whole number.
template <class Real>
VMSLAM_INLINE Real nearest(const Real& x) {
    return (x + rounding) - rounding;
}

/// The same angle in [-pi, pi) [rad]; an angle that is already there is returned unchanged.
template <class Real>
VMSLAM_INLINE Real wrap_angle(const Real& angle) {
    Real wrapped = angle - 2 * pi * nearest(Real(angle * (0.5 / pi)));
    // rounding may leave the result just outside the interval
    wrapped = select(wrapped < -pi, Real(wrapped + 2 * pi), wrapped);
    wrapped = select(wrapped >= pi, -pi, wrapped);
    return select((angle >= -pi) & (angle < pi), angle, wrapped);
}

template <class Real>
struct SineCosine {
    Real sine, cosine;
};

template <class Real>
VMSLAM_INLINE SineCosine<Real> sincos(const Real& x) {
    const Real k = nearest(Real(x * (2 / pi)));
    const Real r = (x - k * quarter_high) - k * quarter_low;
    const Real quadrant = k - 4 * nearest(Real(k * 0.25));  // -2 to 2
    const Real q = r * r;
    const Real s = r + r * q *
                           polynomial(q, -1.66666666666666324348e-01, 8.33333333332248946124e-03, -1.98412698298579493134e-04,
                                      2.75573137070700676789e-06, -2.50507602534068634195e-08, 1.58969099521155010221e-10);
    const Real c = 1.0 - 0.5 * q +
                   q * q *
                       polynomial(q, 4.16666666666666019037e-02, -1.38888888888741095749e-03, 2.48015872894767294178e-05,
                                  -2.75573143513906633035e-07, 2.08757232129817482790e-09, -1.13596475577881948265e-11);
    const auto odd = magnitude(quadrant) == 1.0, opposite = magnitude(quadrant) == 2.0;
    const Real sine = select(odd, c, s), cosine = select(odd, s, c);
    return {select(opposite | (quadrant == -1.0), Real(-sine), sine),
            select(opposite | (quadrant == 1.0), Real(-cosine), cosine)};
}

/// The direction of the vector (x, y) [rad]; NaN at the origin.
template <class Real>
VMSLAM_INLINE Real atan2(const Real& y, const Real& x) {
    constexpr double tan_eighth = 0.41421356237309503;  // tan(pi / 8)
    const Real across = smaller(magnitude(x), magnitude(y)), along = larger(magnitude(x), magnitude(y));
    // beyond pi/8 the angle is measured from the diagonal, so that one division is enough
    const auto steep = across > tan_eighth * along;
    const Real t = select(steep, Real(across - along), across) / select(steep, Real(across + along), along);
    const Real q = t * t;
    const Real p = polynomial(q, 3.33333333333329318027e-01, -1.99999999998764832476e-01, 1.42857142725034663711e-01,
                              -1.11111104054623557880e-01, 9.09088713343650656196e-02, -7.69187620504482999495e-02,
                              6.66107313738753120669e-02, -5.83357013379057348645e-02, 4.97687799461593236017e-02,
                              -3.65315727442169155270e-02, 1.62858201153657823623e-02);
    Real angle = t - t * q * p;
    angle = select(steep, Real(pi / 4 + angle), angle);
    angle = select(magnitude(y) > magnitude(x), Real(pi / 2 - angle), angle);
    angle = select(x < 0.0, Real(pi - angle), angle);
    return select(y < 0.0, Real(-angle), angle);
}

/// The natural logarithm of a normal positive number; for other arguments the result is meaningless but finite.
template <class Real>
VMSLAM_INLINE Real log(const Real& x) {
    using Integer = IntegerOf<Real>;
    using Bits = BitsOf<Real>;
    constexpr std::int64_t sqrt_half = 0x3FE6A09E667F3BCD;
    // differences and shifts of unsigned numbers, which may wrap
    const Bits bits = std::bit_cast<Bits>(x);
    const Integer exponent = Integer(Bits(bits - static_cast<std::uint64_t>(sqrt_half))) >> 52;
    const Real f = std::bit_cast<Real>(Bits(bits - (Bits(exponent) << 52))) - 1.0;  // x = 2^exponent (1 + f), 1 + f near 1
    const Real s = f / (2.0 + f), q = s * s;
    const Real p = q * polynomial(q, 6.666666666666735130e-01, 3.999999999940941908e-01, 2.857142874366239149e-01,
                                  2.222219843214978396e-01, 1.818357216161805012e-01, 1.531383769920937332e-01,
                                  1.479819860511658591e-01);
    // the exponent as a floating-point number
    const Real k = std::bit_cast<Real>(Integer(exponent + std::bit_cast<std::int64_t>(rounding))) - rounding;
    const Real half = 0.5 * f * f;
    return k * ln2_high + (f - (half - (s * (half + p) + k * ln2_low)));
}

/// e to the power of x; 0 for x below -708.
template <class Real>
VMSLAM_INLINE Real exp(const Real& x) {
    using Integer = IntegerOf<Real>;
    const Real least = larger(x, all<Real>(-708.0));
    const Real k = nearest(Real(least * 1.4426950408889634));
    const Real r = (least - k * ln2_high) - k * ln2_low;
    const Real q = r * r;
    const Real p = r - q * polynomial(q, 1.66666666666666019037e-01, -2.77777777770155933842e-03, 6.61375632143793436117e-05,
                                      -1.65339022054652515390e-06, 4.13813679705723846039e-08);
    const Real y = 1.0 + (r + r * p / (2.0 - p));
    const Real scale = std::bit_cast<Real>(Integer((std::bit_cast<Integer>(Real(k + rounding)) + 1023) << 52));
    return select(x >= -708.0, Real(y * scale), 0.0);
}

}  // namespace vmslam::numbers
