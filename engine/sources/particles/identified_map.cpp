#include "vmslam/particles/identified_map.hpp"

#include <algorithm>
#include <array>
#include <limits>

namespace vmslam::particles {

using Task = IdentifiedMap::Task;

IdentifiedMap::IdentifiedMap(const IdentifiedMap& other, History& history)
    : IdentifiedMap(history, other.particles_, other.oriented_, other.jointly_, other.range_noise_) {
    for (const auto& [id, column] : other.columns_)
        columns_[id] = {column.level, std::make_shared<Blocks>(*column.numbers),
                        column.sighted ? std::make_shared<Sighted>(*column.sighted) : nullptr};
}

std::vector<LandmarkId> IdentifiedMap::ids() const {
    std::vector<LandmarkId> out;
    for (const auto& [id, column] : columns_) out.push_back(id);
    return out;
}

LandmarkView IdentifiedMap::view(LandmarkId id) {
    const auto found = columns_.find(id);
    if (found == columns_.end()) return {nullptr, nullptr};
    return {found->second.numbers.get(), history_.ancestors(found->second.level)};
}

std::shared_ptr<Blocks> IdentifiedMap::spare() {
    // columns are reused, because the operating system would clear fresh memory page by page
    if (spare_.empty()) return std::make_shared<Blocks>(oriented_ ? oriented_rows : point_rows, particles_);
    auto rows = std::move(spare_.back());
    spare_.pop_back();
    return rows;
}

void IdentifiedMap::place(LandmarkId id, const Vector& mean, const Symmetric& covariance) {
    const auto all = [](double x) { return numbers::all<Lanes>(x); };
    const Gaussian landmark{all(mean.x),        all(mean.y),        all(mean.t),
                            all(covariance.xx), all(covariance.xy), all(covariance.xt),
                            all(covariance.yy), all(covariance.yt), all(covariance.tt)};
    auto numbers = spare();
    for (std::size_t i = 0; i < particles_; i += lanes) write_gaussian(*numbers, oriented_, i, landmark);
    columns_[id] = {history_.level(), std::move(numbers), nullptr};
}

IdentifiedMap::Scan IdentifiedMap::scan(std::span<const LandmarkId> ids, std::span<const Sighting> sightings,
                                        const std::shared_ptr<const Rows>& poses) {
    std::vector<Task> tasks;
    std::vector<LandmarkId> led;
    for (std::size_t k = 0; k < ids.size(); ++k) {
        const auto known = columns_.find(ids[k]);
        // a landmark that is new in this scan has no leading sighting
        const bool leading = std::find(led.begin(), led.end(), ids[k]) == led.end();
        if (leading) led.push_back(ids[k]);
        if (known == columns_.end()) {
            tasks.push_back(first_sighting(ids[k], sightings[k], poses));
        } else {
            tasks.push_back(later_sighting(known->second, sightings[k], poses));
            tasks.back().leading = leading;
        }
    }
    return Scan(oriented_, std::move(tasks));
}

void IdentifiedMap::end_scan() {
    for (auto& rows : replaced_) spare_.push_back(std::move(rows));
    replaced_.clear();
}

Task IdentifiedMap::first_sighting(LandmarkId id, const Sighting& sighting, const std::shared_ptr<const Rows>& poses) {
    Column column{history_.level(), spare(), nullptr};
    const Task task{
        jointly_ > 0 ? Task::Kind::first_moments : Task::Kind::first, sighting, {sighting, 0.0}, column.numbers.get()};
    if (jointly_ > 0) {
        column.sighted =
            std::make_shared<Sighted>(Sighted{Rows(0, particles_), poses, 1, Rows(1, particles_), {{sighting, 0.0}}});
        // Z_1 is the range
        column.sighted->log_evidence.fill(numbers::log(sighting.z.range));
    }
    columns_[id] = std::move(column);
    return task;
}

Task IdentifiedMap::later_sighting(Column& column, const Sighting& sighting, const std::shared_ptr<const Rows>& poses) {
    const Index* const slots = history_.ancestors(column.level);
    const auto source = column.numbers;
    // where no particle was replaced since, each reads and writes its own place
    if (slots) {
        column.numbers = spare();
        replaced_.push_back(source);
    }
    RatedSighting rated{sighting, 0.0};
    if (range_noise_) rated.rate = range_noise_->rate, rated.sighting.variances.range = range_noise_->variance;
    Task task{Task::Kind::kalman, sighting, rated, column.numbers.get(), source.get(), slots};
    if (column.sighted && column.sighted->sightings.size() < jointly_) {
        Sighted& sighted = *column.sighted;
        task.kind = Task::Kind::joint;
        task.evidence_before = std::make_shared<Rows>(std::move(sighted.log_evidence));
        sighted.log_evidence = Rows(1, particles_);
        task.evidence_after = sighted.log_evidence.row(0);
        join(sighted, rated, poses, slots);
        task.sighted = column.sighted;
        task.count = sighted.sightings.size();
    } else if (jointly_ > 0) {
        column.sighted.reset();
        task.kind = Task::Kind::single;
    }
    column.level = history_.level();
    return task;
}

// the poses of the former sightings as the present particles inherit them
void IdentifiedMap::join(Sighted& sighted, const RatedSighting& sighting, const std::shared_ptr<const Rows>& poses,
                         const Index* slots) const {
    sighted.sightings.push_back(sighting);
    if (sighted.last == poses) {
        ++sighted.here;
        return;
    }
    const int before = sighted.past.rows(), more = 3 * static_cast<int>(sighted.here);
    Rows past(before + more, particles_);
    for (int k = 0; k < before + more; ++k) {
        const double* const from = k < before ? sighted.past.row(k) : sighted.last->row((k - before) % 3);
        for (std::size_t i = 0; i < particles_; i += lanes) numbers::store(past.row(k) + i, read(from, i, slots));
    }
    sighted.past = std::move(past);
    sighted.last = poses;
    sighted.here = 1;
}

bool IdentifiedMap::Scan::weighs() const {
    return std::any_of(tasks_.begin(), tasks_.end(), [](const Task& task) { return task.source != nullptr; });
}

Lanes IdentifiedMap::Scan::Group::correct(Gaussian& belief, bool weighs) const {
    Lanes value{};
    for (const Task& task : scan_.tasks_) {
        if (!task.leading) continue;
        const Gaussian landmark = read_gaussian(*task.source, scan_.oriented_, first_, task.slots);
        value += update_pose(belief, landmark, task.sighting, scan_.oriented_);
    }
    return weighs ? value : Lanes{};
}

Lanes IdentifiedMap::Scan::Group::update(const Pose& pose, bool leaders) const {
    Lanes value{};
    for (const Task& task : scan_.tasks_) {
        const Lanes of_task = update_one(task, pose);
        if (leaders || !task.leading) value += of_task;
    }
    return value;
}

Lanes IdentifiedMap::Scan::Group::update_one(const Task& task, const Pose& pose) const {
    using Kind = Task::Kind;
    Lanes value{};
    Gaussian landmark;
    if (task.kind == Kind::first) {
        landmark = initial_landmark(pose, task.rated.sighting);
    } else if (task.kind == Kind::first_moments) {
        landmark = initial_moments(pose, task.rated.sighting);
    } else {
        landmark = read_gaussian(*task.source, scan_.oriented_, first_, task.slots);
        if (task.kind == Kind::joint) value = update_jointly(task, pose, landmark);
        if (task.kind == Kind::kalman) value = update_linearised(task, pose, landmark);
        if (task.kind == Kind::single) value = update_alone(task, pose, landmark);
    }
    write_gaussian(*task.target, scan_.oriented_, first_, landmark);
    return value;
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
    const Rows& past = task.sighted->past;
    std::array<Pose, most_sightings> poses;
    for (std::size_t k = 0; k < task.count; ++k) {
        const int row = 3 * static_cast<int>(k);
        const auto at = [&](int c) { return numbers::load(past.row(row + c) + first_); };
        poses[k] = row < past.rows() ? Pose{at(0), at(1), at(2)} : pose;
    }
    const Lanes before = read(task.evidence_before->row(0), first_, task.slots);
    const std::span<const RatedSighting> sightings(task.sighted->sightings.data(), task.count);
    const Evidence all = joint_evidence({poses.data(), task.count}, sightings, landmark, scan_.oriented_);
    // where the points find nothing, the particle is far from its sightings
    const Lanes value = update_linearised(task, pose, landmark);
    const Lanes kept = before + numbers::select(value > -std::numeric_limits<double>::infinity(), value, 0.0);
    numbers::store(task.evidence_after + first_, numbers::select(all.found, all.value, kept));
    landmark = select(all.found, all.landmark, landmark);
    return numbers::select(all.found, Lanes(all.value - before), value);
}

}  // namespace vmslam::particles
