// Eight numbers at a time: vectors of the compiler (GCC and Clang), which x86, ARM and WebAssembly all have.
//
// Functions of numbers are templates over Real, which is `double` or `Lanes`. Both have the arithmetic operators and
// comparisons; `select` takes the place of the conditional operator. A lane gets exactly the number that the function of
// `double` gives, as long as products and sums are not fused (-ffp-contract=off).
#pragma once

#include <bit>
#include <cmath>
#include <cstdint>
#include <type_traits>

#include "vmslam/processor.hpp"

namespace vmslam::numbers {

inline constexpr int lanes = 8;

/// Functions whose callers are loops over lanes: a call would pass vectors through memory.
#define VMSLAM_INLINE [[gnu::always_inline]] inline

typedef double Lanes __attribute__((vector_size(8 * lanes)));
typedef std::int64_t Integers __attribute__((vector_size(8 * lanes)));
typedef std::uint64_t Bits __attribute__((vector_size(8 * lanes)));

typedef double LanesInMemory __attribute__((vector_size(8 * lanes), aligned(8), may_alias));

inline Lanes load(const double* p) { return *reinterpret_cast<const LanesInMemory*>(p); }
inline void store(double* p, const Lanes& x) { *reinterpret_cast<LanesInMemory*>(p) = x; }
/// The numbers at some places.
inline Lanes gather(const double* p, const std::int32_t* places) {
    return Lanes{p[places[0]], p[places[1]], p[places[2]], p[places[3]],
                 p[places[4]], p[places[5]], p[places[6]], p[places[7]]};
}

/// The types of whole numbers and of bits that belong to a type of numbers.
template <class Real>
using IntegerOf = std::conditional_t<sizeof(Real) == sizeof(double), std::int64_t, Integers>;
template <class Real>
using BitsOf = std::conditional_t<sizeof(Real) == sizeof(double), std::uint64_t, Bits>;

/// A number in every lane.
template <class Real>
constexpr Real all(double x) {
    return Real{} + x;
}

inline double select(bool condition, double yes, double no) { return condition ? yes : no; }
inline Lanes select(const Integers& condition, const Lanes& yes, const Lanes& no) { return condition ? yes : no; }
inline Lanes select(const Integers& condition, double yes, const Lanes& no) { return condition ? yes + Lanes{} : no; }
inline Lanes select(const Integers& condition, const Lanes& yes, double no) { return condition ? yes : no + Lanes{}; }

/// Whether a condition holds in some lane.
inline bool any(const Integers& condition) {
    std::int64_t some = 0;
    for (int k = 0; k < lanes; ++k) some |= condition[k];
    return some != 0;
}

/// The larger and the smaller number; the first where they cannot be compared.
template <class Real>
Real larger(const Real& a, const Real& b) {
    return select(b > a, b, a);
}
template <class Real>
Real smaller(const Real& a, const Real& b) {
    return select(b < a, b, a);
}

inline double magnitude(double x) { return std::fabs(x); }
inline Lanes magnitude(const Lanes& x) {
    return std::bit_cast<Lanes>(std::bit_cast<Integers>(x) & std::int64_t{0x7FFFFFFFFFFFFFFF});
}

inline double root(double x) { return std::sqrt(x); }
inline Lanes root(const Lanes& x) {
    Lanes y;
    for (int k = 0; k < lanes; ++k) y[k] = std::sqrt(x[k]);
    return y;
}

/// Whole numbers below 2^53 as floating-point numbers.
inline double to_real(std::uint64_t whole) { return static_cast<double>(static_cast<std::int64_t>(whole)); }
inline Lanes to_real(const Bits& whole) { return __builtin_convertvector(std::bit_cast<Integers>(whole), Lanes); }

}  // namespace vmslam::numbers
