// The blocks that the factorisation is made for: real 3 x 3 and 2 x 2, and complex 2 x 2 of a Hermitian matrix. Points, which
// have no heading, have a number less in blocks of poses.
//
// A complex column is stored as two real ones, its real part first. With a = a' + i a'' and b = b' + i b'' a product with the
// adjoint, a conj(b) = (a' b' + a'' b'') + i (a'' b' - a' b''), is a real product of those columns with a right factor that
// holds (b', b'') and (-b'', b').
#pragma once

#include <cmath>
#include <complex>

#include "vmslam/sparse/product.hpp"
#include "vmslam/sparse/symbolic.hpp"

namespace vmslam::sparse {

/// Blocks of an information matrix of planar poses.
struct Real3 {
    using Value = double;
    static constexpr int rows = 3, columns = 3, planes = 1;
    static constexpr int point_rows = 2, point_first = 0;  ///< of a point, the place is left
    static constexpr int size = 9;  ///< values of a block, by rows
    static constexpr double tolerance = 1e-12;  ///< smallest ratio of a pivot to its diagonal entry, see factor.hpp

    /// L of a diagonal block, with inverse pivots.
    struct Pivot {
        double i0, l10, l20, i1, l21, i2;

        static Pivot load(const double* d, Step h) { return {d[0], d[1], d[2], d[h + 1], d[h + 2], d[2 * h + 2]}; }
        void store(double* d, Step h) const {
            d[0] = i0, d[1] = l10, d[2] = l20;
            d[h] = 0.0, d[h + 1] = i1, d[h + 2] = l21;
            d[2 * h] = d[2 * h + 1] = 0.0, d[2 * h + 2] = i2;
        }
    };

    /// A block of the matrix at its place in a panel.
    static void put(double* t, Step h, const double* v, bool transposed) {
        // steps instead of a branch, which cannot be predicted
        const int down = transposed ? 1 : 3, across = 4 - down;
#pragma GCC unroll 3
        for (int c = 0; c < 3; ++c)
#pragma GCC unroll 3
            for (int i = 0; i < 3; ++i) t[c * h + i] = v[i * down + c * across];
    }

    /// L L' of a diagonal block; the first component whose pivot is not above its limit, or -1.
    static int factorize(const double* d, Step h, const double* limits, Pivot& p) {
        // L D L' first: divisions, not square roots, on the critical path
        const double a00 = d[0], a10 = d[1], a20 = d[2];
        double a11 = d[h + 1], a21 = d[h + 2], a22 = d[2 * h + 2];
        const double r0 = 1.0 / a00, m10 = a10 * r0, m20 = a20 * r0;
        a11 -= m10 * a10;
        a21 -= m20 * a10;
        const double r1 = 1.0 / a11, m21 = a21 * r1;
        a22 -= m20 * a20 + m21 * a21;
        p.i0 = std::sqrt(r0);
        p.i1 = std::sqrt(r1);
        p.i2 = std::sqrt(1.0 / a22);
        p.l10 = a10 * p.i0;
        p.l20 = a20 * p.i0;
        p.l21 = a21 * p.i1;
        if (a00 > limits[0] && a11 > limits[1] && a22 > limits[2]) [[likely]]
            return -1;
        return !(a00 > limits[0]) ? 0 : !(a11 > limits[1]) ? 1 : 2;
    }

    /// X L' = B in place for the rows of one node column, a multiple of 8.
    static void solve_rows(double* x, Step h, Step count, const Pivot& p) {
        double *x0 = x, *x1 = x + h, *x2 = x + 2 * h;
        for (Step i = 0; i < count; i += lanes) {
            const Vector<lanes> a = load<lanes>(x0 + i) * p.i0;
            const Vector<lanes> b = (load<lanes>(x1 + i) - a * p.l10) * p.i1;
            const Vector<lanes> c = (load<lanes>(x2 + i) - a * p.l20 - b * p.l21) * p.i2;
            store<lanes>(x0 + i, a);
            store<lanes>(x1 + i, b);
            store<lanes>(x2 + i, c);
        }
    }

    // --- vectors of one right-hand side: `count` rows beside the columns of a node, and the node's own numbers

    struct Part {
        double v[3];
    };
    static Part forward(const double* b, Step, const Pivot& p) {
        const double y0 = b[0] * p.i0, y1 = (b[1] - p.l10 * y0) * p.i1;
        return {y0, y1, (b[2] - p.l20 * y0 - p.l21 * y1) * p.i2};
    }
    static Part backward(const Part& b, const Pivot& p) {
        const double y2 = b.v[2] * p.i2, y1 = (b.v[1] - p.l21 * y2) * p.i1;
        return {(b.v[0] - p.l10 * y1 - p.l20 * y2) * p.i0, y1, y2};
    }
    /// y -= X a
    static void subtract(double* y, Step, const double* x, Step h, Step count, const Part& a) {
        for (Step i = 0; i < count; i += lanes)
            store<lanes>(y + i, load<lanes>(y + i) - load<lanes>(x + i) * a.v[0] - load<lanes>(x + h + i) * a.v[1] -
                                    load<lanes>(x + 2 * h + i) * a.v[2]);
    }
    /// b - X' y
    static Part minus_dot(Part b, const double* y, Step, const double* x, Step h, Step count) {
        Vector<lanes> s0{}, s1{}, s2{};
        for (Step i = 0; i < count; i += lanes) {
            const Vector<lanes> v = load<lanes>(y + i);
            s0 += v * load<lanes>(x + i);
            s1 += v * load<lanes>(x + h + i);
            s2 += v * load<lanes>(x + 2 * h + i);
        }
        return {b.v[0] - sum<lanes>(s0), b.v[1] - sum<lanes>(s1), b.v[2] - sum<lanes>(s2)};
    }
};

/// Blocks of initial values: directions or positions of nodes.
struct Real2 {
    using Value = double;
    static constexpr int rows = 2, columns = 2, planes = 1;
    static constexpr int point_rows = 2, point_first = 0;  ///< points are as other nodes
    static constexpr int size = 4;
    static constexpr double tolerance = Real3::tolerance;

    struct Pivot {
        double i0, l10, i1;

        static Pivot load(const double* d, Step h) { return {d[0], d[1], d[h + 1]}; }
        void store(double* d, Step h) const {
            d[0] = i0, d[1] = l10;
            d[h] = 0.0, d[h + 1] = i1;
        }
    };

    static void put(double* t, Step h, const double* v, bool transposed) {
        const int down = transposed ? 1 : 2, across = 3 - down;
        t[0] = v[0], t[1] = v[down];
        t[h] = v[across], t[h + 1] = v[3];
    }

    static int factorize(const double* d, Step h, const double* limits, Pivot& p) {
        p.i0 = 1.0 / std::sqrt(d[0]);
        p.l10 = d[1] * p.i0;
        const double rest = d[h + 1] - p.l10 * p.l10;
        p.i1 = 1.0 / std::sqrt(rest);
        return !(d[0] > limits[0]) ? 0 : !(rest > limits[1]) ? 1 : -1;
    }

    /// X L' = B
    static void solve_rows(double* x, Step h, Step count, const Pivot& p) {
        for (Step i = 0; i < count; i += lanes, x += lanes) {
            const Vector<lanes> a = load<lanes>(x) * p.i0;
            store<lanes>(x, a);
            store<lanes>(x + h, (load<lanes>(x + h) - a * p.l10) * p.i1);
        }
    }

    struct Part {
        double v[2];
    };
    static Part forward(const double* b, Step, const Pivot& p) {
        const double y0 = b[0] * p.i0;
        return {y0, (b[1] - p.l10 * y0) * p.i1};
    }
    static Part backward(const Part& b, const Pivot& p) {
        const double y1 = b.v[1] * p.i1;
        return {(b.v[0] - p.l10 * y1) * p.i0, y1};
    }
    /// y -= X a
    static void subtract(double* y, Step, const double* x, Step h, Step count, const Part& a) {
        for (Step i = 0; i < count; i += lanes)
            store<lanes>(y + i, load<lanes>(y + i) - load<lanes>(x + i) * a.v[0] - load<lanes>(x + h + i) * a.v[1]);
    }
    /// b - X' y
    static Part minus_dot(Part b, const double* y, Step, const double* x, Step h, Step count) {
        Vector<lanes> s0{}, s1{};
        for (Step i = 0; i < count; i += lanes) {
            const Vector<lanes> v = load<lanes>(y + i);
            s0 += v * load<lanes>(x + i);
            s1 += v * load<lanes>(x + h + i);
        }
        return {b.v[0] - sum<lanes>(s0), b.v[1] - sum<lanes>(s1)};
    }
};

/// Blocks of the certificate: headings and positions as complex numbers.
struct Hermitian2 {
    using Value = std::complex<double>;
    static constexpr int rows = 2, columns = 4, planes = 2;
    static constexpr int point_rows = 1, point_first = 1;  ///< of a point, the place is left
    static constexpr int size = 4;
    static constexpr double tolerance = 0.0;  ///< any positive pivot will do

    struct Pivot {
        double i0, re, im, i1;  // l10 = re + i im

        static Pivot load(const double* d, Step h) { return {d[0], d[1], d[h + 1], d[2 * h + 1]}; }
        void store(double* d, Step h) const {
            d[0] = i0, d[1] = re;
            d[h] = 0.0, d[h + 1] = im;
            d[2 * h] = 0.0, d[2 * h + 1] = i1;
            d[3 * h] = d[3 * h + 1] = 0.0;
        }
    };

    static void put(double* t, Step h, const std::complex<double>* v, bool transposed) {
        for (int c = 0; c < 2; ++c)
            for (int i = 0; i < 2; ++i) {
                const std::complex<double> a = transposed ? std::conj(v[2 * c + i]) : v[2 * i + c];
                t[2 * c * h + i] = a.real();
                t[(2 * c + 1) * h + i] = a.imag();
            }
    }

    static int factorize(const double* d, Step h, const double* limits, Pivot& p) {
        p.i0 = 1.0 / std::sqrt(d[0]);
        p.re = d[1] * p.i0;
        p.im = d[h + 1] * p.i0;
        const double rest = d[2 * h + 1] - (p.re * p.re + p.im * p.im);
        p.i1 = 1.0 / std::sqrt(rest);
        return !(d[0] > limits[0]) ? 0 : !(rest > limits[1]) ? 1 : -1;
    }

    /// X L^H = B
    static void solve_rows(double* x, Step h, Step count, const Pivot& p) {
        for (Step i = 0; i < count; i += lanes, x += lanes) {
            const Vector<lanes> re = load<lanes>(x) * p.i0, im = load<lanes>(x + h) * p.i0;
            store<lanes>(x, re);
            store<lanes>(x + h, im);
            store<lanes>(x + 2 * h, (load<lanes>(x + 2 * h) - re * p.re - im * p.im) * p.i1);
            store<lanes>(x + 3 * h, (load<lanes>(x + 3 * h) - im * p.re + re * p.im) * p.i1);
        }
    }

    // --- vectors: the real parts, and the imaginary ones `plane` further on

    struct Part {
        std::complex<double> v[2];
    };
    static Part forward(const double* b, Step plane, const Pivot& p) {
        const std::complex<double> y0 = std::complex(b[0], b[plane]) * p.i0;
        return {y0, (std::complex(b[1], b[plane + 1]) - times({p.re, p.im}, y0)) * p.i1};
    }
    static Part backward(const Part& b, const Pivot& p) {
        const std::complex<double> y1 = b.v[1] * p.i1;
        return {(b.v[0] - times({p.re, -p.im}, y1)) * p.i0, y1};
    }
    /// y -= X a
    static void subtract(double* y, Step plane, const double* x, Step h, Step count, const Part& a) {
        const double r0 = a.v[0].real(), m0 = a.v[0].imag(), r1 = a.v[1].real(), m1 = a.v[1].imag();
        for (Step i = 0; i < count; i += lanes, x += lanes, y += lanes) {
            const Vector<lanes> x0 = load<lanes>(x), z0 = load<lanes>(x + h), x1 = load<lanes>(x + 2 * h),
                                z1 = load<lanes>(x + 3 * h);
            store<lanes>(y, load<lanes>(y) - x0 * r0 + z0 * m0 - x1 * r1 + z1 * m1);
            store<lanes>(y + plane, load<lanes>(y + plane) - x0 * m0 - z0 * r0 - x1 * m1 - z1 * r1);
        }
    }
    /// b - X^H y
    static Part minus_dot(Part b, const double* y, Step plane, const double* x, Step h, Step count) {
        Vector<lanes> re[2] = {}, im[2] = {};
        for (Step i = 0; i < count; i += lanes, x += lanes, y += lanes) {
            const Vector<lanes> v = load<lanes>(y), w = load<lanes>(y + plane);
            for (int c = 0; c < 2; ++c) {
                const Vector<lanes> a = load<lanes>(x + 2 * c * h), z = load<lanes>(x + (2 * c + 1) * h);
                re[c] += v * a + w * z;
                im[c] += w * a - v * z;
            }
        }
        return {b.v[0] - std::complex(sum<lanes>(re[0]), sum<lanes>(im[0])),
                b.v[1] - std::complex(sum<lanes>(re[1]), sum<lanes>(im[1]))};
    }

   private:
    // the operator of std::complex looks after infinities, which costs a call
    static std::complex<double> times(std::complex<double> a, std::complex<double> b) {
        return {a.real() * b.real() - a.imag() * b.imag(), a.real() * b.imag() + a.imag() * b.real()};
    }
};

template <class Block>
inline constexpr BlockShape shape_of{Block::rows, Block::columns, Block::point_rows, Block::point_first};

inline double conjugate(double a) { return a; }
inline std::complex<double> conjugate(std::complex<double> a) { return std::conj(a); }

/// A number at its place, the imaginary part a `plane` further on.
inline void put_value(double* b, Step, double value) { *b = value; }
inline void put_value(double* b, Step plane, std::complex<double> value) { b[0] = value.real(), b[plane] = value.imag(); }

/// A block of the matrix at its place in a panel, of which the row, the column or both are those of points.
template <class Block>
void put_of_points(double* t, Step h, const typename Block::Value* v, const Entry& entry) {
    constexpr int R = Block::rows, point = Block::point_rows, first = Block::point_first;
    const int height = entry.row_point() ? point : R, from = entry.row_point() ? first : 0;
    const int width = entry.column_point() ? point : R, left = entry.column_point() ? first : 0;
    for (int c = 0; c < width; ++c)
        for (int i = 0; i < height; ++i) {
            const int row = from + i, column = left + c;
            put_value(t + Block::planes * c * h + i, h,
                      entry.transposed() ? conjugate(v[R * column + row]) : v[R * row + column]);
        }
}

}  // namespace vmslam::sparse
