// NumPy arrays as spans, and vectors as NumPy arrays.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <span>
#include <vector>

namespace vmslam::python {

namespace nb = nanobind;

/// An array of any shape whose numbers lie one after another.
template <class T>
using In = nb::ndarray<const T, nb::c_contig, nb::device::cpu>;
template <class T>
using InOut = nb::ndarray<T, nb::c_contig, nb::device::cpu>;
template <class T>
using Out = nb::ndarray<nb::numpy, T>;

template <class T>
std::span<const T> span(const In<T>& array) {
    return {array.data(), array.size()};
}
template <class T>
std::span<T> span(const InOut<T>& array) {
    return {array.data(), array.size()};
}

/// An array that takes over the memory of a vector.
template <class T>
Out<T> array(std::vector<T> values, std::initializer_list<std::size_t> shape) {
    auto* const owned = new std::vector<T>(std::move(values));
    const nb::capsule owner(owned, [](void* p) noexcept { delete static_cast<std::vector<T>*>(p); });
    return Out<T>(owned->data(), shape, owner);
}
template <class T>
Out<T> array(std::vector<T> values) {
    const std::size_t size = values.size();
    return array(std::move(values), {size});
}

}  // namespace vmslam::python
