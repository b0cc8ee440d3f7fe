// NumPy arrays as spans, and vectors as NumPy arrays.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <span>
#include <type_traits>
#include <vector>

namespace vmslam::python {

namespace nb = nanobind;

template <class T>
using AnyNumbers = nb::ndarray<const T, nb::c_contig, nb::device::cpu>;

/// An array of whole numbers. NumPy would cut the decimals off floating-point numbers; an id of 1.5 is an error instead.
template <class T>
struct WholeNumbers : AnyNumbers<T> {};

/// An array of any shape whose numbers lie one after another.
template <class T>
using In = std::conditional_t<std::is_integral_v<T>, WholeNumbers<T>, AnyNumbers<T>>;
template <class T>
using InOut = nb::ndarray<T, nb::c_contig, nb::device::cpu>;
template <class T>
using Out = nb::ndarray<nb::numpy, T>;

/// The numbers of an `In` or `InOut`.
template <class Array>
auto span(const Array& array) {
    return std::span(array.data(), array.size());
}
/// A copy of the numbers, which other threads of Python cannot change.
template <class Array>
auto copy_of(const Array& array) {
    return std::vector(array.data(), array.data() + array.size());
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

namespace nanobind::detail {

template <class T>
struct type_caster<vmslam::python::WholeNumbers<T>> {
    using Numbers = make_caster<vmslam::python::AnyNumbers<T>>;
    NB_TYPE_CASTER(vmslam::python::WholeNumbers<T>, Numbers::Name)

    template <class Flags>  // their type depends on the version of nanobind
    bool from_python(handle source, Flags flags, cleanup_list* cleanup) noexcept {
        make_caster<ndarray<ro>> given;
        if (given.from_python(source, flags, cleanup) &&
            given.value.dtype().code == static_cast<std::uint8_t>(dlpack::dtype_code::Float))
            return false;
        Numbers numbers;
        if (!numbers.from_python(source, flags, cleanup)) return false;
        static_cast<vmslam::python::AnyNumbers<T>&>(value) = std::move(numbers.value);
        return true;
    }
};

}  // namespace nanobind::detail
