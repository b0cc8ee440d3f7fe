#include "vmslam/gibbs/stretches.hpp"

namespace vmslam::gibbs {

LocalMap::LocalMap(const Problem& problem, std::span<const Sighting> sightings, const Trajectory& x, Number begin, Number end)
    : number(problem.marks, problem.marks) {
    const Number none = problem.marks;
    Number count = 0;
    for (const Sighting& s : seen_at(problem, sightings, begin, end))
        if (number[s.mark] == none) number[s.mark] = count++;
    before.resize(count);
    const auto absorb_all = [&](Number from, Number to) {
        Frame pose;
        Number step = x.size();
        for (const Sighting& s : seen_at(problem, sightings, from, to)) {
            if (number[s.mark] == none) continue;
            if (s.step != step) pose = Frame(x[step = s.step]);
            absorb(before[number[s.mark]], pose, s.y, s.C, problem.oriented);
        }
    };
    absorb_all(0, begin - 1);
    if (end < problem.steps()) absorb_all(end + 1, problem.steps());
}

namespace {

/// Of the next pose, with the information `next` at its place in the path, as a landmark whose sighting is the motion.
void add_next(Information& ahead, const Frame& middle, const Frame& next_middle, const Motion& motion,
              const Information& next) {
    const Vector d = relative(middle, next_middle.at);
    const Rotation axes = rotation(d.t);
    const Symmetric &W = motion.information, M = edges::turned(axes, next.L);
    const Vector pull = W * (inverse(W + M).matrix * turned(axes, next.eta));
    const Symmetric reduced = passed(W, M);
    ahead.add_at(d, reduced, pull + reduced * deviation(motion.mean, d));
}

}  // namespace

void Guide::compute(const Problem& problem, std::span<const Sighting> sightings, const LocalMap& map, Number begin,
                    const Vector* following) {
    const Number n = middle.size();
    ahead.assign(n, {});
    full.resize(n);
    for (Number i = n; i-- > 0;) {
        const Number t = begin + i;
        if (i + 1 < n) {
            add_next(ahead[i], middle[i], middle[i + 1], problem.motions[t], full[i + 1]);
        } else if (following) {
            // a known pose, whose sighting is the motion
            const Motion& motion = problem.motions[t];
            const Gaussian known{*following, {}};
            ahead[i].add_sighting(middle[i], known, motion.mean, inverse(motion.information).matrix, true);
        }
        full[i] = ahead[i];
        for (const Sighting& s : seen_at(problem, sightings, t, t)) {
            const Gaussian& mark = map.before[map.number[s.mark]];
            if (mark.seen()) full[i].add_sighting(middle[i], mark, s.y, s.C, problem.oriented);
        }
    }
}

Proposal proposal(const Frame& start, const Frame& middle, const Motion& motion, const Information& guide) {
    const Vector predicted = relative(middle, composed(start, motion.mean));
    // the prior's axes are those of the start
    const Symmetric prior = edges::turned(rotation(start.at.t - middle.at.t), motion.information);
    const Symmetric P = inverse(prior + guide.L).matrix;
    return {P * (prior * predicted + guide.eta), P};
}

}  // namespace vmslam::gibbs
