#include "vmslam/particles/identified_map.hpp"

#include <algorithm>
#include <array>
#include <limits>

namespace vmslam::particles {

using Task = IdentifiedMap::Task;

std::vector<LandmarkId> IdentifiedMap::ids() const {
    std::vector<LandmarkId> out;
    for (const auto& [id, column] : columns_) out.push_back(id);
    return out;
}

LandmarkView IdentifiedMap::view(LandmarkId id, History& history) const {
    const auto found = columns_.find(id);
    if (found == columns_.end()) return {nullptr, nullptr};
    return {&found->second.numbers, history.ancestors(found->second.level)};
}

Blocks IdentifiedMap::spare() {
    // columns are reused, because the operating system would clear fresh memory page by page
    if (spare_.empty())
        return Blocks(gaussian_rows(oriented_) + (jointly_ > 0 ? 1 + 3 * static_cast<int>(jointly_) : 0), particles_);
    Blocks numbers = std::move(spare_.back());
    spare_.pop_back();
    return numbers;
}

void IdentifiedMap::place(LandmarkId id, const Vector& mean, const Symmetric& covariance, History& history) {
    const Gaussian landmark = common(mean, covariance);
    Column& column = columns_[id] = {history.level_to_write(), spare(), {}};
    for (std::size_t i = 0; i < particles_; i += lanes) write_gaussian(column.numbers, oriented_, i, landmark);
}

IdentifiedMap::Scan IdentifiedMap::scan(std::span<const LandmarkId> ids, std::span<const Sighting> sightings,
                                        History& history) {
    std::vector<Task> tasks;
    std::vector<LandmarkId> led;
    for (std::size_t k = 0; k < ids.size(); ++k) {
        const auto known = columns_.find(ids[k]);
        // a landmark that is new in this scan has no leading sighting
        const bool leading = std::find(led.begin(), led.end(), ids[k]) == led.end();
        if (leading) led.push_back(ids[k]);
        if (known == columns_.end()) {
            tasks.push_back(first_sighting(ids[k], sightings[k], history));
        } else {
            tasks.push_back(later_sighting(known->second, sightings[k], history));
            tasks.back().leading = leading;
        }
    }
    return Scan(oriented_, jointly_ > 0, std::move(tasks));
}

Task IdentifiedMap::first_sighting(LandmarkId id, const Sighting& sighting, History& history) {
    Column& column = columns_[id] = {history.level_to_write(), spare(), {}};
    if (jointly_ > 0) column.sightings.push_back({sighting, 0.0});
    return {sighting, {sighting, 0.0}, &column.numbers};
}

Task IdentifiedMap::later_sighting(Column& column, const Sighting& sighting, History& history) {
    const Index* const slots = history.ancestors(column.level);
    const Blocks* source = &column.numbers;
    // where no particle was replaced since, each reads and writes its own place
    if (slots) {
        source = &replaced_.emplace_back(std::move(column.numbers));
        column.numbers = spare();
    }
    RatedSighting rated{sighting, 0.0};
    if (range_noise_) rated.rate = range_noise_->rate, rated.sighting.variances.range = range_noise_->variance;
    Task task{sighting, rated, &column.numbers, source, slots};
    if (!column.sightings.empty() && column.sightings.size() < jointly_) {
        column.sightings.push_back(rated);
        task.together = column.sightings;
    } else {
        column.sightings.clear();
    }
    column.level = history.level_to_write();
    return task;
}

bool IdentifiedMap::Scan::weighs() const {
    return std::any_of(tasks_.begin(), tasks_.end(), [](const Task& task) { return task.source != nullptr; });
}

Lanes IdentifiedMap::Scan::Group::correct(Gaussian& belief, Weighed weighed) const {
    Lanes value{};
    for (const Task& task : scan_.tasks_) {
        if (!task.leading) continue;
        const Gaussian landmark = read_gaussian(*task.source, scan_.oriented_, first_, task.slots);
        value += update_pose(belief, landmark, task.sighting, scan_.oriented_);
    }
    return weighed == Weighed::at_prediction ? value : Lanes{};
}

Lanes IdentifiedMap::Scan::Group::update(const Pose& pose, Weighed weighed) const {
    Lanes value{};
    for (const Task& task : scan_.tasks_) {
        const Lanes of_task = update_one(task, pose);
        if (weighed == Weighed::at_pose || !task.leading) value += of_task;
    }
    return value;
}

Lanes IdentifiedMap::Scan::Group::update_one(const Task& task, const Pose& pose) const {
    Lanes value{};
    Gaussian landmark;
    if (task.source) {
        landmark = read_gaussian(*task.source, scan_.oriented_, first_, task.slots);
        value = !task.together.empty() ? update_jointly(task, pose, landmark)
                : scan_.integrates_    ? update_alone(task, pose, landmark)
                                       : update_linearised(task, pose, landmark);
    } else if (scan_.integrates_) {
        landmark = initial_moments(pose, task.sighting);
        // Z_1 is the range
        write_integral(task, numbers::all<Lanes>(numbers::log(task.sighting.z.range)), {&pose, 1});
    } else {
        landmark = initial_landmark(pose, task.sighting);
    }
    write_gaussian(*task.target, scan_.oriented_, first_, landmark);
    return value;
}

/// log Z, and the poses of all sightings.
void IdentifiedMap::Scan::Group::write_integral(const Task& task, const Lanes& log_evidence,
                                                std::span<const Pose> poses) const {
    int row = gaussian_rows(scan_.oriented_);
    const auto put = [&](const Lanes& value) { numbers::store(task.target->group(row++, first_), value); };
    put(log_evidence);
    for (const Pose& pose : poses) put(pose.x), put(pose.y), put(pose.t);
}

// the variance of the range is (rate r)² + that of the sighting
Lanes IdentifiedMap::Scan::Group::update_linearised(const Task& task, const Pose& pose, Gaussian& landmark) const {
    const auto& [sighting, rate] = task.rated;
    const Lanes dx = landmark.x - pose.x, dy = landmark.y - pose.y;
    const Lanes range_variance = sighting.variances.range + rate * rate * (dx * dx + dy * dy);
    return update_landmark(landmark, pose, sighting, range_variance, scan_.oriented_);
}

Lanes IdentifiedMap::Scan::Group::update_alone(const Task& task, const Pose& pose, Gaussian& landmark) const {
    const Gaussian before = landmark;
    const Lanes value = update_linearised(task, pose, landmark);
    const Evidence exact = single_evidence(before, landmark, pose, task.rated, scan_.oriented_);
    // where the points miss the posterior, what they say of it is worse than the Kalman update
    const auto better = exact.found & (value > -std::numeric_limits<double>::infinity());
    landmark = select(better, exact.landmark, landmark);
    return numbers::select(better, exact.value, value);
}

// the weight is multiplied by Z_K / Z_{K-1}
Lanes IdentifiedMap::Scan::Group::update_jointly(const Task& task, const Pose& pose, Gaussian& landmark) const {
    int row = gaussian_rows(scan_.oriented_);
    const auto next = [&] { return read(*task.source, row++, first_, task.slots); };
    const Lanes before = next();
    std::array<Pose, most_sightings> poses;
    const std::size_t count = task.together.size();
    for (std::size_t k = 0; k + 1 < count; ++k) poses[k] = {next(), next(), next()};
    poses[count - 1] = pose;
    const Evidence all = joint_evidence({poses.data(), count}, task.together, landmark, scan_.oriented_);
    // where the points find nothing, the particle is far from its sightings
    const Lanes value = update_linearised(task, pose, landmark);
    const Lanes kept = before + numbers::select(value > -std::numeric_limits<double>::infinity(), value, 0.0);
    write_integral(task, numbers::select(all.found, all.value, kept), {poses.data(), count});
    landmark = select(all.found, all.landmark, landmark);
    return numbers::select(all.found, Lanes(all.value - before), value);
}

}  // namespace vmslam::particles
