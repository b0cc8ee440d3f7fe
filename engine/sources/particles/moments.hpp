// The mean and covariance of a landmark from weighted points about a mode.
#pragma once

#include "vmslam/particles/gaussian.hpp"

namespace vmslam::particles {

/// The mode of a density of positions, and L with L L' the inverse of its curvature (axx, axy; axy, ayy) there.
struct Mode {
    Lanes x, y, l00, l10, l11;
    Mode(const Lanes& mode_x, const Lanes& mode_y, const Lanes& axx, const Lanes& axy, const Lanes& ayy)
        : x(mode_x), y(mode_y) {
        const Lanes area = axx * ayy - axy * axy;
        l00 = numbers::root(Lanes(ayy / area));
        l10 = -axy / (area * l00);
        l11 = numbers::root(Lanes(axx / area - l10 * l10));
    }
    /// L n, relative to the mode
    Lanes right(double n0) const { return l00 * n0; }
    Lanes up(double n0, double n1) const { return l10 * n0 + l11 * n1; }
};

/// Sums over points of w, w x, w y, ... for positions (x, y) relative to the mode and headings h relative to the mean before.
class Moments {
   public:
    void add(const Lanes& w, const Lanes& x, const Lanes& y, const Lanes& h) {
        mass_ += w, x_ += w * x, y_ += w * y, h_ += w * h;
        xx_ += w * x * x, xy_ += w * x * y, yy_ += w * y * y, xh_ += w * x * h, yh_ += w * y * h, hh_ += w * h * h;
    }
    const Lanes& mass() const { return mass_; }

    /// The Gaussian of the points; each has in its heading the variance `rest` beside.
    Gaussian gaussian(const Mode& about, const Lanes& heading, const Lanes& rest) const {
        const Lanes x = x_ / mass_, y = y_ / mass_, h = h_ / mass_;
        return {about.x + x,         about.y + y,         numbers::wrap_angle(Lanes(heading + h)),
                xx_ / mass_ - x * x, xy_ / mass_ - x * y, xh_ / mass_ - x * h,
                yy_ / mass_ - y * y, yh_ / mass_ - y * h, hh_ / mass_ - h * h + rest};
    }

   private:
    Lanes mass_{}, x_{}, y_{}, h_{}, xx_{}, xy_{}, yy_{}, xh_{}, yh_{}, hh_{};
};

/// Whether the points found the posterior: a finite value, and a covariance.
inline numbers::Integers found(const Lanes& value, const Gaussian& g) {
    return (numbers::magnitude(value) < 1e300) & (g.xx > 0.0) & (g.xx * g.yy > g.xy * g.xy);
}

}  // namespace vmslam::particles
