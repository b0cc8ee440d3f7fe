// Vectors of the compiler (GCC and Clang) for x86 and ARM, and memory that is aligned for them.
#pragma once

#include <cstddef>
#include <cstdint>
#include <new>
#include <vector>

#include "vmslam/processor.hpp"

namespace vmslam::sparse {

using Step = std::int64_t;
inline constexpr int lanes = VMSLAM_REGISTER;

/// `N` numbers in a register, and the same numbers anywhere in memory.
template <int N>
struct VectorTypes {
    typedef double Register __attribute__((vector_size(8 * N)));
    typedef double Memory __attribute__((vector_size(8 * N), aligned(8), may_alias));
};
template <int N>
using Vector = typename VectorTypes<N>::Register;

template <int N>
inline Vector<N> load(const double* p) {
    return *reinterpret_cast<const typename VectorTypes<N>::Memory*>(p);
}
template <int N>
inline void store(double* p, Vector<N> v) {
    *reinterpret_cast<typename VectorTypes<N>::Memory*>(p) = v;
}

/// Sum of the numbers of a vector, always in the same order.
template <int N>
inline double sum(Vector<N> v) {
    double half[N];
    for (int k = 0; k < N; ++k) half[k] = v[k];
    for (int n = N / 2; n > 0; n /= 2)
        for (int k = 0; k < n; ++k) half[k] += half[k + n];
    return half[0];
}

/// Whether all of some numbers are finite.
inline bool all_finite(const double* p, std::ptrdiff_t count) {
    Vector<lanes> zero{};  // NaN for what is not finite
    std::ptrdiff_t i = 0;
    for (; i + lanes <= count; i += lanes) zero += 0.0 * load<lanes>(p + i);
    double rest = sum<lanes>(zero);
    for (; i < count; ++i) rest += 0.0 * p[i];
    return rest == 0.0;
}

/// Allocates at cache lines, and leaves numbers undefined until they are written.
template <class T>
struct AtCacheLines {
    using value_type = T;
    static constexpr std::align_val_t line{64};

    T* allocate(std::size_t count) { return static_cast<T*>(::operator new(count * sizeof(T), line)); }
    void deallocate(T* at, std::size_t) { ::operator delete(at, line); }
    void construct(T*) {}
    void construct(T* at, const T& value) { *at = value; }
    bool operator==(const AtCacheLines&) const = default;
};
using Numbers = std::vector<double, AtCacheLines<double>>;

}  // namespace vmslam::sparse
