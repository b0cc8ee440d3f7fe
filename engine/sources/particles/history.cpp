#include "vmslam/particles/history.hpp"

#include <limits>
#include <numeric>

#include "require.hpp"
#include "vmslam/numbers/elementary.hpp"

namespace vmslam::particles {

/// Rows are removed at the earliest after this many new ones per particle.
constexpr std::size_t minimum_growth = 16;
/// Rows are numbered with 32 bits.
constexpr std::size_t most_rows = std::numeric_limits<Index>::max();

History::History(std::size_t particles) : particles_(particles), line_(particles), limit_(minimum_growth * particles) {
    std::iota(line_.begin(), line_.end(), Index{0});
}

std::size_t History::bytes() const {
    return poses_.capacity() * (sizeof(poses_[0]) + sizeof(Origin)) + line_.capacity() * sizeof(Index);
}

void History::open_level(bool is_step) {
    if (stored_rows() + particles_ > limit_) prune();
    const std::size_t end = stored_rows() + particles_;
    if (end > poses_.size()) {
        require(end <= most_rows, "the histories of so many particles are too long to be stored; take fewer particles");
        const std::size_t size = std::min(2 * end, most_rows);
        // all of them or none: without memory nothing has changed
        poses_.reserve(size), origins_.reserve(size);
        poses_.resize(size), origins_.resize(size);
    }
    is_step_.resize(levels());
    is_step_.push_back(is_step);
    first_.push_back(end);
    if (branched_) living_ = static_cast<std::int64_t>(levels()) - 1;
    branched_ = false;
}

void History::write(const Rows& poses, std::size_t lo, std::size_t hi) {
    const std::size_t row = first_[levels() - 1];
    amend(poses, lo, hi);
    for (std::size_t i = lo; i < hi; ++i) {
        origins_[row + i] = {line_[i], static_cast<Index>(i)};
        line_[i] = static_cast<Index>(row + i);
    }
}

void History::amend(const Rows& poses, std::size_t lo, std::size_t hi) {
    const std::size_t row = first_[levels() - 1];
    for (std::size_t i = lo; i < hi; ++i) poses_[row + i] = {poses.row(0)[i], poses.row(1)[i], poses.row(2)[i]};
}

void History::branch(std::span<const Index> ancestors) {
    std::vector<Index> line(particles_);
    Ancestry parent(padded(particles_), 0);
    for (std::size_t i = 0; i < particles_; ++i) {
        line[i] = line_[ancestors[i]];
        parent[i] = branched_ ? parent_[ancestors[i]] : ancestors[i];
    }
    line_.swap(line);
    parent_.swap(parent);
    previous_ = living_;
    branched_ = true;
    inherited_.clear();
}

std::int64_t History::level_to_write() {
    if (branched_) {
        // resampled within this step: the new indices need a level of their own
        Rows poses(3, particles_);
        for (std::size_t i = 0; i < particles_; ++i)
            for (int k = 0; k < 3; ++k) poses.row(k)[i] = poses_[line_[i]][k];
        open_level(false);
        write(poses, 0, particles_);
    }
    return static_cast<std::int64_t>(levels()) - 1;
}

const Index* History::ancestors(std::int64_t level) {
    if (is_living(level)) return nullptr;
    // most requests: landmarks that are in view at every step
    if (level >= previous_) return parent_.data();
    for (const auto& [known, indices] : inherited_)
        if (known == level) return indices.data();
    inherited_.emplace_back(level, indices(static_cast<std::size_t>(level)));
    return inherited_.back().second.data();
}

// level by level, from the index that each row had there to those of its descendants
Ancestry History::indices(std::size_t level) const {
    const std::size_t first = first_[level], second = first_[level + 1], end = stored_rows();
    std::vector<Index> index(end - first);
    for (std::size_t row = first; row < end; ++row)
        index[row - first] = row < second ? origins_[row].number : index[origins_[row].parent - first];
    Ancestry out(padded(particles_), 0);
    for (std::size_t i = 0; i < particles_; ++i) out[i] = index[line_[i] - first];
    return out;
}

std::vector<std::array<double, 3>> History::trajectory(std::size_t particle) const {
    std::vector<std::array<double, 3>> out;
    Index row = line_[particle];
    for (std::size_t level = levels(); level-- > 0; row = origins_[row].parent)
        if (is_step_[level]) out.push_back(poses_[row]);
    std::reverse(out.begin(), out.end());
    return out;
}

History::Summary History::summary(std::span<const double> weights, const std::array<double, 2>& lever) {
    prune();
    // the weight of a row is the sum of the weights of its living descendants
    std::vector<double> mass(stored_rows(), 0.0);
    for (std::size_t i = 0; i < particles_; ++i) mass[line_[i]] += weights[i];
    Summary out;
    for (std::size_t level = levels(); level-- > 0;) {
        double x = 0.0, y = 0.0, sine = 0.0, cosine = 0.0;
        for (std::size_t row = first_[level]; row < first_[level + 1]; ++row) {
            const auto [s, c] = numbers::sincos(poses_[row][2]);
            x += mass[row] * poses_[row][0], y += mass[row] * poses_[row][1];
            sine += mass[row] * s, cosine += mass[row] * c;
            if (level > 0) mass[origins_[row].parent] += mass[row];
        }
        if (!is_step_[level]) continue;
        // the sums of the points of all rows
        x += cosine * lever[0] - sine * lever[1], y += sine * lever[0] + cosine * lever[1];
        const double heading = sine == 0.0 && cosine == 0.0 ? 0.0 : numbers::atan2(sine, cosine);
        out.means.push_back({x, y, numbers::wrap_angle(heading)});
        out.distinct.push_back(static_cast<std::int64_t>(first_[level + 1] - first_[level]));
    }
    std::reverse(out.means.begin(), out.means.end());
    std::reverse(out.distinct.begin(), out.distinct.end());
    return out;
}

// from the last level back to one of which no row was lost since the last removal, when every earlier row had a descendant
std::vector<bool> History::rows_with_descendants(std::size_t* unchanged) const {
    std::vector<bool> alive(stored_rows(), false);
    for (const Index row : line_) alive[row] = true;
    std::size_t level = levels() - 1;
    for (; level > 0; --level) {
        std::size_t count = 0;
        for (std::size_t row = first_[level]; row < first_[level + 1]; ++row) {
            if (!alive[row]) continue;
            alive[origins_[row].parent] = true;
            ++count;
        }
        if (level < settled_ && count == first_[level + 1] - first_[level]) break;
    }
    *unchanged = level;
    return alive;
}

void History::prune() {
    if (levels() > 0) {
        std::size_t start = 0;
        const std::vector<bool> alive = rows_with_descendants(&start);
        const std::size_t base = first_[start];
        std::vector<Index> to(stored_rows() - base);
        std::size_t write = base, read = base;
        for (std::size_t level = start; level < levels(); ++level) {
            const std::size_t stop = first_[level + 1];
            for (std::size_t row = read; row < stop; ++row) {
                to[row - base] = static_cast<Index>(write);
                if (!alive[row]) continue;
                poses_[write] = poses_[row];
                auto& [parent, number] = origins_[write] = origins_[row];
                if (level > start && static_cast<std::size_t>(parent) >= base) parent = to[parent - base];
                ++write;
            }
            read = stop;
            first_[level + 1] = write;
        }
        for (Index& row : line_) row = to[row - base];
        settled_ = levels();
    }
    limit_ = 2 * stored_rows() + minimum_growth * particles_;
}

}  // namespace vmslam::particles
