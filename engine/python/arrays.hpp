// NumPy arrays as spans, and vectors as NumPy arrays.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstring>
#include <functional>
#include <span>
#include <stdexcept>
#include <type_traits>
#include <vector>

namespace vmslam::python {

namespace nb = nanobind;

template <class T>
using AnyNumbers = nb::ndarray<const T, nb::c_contig, nb::device::cpu>;

/// An array of whole numbers. NumPy would cut the decimals off floating-point numbers; an id of 1.5 is an error instead.
template <class T>
struct WholeNumbers : AnyNumbers<T> {};

/// An array that is written into. One of another type, or with gaps between its numbers, is an error: nanobind would fill a
/// copy, which is lost.
template <class T>
struct WrittenNumbers : nb::ndarray<T, nb::c_contig, nb::device::cpu> {};

/// An array of any shape whose numbers lie one after another.
template <class T>
using In = std::conditional_t<std::is_integral_v<T>, WholeNumbers<T>, AnyNumbers<T>>;
template <class T>
using InOut = WrittenNumbers<T>;
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

/// What a call returns, during which other threads may use Python.
template <class Call>
auto released(Call call) {
    const nb::gil_scoped_release others;
    return call();
}

inline void require(bool holds, const char* what) {
    if (!holds) throw std::invalid_argument(what);
}

/// Whether an array has this shape.
template <class Array>
bool has_shape(const Array& array, std::initializer_list<std::size_t> shape) {
    if (array.ndim() != shape.size()) return false;
    std::size_t axis = 0;
    for (const std::size_t size : shape)
        if (array.shape(axis++) != size) return false;
    return true;
}

/// A record whose numbers are those of a row.
template <class Record>
inline constexpr std::size_t width = sizeof(Record) / sizeof(double);

/// Rows of numbers as records of as many numbers, such as vectors.
template <class Record>
std::vector<Record> records(const In<double>& rows, std::size_t count) {
    static_assert(std::is_trivially_copyable_v<Record> && sizeof(Record) % sizeof(double) == 0);
    require(rows.size() == width<Record> * count, "an array has the wrong number of rows");
    std::vector<Record> out(count);
    if (count > 0) std::memcpy(out.data(), rows.data(), count * sizeof(Record));
    return out;
}
/// Rows of two or three numbers as records of three, the last one `rest` where there are two.
template <class Record>
std::vector<Record> filled(const In<double>& rows, double rest = 0.0) {
    require(rows.ndim() == 2 && (rows.shape(1) == 2 || rows.shape(1) == 3), "rows have two or three numbers");
    std::vector<Record> out(rows.shape(0));
    const std::size_t d = rows.shape(1);
    for (std::size_t k = 0; k < out.size(); ++k) {
        const double* const at = rows.data() + k * d;
        out[k] = {at[0], at[1], d == 3 ? at[2] : rest};
    }
    return out;
}

/// An array that takes over the memory of a vector; numbers of another type with the same bytes where `As` is given.
template <class As = void, class T>
auto array(std::vector<T> values, std::initializer_list<std::size_t> shape) {
    using Number = std::conditional_t<std::is_void_v<As>, T, As>;
    auto* const owned = new std::vector<T>(std::move(values));
    const nb::capsule owner(owned, [](void* p) noexcept { delete static_cast<std::vector<T>*>(p); });
    return Out<Number>(reinterpret_cast<Number*>(owned->data()), shape, owner);
}
template <class T>
Out<T> array(std::vector<T> values) {
    const std::size_t size = values.size();
    return array(std::move(values), {size});
}

/// The numbers of a member of some records, (n, k) or (n,).
template <class Record, class Member>
auto rows_of(const std::vector<Record>& records, Member Record::* member) {
    using Number = std::conditional_t<std::is_integral_v<Member>, Member, double>;
    std::vector<Number> out(width<Member> * records.size());
    for (std::size_t k = 0; k < records.size(); ++k)
        std::memcpy(out.data() + k * width<Member>, &(records[k].*member), sizeof(Member));
    if constexpr (width<Member> == 1)
        return array(std::move(out));
    else
        return array(std::move(out), {records.size(), width<Member>});
}
/// The numbers of some records, (n, k).
template <class Record>
Out<double> rows_of(const std::vector<Record>& records) {
    return array<double>(records, {records.size(), width<Record>});
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

template <class T>
struct type_caster<vmslam::python::WrittenNumbers<T>> {
    using Numbers = make_caster<ndarray<T, c_contig, device::cpu>>;
    NB_TYPE_CASTER(vmslam::python::WrittenNumbers<T>, Numbers::Name)

    template <class Flags>
    bool from_python(handle source, Flags, cleanup_list* cleanup) noexcept {
        Numbers numbers;
        // without the flag that allows conversion
        if (!numbers.from_python(source, Flags{}, cleanup)) return false;
        static_cast<ndarray<T, c_contig, device::cpu>&>(value) = std::move(numbers.value);
        return true;
    }
};

}  // namespace nanobind::detail
