#include "vmslam/particles/anonymous_map.hpp"

#include <algorithm>

namespace vmslam::particles {

/// A landmark is missed only within this share of the limits of the sensor.
constexpr double inside = 0.9;
/// The share of the variances of a single sighting by which landmarks that are one may differ in any case.
constexpr double correlated = 0.1;

AnonymousMap::AnonymousMap(std::size_t particles, bool oriented, const AnonymousOptions& options, Confusion confusion)
    : particles_(particles),
      oriented_(oriented),
      options_(options),
      confusion_(std::move(confusion)),
      // the class of a sighting is at most n times as likely as for a new landmark
      gate_(options.border + 2 * numbers::log(static_cast<double>(std::max<std::size_t>(1, confusion_.classes)))),
      limits_{infinity, 0.0, 0.0} {
    enlarge(8);
}

std::vector<std::int64_t> AnonymousMap::ids() const {
    std::vector<std::int64_t> out;
    for (const Slice& slice : slices_)
        if (slice.landmark >= 0) out.push_back(slice.landmark);
    std::sort(out.begin(), out.end());
    return out;
}

LandmarkView AnonymousMap::view(std::int64_t landmark, History& history) const {
    for (const Slice& slice : slices_)
        if (slice.landmark == landmark && landmark >= 0) return {&slice.rows, history.ancestors(slice.level)};
    return {nullptr, nullptr};
}

void AnonymousMap::learn(std::span<const Sighting> sightings) {
    double range = 0.0, angles = 0.0;
    for (const auto& [z, q] : sightings) {
        limits_.least_range = std::min(limits_.least_range, z.range);
        limits_.most_range = std::max(limits_.most_range, z.range);
        limits_.most_bearing = std::max(limits_.most_bearing, std::fabs(z.bearing));
        range += q.range;
        angles += q.bearing + (oriented_ ? q.psi : 0.0);
    }
    const auto known = [](double given, double learned) { return std::isnan(given) ? learned : given; };
    limits_ = {known(options_.limits.least_range, limits_.least_range), known(options_.limits.most_range, limits_.most_range),
               known(options_.limits.most_bearing, limits_.most_bearing)};
    const auto count = static_cast<double>(sightings.size());
    blur_ = {correlated * range / count, correlated * angles / count};
}

AnonymousScan AnonymousMap::scan(std::span<const Sighting> sightings, std::span<const std::int64_t> shown,
                                 std::span<const Box> boxes, std::int64_t step, History& history) {
    learn(sightings);
    AnonymousScan scan{sightings, shown, {}, oriented_, gate_, static_cast<double>(step), &confusion_, {}, {}, {}, {}};
    for (const auto& [z, q] : sightings) {
        // the density of a perfectly known landmark at the border of its ellipse
        double log_q = numbers::log(q.range) + numbers::log(q.bearing);
        if (oriented_) log_q += numbers::log(q.psi);
        scan.log_new.push_back(-0.5 * (options_.border + log_q + (oriented_ ? 3.0 : 2.0) * log_2pi));
    }
    scan.near_slices = within(boxes);
    bring_up_to_date(scan.near_slices, history);
    scan.fresh_slices = make_room(sightings.size(), history);
    scan.near = rows_of(scan.near_slices);
    scan.fresh = rows_of(scan.fresh_slices);
    for (Blocks* const rows : scan.fresh)
        for (std::size_t i = 0; i < particles_; i += lanes) numbers::store(rows->group(evidence_row, i), Lanes{});
    return scan;
}

void AnonymousMap::end_scan(const AnonymousScan& scan, const Ranges& ranges, History& history) {
    for (const std::size_t slice : scan.fresh_slices) slices_[slice].landmark = created_++;
    std::vector<std::size_t> changed = scan.near_slices;
    changed.insert(changed.end(), scan.fresh_slices.begin(), scan.fresh_slices.end());
    written(changed, ranges, history);
}

void AnonymousMap::end_step(const Rows& poses, std::int64_t step, const Ranges& ranges, History& history) {
    ++steps_;
    const bool merges = options_.merge_interval > 0 && steps_ % options_.merge_interval == 0;
    Box box;
    for (std::size_t i = 0; i < particles_; ++i) box.include(poses.row(0)[i], poses.row(1)[i], limits_.most_range);
    std::vector<std::size_t> near = within({&box, 1});
    if (!merges) std::erase_if(near, [&](std::size_t slice) { return !slices_[slice].extent.droppable; });
    if (near.empty()) return;
    bring_up_to_date(near, history);
    const std::vector<Blocks*> rows = rows_of(near);
    const Limits in_view{limits_.least_range / inside, limits_.most_range * inside, limits_.most_bearing * inside};
    ranges.each([&](std::size_t lo, std::size_t hi) {
        count_misses(rows, poses, static_cast<double>(step), in_view, lo, hi);
        if (merges) merge(rows, oriented_, options_.merge_gate, blur_, confusion_.classes, lo, hi);
    });
    written(near, ranges, history);
}

/// Record the level and the extent of slices that were written, and free those that no particle has.
void AnonymousMap::written(std::span<const std::size_t> changed, const Ranges& ranges, History& history) {
    std::vector<std::vector<Extent>> parts(ranges.count());
    in_parallel(static_cast<int>(ranges.count()), [&](int k) {
        for (const std::size_t slice : changed)
            parts[k].push_back(extent_of(slices_[slice].rows, gate_, ranges.edge(k), ranges.edge(k + 1)));
    });
    for (std::size_t n = 0; n < changed.size(); ++n) {
        Slice& slice = slices_[changed[n]];
        slice.level = history.level_to_write();
        slice.extent = {};
        for (const auto& part : parts) slice.extent.include(part[n]);
        if (slice.extent.owners == 0) slice.landmark = -1;
    }
}

/// The slices whose box overlaps one of the boxes, in the order of creation.
std::vector<std::size_t> AnonymousMap::within(std::span<const Box> boxes) const {
    std::vector<std::size_t> near;
    for (std::size_t n = 0; n < slices_.size(); ++n) {
        const Slice& slice = slices_[n];
        const auto overlaps = [&](const Box& box) { return slice.extent.box.overlaps(box); };
        if (slice.landmark >= 0 && std::any_of(boxes.begin(), boxes.end(), overlaps)) near.push_back(n);
    }
    std::sort(near.begin(), near.end(),
              [&](std::size_t a, std::size_t b) { return slices_[a].landmark < slices_[b].landmark; });
    return near;
}

/// Bring slices to the current particle indices.
void AnonymousMap::bring_up_to_date(std::span<const std::size_t> slices, History& history) {
    for (const std::size_t n : slices) {
        Blocks& rows = slices_[n].rows;
        const Index* const ancestors = history.ancestors(slices_[n].level);
        if (!ancestors) continue;
        if (spare_.rows() == 0) spare_ = Blocks(rows.rows(), particles_);
        for (std::size_t i = 0; i < particles_; i += lanes)
            for (int row = 0; row < spare_.rows(); ++row) numbers::store(spare_.group(row, i), read(rows, row, i, ancestors));
        std::swap(spare_, rows);
    }
}

/// Free slices: first those that no living particle has are freed, then the pool is enlarged.
std::vector<std::size_t> AnonymousMap::make_room(std::size_t count, History& history) {
    const auto free_slices = [&] {
        std::vector<std::size_t> out;
        for (std::size_t n = 0; n < slices_.size(); ++n)
            if (slices_[n].landmark < 0) out.push_back(n);
        return out;
    };
    std::vector<std::size_t> free = free_slices();
    if (free.size() < count) {
        for (Slice& slice : slices_) {
            const LandmarkView view{&slice.rows, history.ancestors(slice.level)};
            bool owned = false;
            for (std::size_t i = 0; i < particles_ && !owned; ++i) owned = slice.rows.at(evidence_row, view.at(i)) > 0.0;
            if (!owned) slice.landmark = -1;
        }
        // more than is needed now, or the search above would be repeated at every scan
        if (free_slices().size() < count + slices_.size() / 4) enlarge(std::max(slices_.size(), 2 * count));
        free = free_slices();
    }
    free.resize(count);
    return free;
}

void AnonymousMap::enlarge(std::size_t more) {
    const int rows = first_class_row + static_cast<int>(confusion_.classes);
    for (std::size_t n = 0; n < more; ++n) slices_.push_back({Blocks(rows, particles_)});
}

std::vector<Blocks*> AnonymousMap::rows_of(std::span<const std::size_t> slices) {
    std::vector<Blocks*> out;
    for (const std::size_t n : slices) out.push_back(&slices_[n].rows);
    return out;
}

}  // namespace vmslam::particles
