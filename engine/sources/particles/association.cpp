#include "vmslam/particles/association.hpp"

namespace vmslam::particles {

using namespace numbers;

namespace {

Gaussian landmark_of(const Blocks& rows, std::size_t first) { return read_gaussian(rows, true, first); }

/// P(shown k) = sum over c of p(c) P(shown k given c), where row(r) has p(c) of the landmarks.
template <class Row>
Lanes shown_likelihood(const Confusion& confusion, std::int64_t shown, const Row& row) {
    Lanes total{};
    for (std::size_t n = 0; n < confusion.classes; ++n)
        total += row(first_class_row + static_cast<int>(n)) * confusion(n, shown);
    return total;
}

/// Whether sightings may belong to a landmark: range and bearing are each tested alone, e² <= gate * (the entry on the
/// diagonal of V). Since V >= Q, every sighting outside is less likely than under a new landmark.
class Gate {
   public:
    Gate(const Gaussian& x, const Gaussian& m, double gate) : gate_(gate) {
        const Lanes dx = m.x - x.x, dy = m.y - x.y;
        r_ = root(Lanes(dx * dx + dy * dy));
        const Lanes ux = dx / r_, uy = dy / r_, vx = -uy / r_, vy = ux / r_;
        direction_ = numbers::atan2(dy, dx) - x.h;
        // C = Cov(m - x) and Cov(m - x, theta) = -P_xt
        const Lanes cxx = x.xx + m.xx, cxy = x.xy + m.xy, cyy = x.yy + m.yy;
        along_ = cxx * ux * ux + 2.0 * cxy * ux * uy + cyy * uy * uy;
        across_ = cxx * vx * vx + 2.0 * cxy * vx * vy + cyy * vy * vy + 2.0 * (vx * x.xh + vy * x.yh) + x.hh;
    }
    Integers passes(const Sighting& s) const {
        const Lanes e0 = s.z.range - r_, e1 = wrap_angle(Lanes(s.z.bearing - direction_));
        return (e0 * e0 <= gate_ * (along_ + s.variances.range)) & (e1 * e1 <= gate_ * (across_ + s.variances.bearing));
    }

   private:
    double gate_;
    Lanes r_, direction_, along_, across_;
};

}  // namespace

void Box::include(const Box& other) {
    left = std::min(left, other.left), right = std::max(right, other.right);
    low = std::min(low, other.low), high = std::max(high, other.high);
}

bool Box::overlaps(const Box& other) const {
    return left <= other.right && other.left <= right && low <= other.high && other.low <= high;
}

Place place_of(const Gaussian& belief, const Sighting& sighting, double gate) {
    const auto& [z, q] = sighting;
    const auto [s, c] = sincos(Lanes(belief.h + z.bearing));
    const Lanes zero{}, of_pose = 2.0 * root(larger(Lanes(belief.xx + belief.yy), zero));
    const Lanes turned = root(larger(belief.hh, zero)) + std::sqrt(q.bearing);
    return {belief.x + z.range * c, belief.y + z.range * s,
            std::sqrt(gate) * (of_pose + std::sqrt(q.range) + z.range * turned)};
}

Lanes AnonymousScan::Group::begin(std::size_t first, const Gaussian& belief) {
    first_ = first;
    for (auto& hypotheses : hypotheses_) hypotheses.clear();
    for (std::size_t c = 0; c < scan_.near.size(); ++c) weigh_landmark(belief, static_cast<std::int64_t>(c));
    choose();
    Lanes value{};
    for (std::size_t k = 0; k < chosen_.size(); ++k) {
        const auto known = chosen_[k] >= 0;
        if (!any(known)) {
            value += scan_.log_new[k];
        } else {
            value +=
                numbers::select(known, scan_.confusion->classes > 0 ? class_ratio(k, chosen(k)) : Lanes{}, scan_.log_new[k]);
        }
    }
    return value;
}

void AnonymousScan::Group::weigh_landmark(const Gaussian& belief, std::int64_t c) {
    const Blocks& rows = *scan_.near[c];
    const auto owned = load(rows.group(evidence_row, first_)) != 0.0;
    if (!any(owned)) return;
    const Gaussian landmark = landmark_of(rows, first_);
    const Gate gate(belief, landmark, scan_.gate);
    for (std::size_t k = 0; k < scan_.sightings.size(); ++k) {
        auto possible = owned & gate.passes(scan_.sightings[k]);
        if (!any(possible)) continue;
        // log w_j
        Lanes score = predicted_likelihood(belief, landmark, scan_.sightings[k], scan_.oriented);
        if (scan_.confusion->classes > 0) score += class_ratio(k, [&](int row) { return load(rows.group(row, first_)); });
        possible &= score >= scan_.log_new[k];
        if (any(possible)) hypotheses_[k].push_back({c, numbers::select(possible, score, -infinity)});
    }
}

/// The most likely landmark of each sighting; where two sightings want the same, in the order of their likelihoods.
void AnonymousScan::Group::choose() {
    for (std::size_t k = 0; k < chosen_.size(); ++k) {
        chosen_[k] = Integers{} - 1;
        won_[k] = all<Lanes>(-infinity);
        for (const Hypothesis& h : hypotheses_[k]) {
            const auto better = h.score > won_[k];
            won_[k] = numbers::select(better, h.score, won_[k]);
            chosen_[k] = better ? Integers{} + h.landmark : chosen_[k];
        }
    }
    const Integers conflicting = conflicts();
    for (int lane = 0; lane < lanes; ++lane)
        if (conflicting[lane]) choose_in_order(lane);
}

Integers AnonymousScan::Group::conflicts() const {
    Integers found{};
    for (std::size_t k = 0; k < chosen_.size(); ++k)
        if (!hypotheses_[k].empty())
            for (std::size_t n = 0; n < k; ++n) found |= (chosen_[k] >= 0) & (chosen_[k] == chosen_[n]);
    return found;
}

/// The most likely pair first, then the most likely of the rest; no landmark is used twice in a scan. Ties go to the first.
void AnonymousScan::Group::choose_in_order(int lane) {
    const std::size_t scan = chosen_.size();
    std::vector<bool> done(scan, false), taken(scan_.near.size(), false);
    for (std::size_t k = 0; k < scan; ++k) chosen_[k][lane] = -1;
    while (true) {
        double best = -infinity;
        std::size_t sighting = 0;
        std::int64_t landmark = -1;
        for (std::size_t k = 0; k < scan; ++k) {
            if (done[k]) continue;
            for (const Hypothesis& h : hypotheses_[k]) {
                if (!(h.score[lane] > best) || taken[h.landmark]) continue;
                best = h.score[lane], sighting = k, landmark = h.landmark;
            }
        }
        if (landmark < 0) return;
        chosen_[sighting][lane] = landmark, won_[sighting][lane] = best;
        done[sighting] = taken[landmark] = true;
    }
}

/// log of n sum over c of p(c) P(shown k given c).
template <class Row>
Lanes AnonymousScan::Group::class_ratio(std::size_t k, const Row& row) const {
    const Confusion& confusion = *scan_.confusion;
    return numbers::log(Lanes(static_cast<double>(confusion.classes) * shown_likelihood(confusion, scan_.shown[k], row)));
}

/// One row of the chosen landmarks; any number in lanes with a new landmark.
Lanes AnonymousScan::Group::chosen_numbers(std::size_t k, int row) const {
    const Integers& chosen = chosen_[k];
    const Integers same = (chosen == chosen[0]) | (chosen < 0);
    bool together = chosen[0] >= 0;
    for (int lane = 0; lane < lanes; ++lane) together &= same[lane] != 0;
    if (together) return load(scan_.near[chosen[0]]->group(row, first_));
    Lanes value{};
    for (int lane = 0; lane < lanes; ++lane)
        if (chosen[lane] >= 0) value[lane] = scan_.near[chosen[lane]]->at(row, first_ + lane);
    return value;
}

Gaussian AnonymousScan::Group::chosen_landmark(std::size_t k) const {
    const auto at = chosen(k);
    return {at(0), at(1), at(2), at(3), at(4), at(5), at(6), at(7), at(8)};
}

void AnonymousScan::Group::write_chosen(std::size_t k, const Integers& known, int row, const Lanes& value) const {
    for (int lane = 0; lane < lanes; ++lane)
        if (known[lane]) scan_.near[chosen_[k][lane]]->at(row, first_ + lane) = value[lane];
}

Lanes AnonymousScan::Group::correct(Gaussian& belief, Weighed weighed) const {
    Lanes value{};
    for (std::size_t k = 0; k < chosen_.size(); ++k) {
        const auto known = chosen_[k] >= 0;
        if (!any(known)) continue;
        Gaussian corrected = belief;
        const Lanes of_sighting = update_pose(corrected, chosen_landmark(k), scan_.sightings[k], scan_.oriented);
        belief = select(known, corrected, belief);
        value += numbers::select(known, of_sighting, 0.0);
    }
    return weighed == Weighed::at_prediction ? value : Lanes{};
}

Lanes AnonymousScan::Group::update(const Pose& pose, Weighed weighed) const {
    Lanes value{};
    for (std::size_t k = 0; k < chosen_.size(); ++k) {
        const auto known = chosen_[k] >= 0;
        if (any(known)) {
            Gaussian landmark = chosen_landmark(k);
            const Sighting& s = scan_.sightings[k];
            const Lanes of_sighting = update_landmark(landmark, pose, s, all<Lanes>(s.variances.range), scan_.oriented);
            value += numbers::select(known, of_sighting, 0.0);
            update_known(k, landmark);
        }
        if (any(chosen_[k] < 0)) create(k, pose);
    }
    return weighed == Weighed::at_pose ? value : Lanes{};
}

void AnonymousScan::Group::update_known(std::size_t k, const Gaussian& m) const {
    const auto known = chosen_[k] >= 0;
    const Lanes rows[]{m.x, m.y, m.h, m.xx, m.xy, m.xh, m.yy, m.yh, m.hh};
    for (int row = 0; row < 9; ++row) write_chosen(k, known, row, rows[row]);
    const Lanes more = chosen_numbers(k, evidence_row) + 1.0;
    write_chosen(k, known, evidence_row, smaller(more, all<Lanes>(permanent_evidence)));
    write_chosen(k, known, last_step_row, all<Lanes>(scan_.step));
    // p(c) times P(shown k given c)
    const Confusion& confusion = *scan_.confusion;
    const Lanes total = shown_likelihood(confusion, scan_.shown[k], chosen(k));
    for (std::size_t n = 0; n < confusion.classes; ++n) {
        const int row = first_class_row + static_cast<int>(n);
        write_chosen(k, known, row, chosen_numbers(k, row) * confusion(n, scan_.shown[k]) / total);
    }
}

/// A new landmark of the particles that have chosen none.
void AnonymousScan::Group::create(std::size_t k, const Pose& pose) const {
    Blocks& rows = *scan_.fresh[k];
    write_gaussian(rows, true, first_, initial_landmark(pose, scan_.sightings[k]));
    store(rows.group(evidence_row, first_), numbers::select(chosen_[k] < 0, all<Lanes>(1.0), 0.0));
    store(rows.group(last_step_row, first_), all<Lanes>(scan_.step));
    const Confusion& confusion = *scan_.confusion;
    double total = 0.0;
    for (std::size_t n = 0; n < confusion.classes; ++n) total += confusion(n, scan_.shown[k]);
    for (std::size_t n = 0; n < confusion.classes; ++n)
        store(rows.group(first_class_row + static_cast<int>(n), first_), all<Lanes>(confusion(n, scan_.shown[k]) / total));
}

}  // namespace vmslam::particles
