#include "vmslam/particles/association.hpp"

namespace vmslam::particles {

using namespace numbers;

namespace {

/// The least n sum over classes of p(c) p'(c).
constexpr double least_common = 1e-300;
/// A landmark has a heading even where psi is not measured.
constexpr PositionRows rows = position_rows(true);

/// The sum over classes of p(c) p'(c).
Lanes same_class(const Blocks& a, const Blocks& b, std::size_t classes, std::size_t i) {
    Lanes total{};
    for (int row = first_class_row; row < first_class_row + static_cast<int>(classes); ++row)
        total += load(a.group(row, i)) * load(b.group(row, i));
    return total;
}

/// p(c) of the older landmark times p(c) of the younger one, in some lanes.
void join_classes(const Blocks& young, Blocks& old, std::size_t classes, std::size_t i, const Integers& merged) {
    const Lanes total = same_class(young, old, classes, i);
    for (int row = first_class_row; row < first_class_row + static_cast<int>(classes); ++row) {
        const Lanes before = load(old.group(row, i));
        store(old.group(row, i), numbers::select(merged, Lanes(load(young.group(row, i)) * before / total), before));
    }
}

/// The particles of a group in which two landmarks are one.
Integers are_one(const Blocks& young, const Blocks& old, bool oriented, double gate, const Blur& blur, std::size_t classes,
                 std::size_t i) {
    const auto both = (load(young.group(evidence_row, i)) != 0.0) & (load(old.group(evidence_row, i)) != 0.0) &
                      (load(young.group(last_step_row, i)) != load(old.group(last_step_row, i)));
    const Gaussian a = read_gaussian(old, true, i), b = read_gaussian(young, true, i);
    const Lanes dx = b.x - a.x, dy = b.y - a.y;
    // within the gate the distance is at most that of the traces, and a common class is worth at most log n
    const double farthest = classes > 0 ? gate + 2 * numbers::log(static_cast<double>(classes)) : gate;
    const auto near = both & (dx * dx + dy * dy <= farthest * (a.xx + a.yy + b.xx + b.yy + 2 * blur.position));
    if (!any(near)) return near;
    Lanes squared = squared_distance(a, b, blur.position, blur.heading, oriented);
    const Lanes common = static_cast<double>(classes) * same_class(young, old, classes, i);
    if (classes > 0) squared -= 2.0 * numbers::log(larger(common, all<Lanes>(least_common)));
    return near & (squared <= gate);
}

void merge_pair(Blocks& young, Blocks& old, bool oriented, std::size_t classes, std::size_t i, const Integers& merged) {
    const Gaussian a = read_gaussian(old, true, i), b = read_gaussian(young, true, i);
    write_gaussian(old, true, i, select(merged, fused(a, b, oriented), a));
    if (classes > 0) join_classes(young, old, classes, i, merged);
    double *const evidence = old.group(evidence_row, i), *const last = old.group(last_step_row, i);
    double* const gone = young.group(evidence_row, i);
    const Lanes sum = load(evidence) + load(gone);
    store(evidence, numbers::select(merged, smaller(sum, all<Lanes>(permanent_evidence)), load(evidence)));
    store(last, numbers::select(merged, larger(load(last), load(young.group(last_step_row, i))), load(last)));
    store(gone, numbers::select(merged, 0.0, load(gone)));
}

}  // namespace

void count_misses(std::span<Blocks* const> landmarks, const Rows& poses, double step, const Limits& view, std::size_t lo,
                  std::size_t hi) {
    for (Blocks* const landmark : landmarks) {
        for (std::size_t i = lo; i < hi; i += lanes) {
            const Lanes evidence = load(landmark->group(evidence_row, i));
            const auto missed =
                (evidence > 0.0) & (evidence < permanent_evidence) & (load(landmark->group(last_step_row, i)) != step);
            if (!any(missed)) continue;
            const Pose pose = read_pose(poses, i);
            const Lanes dx = load(landmark->group(rows.x, i)) - pose.x, dy = load(landmark->group(rows.y, i)) - pose.y;
            const Lanes r = root(Lanes(dx * dx + dy * dy));
            const Lanes bearing = magnitude(wrap_angle(Lanes(numbers::atan2(dy, dx) - pose.t)));
            const auto in_view = (r >= view.least_range) & (r <= view.most_range) & (bearing <= view.most_bearing);
            const Lanes less = larger(Lanes(evidence - 1.0), Lanes{});
            store(landmark->group(evidence_row, i), numbers::select(missed & in_view, less, evidence));
        }
    }
}

void Extent::include(const Extent& other) {
    owners += other.owners;
    droppable |= other.droppable;
    box.include(other.box);
}

Extent extent_of(const Blocks& landmark, double gate, std::size_t lo, std::size_t hi) {
    Extent out;
    for (std::size_t i = lo; i < hi; i += lanes) {
        const Lanes evidence = load(landmark.group(evidence_row, i));
        const auto owned = evidence > 0.0;
        if (!any(owned)) continue;
        const Lanes x = load(landmark.group(rows.x, i)), y = load(landmark.group(rows.y, i));
        const Lanes trace = load(landmark.group(rows.xx, i)) + load(landmark.group(rows.yy, i));
        const Lanes wide = 2.0 * root(Lanes(gate * larger(trace, Lanes{})));
        for (int k = 0; k < lanes && i + k < hi; ++k) {
            if (!owned[k]) continue;
            ++out.owners;
            out.droppable |= evidence[k] < permanent_evidence;
            out.box.include(x[k], y[k], wide[k]);
        }
    }
    return out;
}

void merge(std::span<Blocks* const> landmarks, bool oriented, double gate, const Blur& blur, std::size_t classes,
           std::size_t lo, std::size_t hi) {
    for (std::size_t i = lo; i < hi; i += lanes)
        for (std::size_t young = 1; young < landmarks.size(); ++young) {
            if (!any(load(landmarks[young]->group(evidence_row, i)) != 0.0)) continue;
            for (std::size_t old = 0; old < young; ++old) {
                const auto merged = are_one(*landmarks[young], *landmarks[old], oriented, gate, blur, classes, i);
                if (any(merged)) merge_pair(*landmarks[young], *landmarks[old], oriented, classes, i, merged);
            }
        }
}

}  // namespace vmslam::particles
