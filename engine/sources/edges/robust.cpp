#include "vmslam/edges/robust.hpp"

#include <algorithm>

namespace vmslam::edges {

std::array<double, 3> expectations(const Kernel& kernel, int dimension) {
    const double step = (std::sqrt(dimension) + 9) / 4000, peak = std::sqrt(std::max(dimension - 1.0, 0.5));
    double total = 0.0, mean = 0.0, slope = 0.0, square = 0.0;
    for (int k = 0; k < 4000; ++k) {
        const double r = (k + 0.5) * step, w = kernel.weight(r * r);
        const double density = std::exp((dimension - 1) * std::log(r / peak) - (r * r - peak * peak) / 2);
        total += density;
        mean += density * w;
        slope += density * w * r * r;
        square += density * w * w * r * r;
    }
    return {mean / total, slope / (dimension * total), square / (dimension * total)};
}

}  // namespace vmslam::edges
