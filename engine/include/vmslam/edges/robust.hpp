// Robust kernels: an edge with r² = e' Omega e costs 2 rho(r), and enters Omega and xi with the weight w(r) = rho'(r) / r.
#pragma once

#include <cmath>

namespace vmslam::edges {

enum class Robust { squares, huber, cauchy, geman_mcclure };

/// A kernel of width c, in standard deviations.
struct Kernel {
    Robust kind = Robust::squares;
    double c = 1.0;

    explicit operator bool() const { return kind != Robust::squares; }

    /// 2 rho(r). Huber: r² up to c², then 2 c r - c². Cauchy: c² log(1 + r²/c²). Geman-McClure: c² r² / (c² + r²).
    double loss(double squares) const {
        switch (kind) {
            case Robust::huber: return squares > c * c ? 2 * c * std::sqrt(squares) - c * c : squares;
            case Robust::cauchy: return c * c * std::log1p(squares / (c * c));
            case Robust::geman_mcclure: return c * c * squares / (c * c + squares);
            default: return squares;
        }
    }

    /// w(r) = rho'(r) / r. Huber: 1 up to c, then c / r. Cauchy: c² / (c² + r²). Geman-McClure: the square of Cauchy's.
    double weight(double squares) const {
        switch (kind) {
            case Robust::huber: return squares > c * c ? c / std::sqrt(squares) : 1.0;
            case Robust::cauchy: return c * c / (c * c + squares);
            case Robust::geman_mcclure: return (c * c / (c * c + squares)) * (c * c / (c * c + squares));
            default: return 1.0;
        }
    }

    /// The derivative of w by r², never positive.
    double weight_slope(double squares) const {
        const double sum = c * c + squares;
        switch (kind) {
            case Robust::huber: return squares > c * c ? -0.5 * c / (squares * std::sqrt(squares)) : 0.0;
            case Robust::cauchy: return -(c / sum) * (c / sum);
            case Robust::geman_mcclure: return -2 * c * c * c * c / (sum * sum * sum);
            default: return 0.0;
        }
    }
};

}  // namespace vmslam::edges
