// Vectors of the compiler (GCC and Clang) for x86 and ARM, and memory that is aligned for them.
#pragma once

#include <algorithm>
#include <cstddef>
#include <new>
#include <span>
#include <utility>

#include "vmslam/processor.hpp"

namespace vmslam::sparse {

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

/// Memory for numbers that begins at a cache line; its content is undefined until it is written.
class Numbers {
   public:
    Numbers() = default;
    explicit Numbers(std::ptrdiff_t size)
        : data_(size > 0 ? static_cast<double*>(::operator new(size * sizeof(double), line)) : nullptr), size_(size) {}
    Numbers(const Numbers& other) : Numbers(other.size_) { std::copy_n(other.data_, size_, data_); }
    Numbers& operator=(const Numbers& other) { return *this = Numbers(other); }
    Numbers(Numbers&& other) noexcept : data_(std::exchange(other.data_, nullptr)), size_(std::exchange(other.size_, 0)) {}
    Numbers& operator=(Numbers&& other) noexcept {
        std::swap(data_, other.data_);
        std::swap(size_, other.size_);
        return *this;
    }
    ~Numbers() { ::operator delete(data_, line); }

    double* data() { return data_; }
    const double* data() const { return data_; }
    std::ptrdiff_t size() const { return size_; }

   private:
    static constexpr std::align_val_t line{64};
    double* data_ = nullptr;
    std::ptrdiff_t size_ = 0;
};

}  // namespace vmslam::sparse
