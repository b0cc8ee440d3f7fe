// The blocks that the factorisation is made for: real 3 x 3 and 2 x 2, and complex 2 x 2 of a Hermitian matrix. Points, which
// have no heading, have a number less in blocks of poses.
//
// A complex column is stored as two real ones, its real part first. With a = a' + i a'' and b = b' + i b'' a product with the
// adjoint, a conj(b) = (a' b' + a'' b'') + i (a'' b' - a' b''), is a real product of those columns with a right factor that
// holds (b', b'') and (-b'', b').
#pragma once

#include <cmath>
#include <complex>

#include "vmslam/sparse/simd.hpp"
#include "vmslam/sparse/symbolic.hpp"

namespace vmslam::sparse {

/// Real blocks: those of an information matrix of planar poses (N = 3), and of initial values, which are directions or positions
/// of nodes (N = 2).
template <int N>
struct Real {
    using Value = double;
    static constexpr int rows = N, columns = N, planes = 1;
    static constexpr int point_rows = 2, point_first = 0;  ///< of a point, the place is left
    static constexpr int size = N * N;  ///< values of a block, by rows
    static constexpr double tolerance = 1e-12;  ///< smallest ratio of a pivot to its diagonal entry, see factor.hpp

    /// L of a diagonal block, with inverse pivots.
    struct Pivot {
        double l[N][N];

        static Pivot load(const double* d, Step h) {
            Pivot p;
            for (int c = 0; c < N; ++c)
                for (int i = c; i < N; ++i) p.l[i][c] = d[c * h + i];
            return p;
        }
        void store(double* d, Step h) const {
            for (int c = 0; c < N; ++c)
                for (int i = 0; i < N; ++i) d[c * h + i] = i < c ? 0.0 : l[i][c];
        }
    };

    /// A block of the matrix at its place in a panel.
    static void put(double* t, Step h, const double* v, bool transposed) {
        // steps instead of a branch, which cannot be predicted
        const int down = transposed ? 1 : N, across = N + 1 - down;
#pragma GCC unroll 3
        for (int c = 0; c < N; ++c)
#pragma GCC unroll 3
            for (int i = 0; i < N; ++i) t[c * h + i] = v[i * down + c * across];
    }

    /// L L' of a diagonal block; the first component whose pivot is not above its limit, or -1.
    static int factorize(const double* d, Step h, const double* limits, Pivot& p) {
        // L D L' first: divisions, not square roots, on the critical path
        double a[N][N], m[N][N];
        int bad = -1;
#pragma GCC unroll 3
        for (int k = 0; k < N; ++k) {
#pragma GCC unroll 3
            for (int i = k; i < N; ++i) {
                a[i][k] = d[k * h + i];
                if (k == 0) continue;
                double known = m[i][0] * a[k][0];
#pragma GCC unroll 3
                for (int j = 1; j < k; ++j) known += m[i][j] * a[k][j];
                a[i][k] -= known;
            }
            const double inverse = 1.0 / a[k][k];
            p.l[k][k] = std::sqrt(inverse);
#pragma GCC unroll 3
            for (int i = k + 1; i < N; ++i) {
                m[i][k] = a[i][k] * inverse;
                p.l[i][k] = a[i][k] * p.l[k][k];
            }
            if (bad < 0 && !(a[k][k] > limits[k])) [[unlikely]]
                bad = k;
        }
        return bad;
    }

    /// X L' = B in place for the rows of one node column, a multiple of 8.
    static void solve_rows(double* x, Step h, Step count, const Pivot& p) {
        for (Step i = 0; i < count; i += lanes) {
            Vector<lanes> y[N];
#pragma GCC unroll 3
            for (int c = 0; c < N; ++c) {
                y[c] = load<lanes>(x + c * h + i);
#pragma GCC unroll 3
                for (int k = 0; k < c; ++k) y[c] -= y[k] * p.l[c][k];
                y[c] *= p.l[c][c];
                store<lanes>(x + c * h + i, y[c]);
            }
        }
    }

    // --- vectors of one right-hand side: `count` rows beside the columns of a node, and the node's own numbers

    struct Part {
        double v[N];
    };
    static Part forward(const double* b, Step, const Pivot& p) {
        Part y;
#pragma GCC unroll 3
        for (int c = 0; c < N; ++c) {
            y.v[c] = b[c];
#pragma GCC unroll 3
            for (int k = 0; k < c; ++k) y.v[c] -= p.l[c][k] * y.v[k];
            y.v[c] *= p.l[c][c];
        }
        return y;
    }
    static Part backward(Part y, const Pivot& p) {
#pragma GCC unroll 3
        for (int c = N - 1; c >= 0; --c) {
#pragma GCC unroll 3
            for (int k = c + 1; k < N; ++k) y.v[c] -= p.l[k][c] * y.v[k];
            y.v[c] *= p.l[c][c];
        }
        return y;
    }
    /// y -= X a
    static void subtract(double* y, Step, const double* x, Step h, Step count, const Part& a) {
        for (Step i = 0; i < count; i += lanes) {
            Vector<lanes> rest = load<lanes>(y + i);
#pragma GCC unroll 3
            for (int c = 0; c < N; ++c) rest -= load<lanes>(x + c * h + i) * a.v[c];
            store<lanes>(y + i, rest);
        }
    }
    /// b - X' y
    static Part minus_dot(Part b, const double* y, Step, const double* x, Step h, Step count) {
        Vector<lanes> total[N] = {};
        for (Step i = 0; i < count; i += lanes) {
            const Vector<lanes> v = load<lanes>(y + i);
#pragma GCC unroll 3
            for (int c = 0; c < N; ++c) total[c] += v * load<lanes>(x + c * h + i);
        }
#pragma GCC unroll 3
        for (int c = 0; c < N; ++c) b.v[c] -= sum<lanes>(total[c]);
        return b;
    }
};

using Real3 = Real<3>;
using Real2 = Real<2>;

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
