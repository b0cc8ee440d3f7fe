// Random numbers that are a function of a key and an index, so that threads need no common generator. A seed gives the same
// numbers on every machine.
//
// The filter's generator draws one key per motion. Each of the N particles then has numbers of its own, which depend only on
// the key and on the particle's index. The bits are those of SplitMix64 (Steele, Lea and Flood, Fast splittable pseudorandom
// number generators, OOPSLA 2014) started at the key; Box and Muller (1958) make them Gaussian.
#pragma once

#include "vmslam/numbers/elementary.hpp"

namespace vmslam::numbers {

/// Pairs of standard normal numbers per particle and motion; the last of the six numbers is not used.
inline constexpr std::uint64_t pairs = 3;

/// The uniform number of an index, in [0, 1).
template <class Bits>
VMSLAM_INLINE auto uniform(std::uint64_t key, const Bits& index) {
    Bits bits = key + (index + std::uint64_t{1}) * std::uint64_t{0x9E3779B97F4A7C15};
    bits = (bits ^ (bits >> 30)) * std::uint64_t{0xBF58476D1CE4E5B9};
    bits = (bits ^ (bits >> 27)) * std::uint64_t{0x94D049BB133111EB};
    bits = bits ^ (bits >> 31);
    return to_real(Bits(bits >> 11)) * 0x1p-53;
}

template <class Real>
struct Pair {
    Real first, second;
};

/// Two independent standard normal numbers: the pair with a number.
template <class Real>
VMSLAM_INLINE Pair<Real> normal_pair(std::uint64_t key, const BitsOf<Real>& number) {
    using Bits = BitsOf<Real>;
    const Bits index = std::uint64_t{2} * number;
    // u lies in (0, 1], as the logarithm needs; the other uniform number lies in [0, 1)
    const Real u = 1.0 - uniform(key, index);
    const auto [sine, cosine] = sincos(Real(2 * pi * uniform(key, Bits(index + std::uint64_t{1})) - pi));
    const Real radius = root(Real(-2.0 * log(u)));
    return {radius * cosine, radius * sine};
}

/// Pair 0, 1 or 2 of a particle.
template <class Real>
VMSLAM_INLINE Pair<Real> normal_pair(std::uint64_t key, const BitsOf<Real>& particle, std::uint64_t pair) {
    return normal_pair<Real>(key, BitsOf<Real>(pairs * particle + pair));
}

template <class Real>
struct FiveNormals {
    Real n0, n1, n2, n3, n4;
};

/// The five standard normal numbers of a particle; what is not used is not computed.
template <class Real>
VMSLAM_INLINE FiveNormals<Real> five_normals(std::uint64_t key, const BitsOf<Real>& particle) {
    const auto [n0, n1] = normal_pair<Real>(key, particle, 0);
    const auto [n2, n3] = normal_pair<Real>(key, particle, 1);
    return {n0, n1, n2, n3, normal_pair<Real>(key, particle, 2).first};
}

}  // namespace vmslam::numbers
