// NumPy arrays as spans, and vectors as NumPy arrays.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <cstring>
#include <span>
#include <stdexcept>
#include <string_view>
#include <type_traits>
#include <vector>

namespace vmslam::python {

namespace nb = nanobind;

/// An array of any shape whose numbers lie one after another; they are written into unless T is constant.
///
/// An array of other numbers is converted, but whole numbers are never made of floating-point ones: NumPy would cut off their
/// decimals, and an id of 1.5 is an error instead. One that is written into is never converted: the copy would be lost.
template <class T>
struct Numbers : nb::ndarray<T, nb::c_contig, nb::device::cpu> {
    using nb::ndarray<T, nb::c_contig, nb::device::cpu>::ndarray;
};
template <class T>
using In = Numbers<const T>;
template <class T>
using InOut = Numbers<T>;
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

/// Of a binding during which other threads may use Python.
using release = nb::call_guard<nb::gil_scoped_release>;
/// What a call returns during which they may.
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
struct type_caster<vmslam::python::Numbers<T>> {
    using Array = ndarray<T, c_contig, device::cpu>;
    NB_TYPE_CASTER(vmslam::python::Numbers<T>, make_caster<Array>::Name)

    template <class Flags>  // their type depends on the version of nanobind
    bool from_python(handle source, Flags flags, cleanup_list* cleanup) noexcept {
        if (view(source)) return true;
        make_caster<ndarray<ro>> given;
        if (std::is_integral_v<T> && given.from_python(source, flags, cleanup) &&
            given.value.dtype().code == static_cast<std::uint8_t>(dlpack::dtype_code::Float))
            return false;
        make_caster<Array> numbers;
        // without the flag that allows conversion
        if (!numbers.from_python(source, written ? Flags{} : flags, cleanup)) return false;
        static_cast<Array&>(value) = std::move(numbers.value);
        return true;
    }

   private:
    static constexpr bool written = !std::is_const_v<T>;

    /// Take the numbers of an object that has these very numbers in a buffer; false for others. Nanobind asks NumPy for DLPack
    /// capsules, of which read-only arrays refuse the first one: 1.2 us in place of 0.4 us for one of whole numbers.
    bool view(handle source) noexcept {
        Py_buffer buffer;
        constexpr int wanted = PyBUF_C_CONTIGUOUS | PyBUF_FORMAT | (written ? PyBUF_WRITABLE : 0);
        if (!PyObject_CheckBuffer(source.ptr())) return false;
        if (PyObject_GetBuffer(source.ptr(), &buffer, wanted) != 0) {
            PyErr_Clear();
            return false;
        }
        std::size_t shape[4];
        const bool same = buffer.itemsize == sizeof(T) && buffer.format && has_format(buffer.format) && buffer.ndim <= 4;
        if (same) {
            std::copy_n(buffer.shape, buffer.ndim, shape);
            // it keeps the object, and NumPy does not resize what others refer to
            value = vmslam::python::Numbers<T>(static_cast<T*>(buffer.buf), buffer.ndim, shape, source);
        }
        PyBuffer_Release(&buffer);
        return same;
    }

    /// Whether a format of the module struct is that of T, apart from the size.
    static bool has_format(std::string_view format) {
        using Number = std::remove_const_t<T>;
        if constexpr (std::is_same_v<Number, bool>) return format == "?";
        if constexpr (std::is_integral_v<Number>) return format.size() == 1 && std::string_view("bhilq").find(format[0]) < 5;
        return format == (std::is_same_v<Number, double> ? "d" : "Zd");
    }
};

}  // namespace nanobind::detail
