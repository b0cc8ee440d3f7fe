#include "vmslam/gibbs/bends.hpp"

#include <algorithm>
#include <cstring>

#include "vmslam/gibbs/exact.hpp"

namespace vmslam::gibbs {
namespace {

/// a' b in eight sums, always the same ones.
double product(const double* a, const double* b, std::size_t size) {
    numbers::Lanes sums{}, p, q;
    std::size_t i = 0;
    for (; i + numbers::lanes <= size; i += numbers::lanes) {
        std::memcpy(&p, a + i, sizeof p);
        std::memcpy(&q, b + i, sizeof q);
        sums += p * q;
    }
    double sum = 0.0;
    for (int k = 0; k < numbers::lanes; ++k) sum += sums[k];
    for (; i < size; ++i) sum += a[i] * b[i];
    return sum;
}

double square(std::span<const double> a) { return product(a.data(), a.data(), a.size()); }

}  // namespace

double cost(const Problem& problem, const Trajectory& x, const Map& m, bool exact, std::span<double> squares) {
    double total = 0.0;
    for (Number t = 0; t < problem.steps(); ++t) {
        const Motion& motion = problem.motions[t];
        total += squared(motion.information, deviation(motion.mean, relative(Frame(x[t]), x[t + 1])));
    }
    Frame pose;
    Number step = x.size();
    for (std::size_t k = 0; k < problem.sightings.size(); ++k) {
        const Sighting& s = problem.sightings[k];
        if (s.step != step) pose = Frame(x[step = s.step]);
        const Vector place = relative(pose, m[s.mark]);
        const double value =
            exact ? exact_squares(s.z, s.q, place, problem.oriented) : squared(s.weight, deviation(s.y, place));
        if (!squares.empty()) squares[k] = value;
        // Student's t: (nu + n) log(1 + e' C^-1 e / nu)
        const double degrees = problem.degrees;
        total += degrees > 0 ? (degrees + problem.coordinates()) * logarithm(1.0 + value / degrees) : value;
    }
    return 0.5 * total;
}

Bends::Bends(const Problem& problem, const Directions& directions, Trajectory& x, Map& m)
    : problem_(problem), directions_(directions), x_(x), m_(m), away_(difference()), a_(directions.deviations.size()) {
    // a = V' (state - mode) / d
    for (std::size_t k = 0; k < a_.size(); ++k)
        a_[k] = product(directions.rows.data() + k * width(), away_.data(), width()) / directions.deviations[k];
}

int Bends::move(Random& random, double step, int moves) {
    const double stay = std::sqrt(1.0 - step * step);
    double value = cost(problem_, x_, m_, problem_.exact, {}) - 0.5 * square(a_);
    std::vector<double> proposed(a_.size()), moved(width()), reached(width());
    int accepted = 0;
    for (int k = 0; k < moves; ++k) {
        std::fill(moved.begin(), moved.end(), 0.0);
        for (std::size_t i = 0; i < a_.size(); ++i) {
            // a' = sqrt(1 - b²) a + b n, and the state moves by V d (a' - a)
            proposed[i] = stay * a_[i] + step * random.normal();
            const double along = directions_.deviations[i] * (proposed[i] - a_[i]);
            const double* const direction = directions_.rows.data() + i * width();
            for (std::size_t j = 0; j < moved.size(); ++j) moved[j] += along * direction[j];
        }
        for (std::size_t j = 0; j < moved.size(); ++j) reached[j] = away_[j] + moved[j];
        // half a turn from the mode, the way back would begin at other coordinates: such moves are rejected
        if (beyond_half_a_turn(reached)) continue;
        Trajectory x = x_;
        Map m = m_;
        displace(x, m, moved);
        const double excess = cost(problem_, x, m, problem_.exact, {}) - 0.5 * square(proposed);
        if (!(logarithm(random.uniform()) < value - excess)) continue;
        x_ = std::move(x), m_ = std::move(m);
        std::swap(away_, reached), std::swap(a_, proposed);
        value = excess;
        ++accepted;
    }
    return accepted;
}

/// The state less the mode.
std::vector<double> Bends::difference() const {
    std::vector<double> out;
    out.reserve(3 * x_.size() + each() * m_.size());
    for (Number t = 1; t < x_.size(); ++t) {
        const Vector d = deviation(directions_.poses[t], x_[t]);
        out.insert(out.end(), {d.x, d.y, d.t});
    }
    for (Number j = 0; j < m_.size(); ++j) {
        const Vector d = deviation(directions_.marks[j], m_[j]);
        out.insert(out.end(), {d.x, d.y});
        if (problem_.oriented) out.push_back(d.t);
    }
    return out;
}

bool Bends::beyond_half_a_turn(std::span<const double> away) const {
    const std::size_t end = problem_.oriented ? away.size() : 3 * problem_.steps();
    for (std::size_t i = 2; i < end; i += 3)
        if (std::abs(away[i]) > numbers::pi) return true;
    return false;
}

void Bends::displace(Trajectory& x, Map& m, std::span<const double> step) const {
    const double* at = step.data();
    for (Number t = 1; t < x.size(); ++t, at += 3) x[t] = {x[t].x + at[0], x[t].y + at[1], wrap_angle(x[t].t + at[2])};
    for (Vector& mark : m) {
        mark.x += at[0], mark.y += at[1];
        if (problem_.oriented) mark.t = wrap_angle(mark.t + at[2]);
        at += each();
    }
}

}  // namespace vmslam::gibbs
