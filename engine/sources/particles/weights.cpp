#include "vmslam/particles/weights.hpp"

#include <numeric>

#include "vmslam/numbers/elementary.hpp"

namespace vmslam::particles {

using namespace numbers;

WeightSums normalize(std::span<double> log_weights, double highest, double* weights) {
    WeightSums all{0.0, 0.0};
    // sums of 1024 particles each lose less to rounding
    constexpr std::size_t chunk = 1024;
    for (std::size_t begin = 0; begin < log_weights.size(); begin += chunk) {
        Lanes total{}, squares{};
        const std::size_t end = std::min(begin + chunk, log_weights.size());
        for (std::size_t i = begin; i < end; i += lanes) {
            Lanes w = numbers::exp(Lanes(load(log_weights.data() + i) - highest));
            // the lanes behind the last particle
            for (std::size_t k = i + lanes; k > end; --k) w[k - 1 - i] = 0.0;
            store(weights + i, w);
            total += w, squares += w * w;
        }
        all = {all.total + sparse::sum<lanes>(total), all.squares + sparse::sum<lanes>(squares)};
    }
    const double less = highest + numbers::log(all.total);
    for (double& log_weight : log_weights) log_weight -= less;
    return all;
}

// The first position of particle k is the number of positions before cumulative[k-1]. Each particle writes its index there;
// if it has no position, the next particle overwrites it. Then the indices are spread to the right.
std::vector<Index> evenly_spaced(std::span<const double> cumulative, double offset) {
    const auto count = static_cast<std::int64_t>(cumulative.size());
    const double total = cumulative.back(), highest = static_cast<double>(count), scale = highest / total;
    std::vector<Index> ancestors(count + 1, 0);
    std::int64_t first = 0;
    for (std::int64_t k = 0; k < count; ++k) {
        ancestors[first] = static_cast<Index>(k);
        const double after = std::ceil(cumulative[k] * scale - offset);
        first = cumulative[k] == total ? count : static_cast<std::int64_t>(std::fmin(std::fmax(after, 0.0), highest));
    }
    ancestors.pop_back();
    std::inclusive_scan(ancestors.begin(), ancestors.end(), ancestors.begin(),
                        [](Index a, Index b) { return std::max(a, b); });
    return ancestors;
}

std::vector<Index> at_positions(std::span<const double> cumulative, std::span<const double> positions) {
    const double total = cumulative.back();
    std::size_t last = cumulative.size() - 1, k = 0;
    while (last > 0 && cumulative[last - 1] == total) --last;
    std::vector<Index> ancestors;
    ancestors.reserve(positions.size());
    for (const double position : positions) {
        while (k < last && cumulative[k] <= position * total) ++k;
        ancestors.push_back(static_cast<Index>(k));
    }
    return ancestors;
}

}  // namespace vmslam::particles
