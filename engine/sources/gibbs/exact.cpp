#include "vmslam/gibbs/exact.hpp"

namespace vmslam::gibbs {

double exact_squares(const Vector& z, const Vector& q, const Vector& place, bool oriented) {
    // h = (|q|, atan2 q, atan2 q - q_h)
    const double bearing = numbers::atan2(place.y, place.x);
    const double range_error = z.x - std::sqrt(place.x * place.x + place.y * place.y),
                 bearing_error = wrap_angle(z.y - bearing);
    double squares = range_error * range_error / q.x + bearing_error * bearing_error / q.y;
    if (!oriented) return squares;
    const double error = wrap_angle(z.t - bearing + place.t);
    return squares + error * error / q.t;
}

Map draw_map(Random& random, const Trajectory& x, std::span<const Sighting> sightings, Number marks, bool oriented) {
    std::vector<Gaussian> gaussians(marks);
    Frame pose;
    Number step = x.size();
    for (const Sighting& s : sightings) {
        // the sightings of a step follow each other
        if (s.step != step) pose = Frame(x[step = s.step]);
        absorb(gaussians[s.mark], pose, s.y, s.C, oriented);
    }
    Map map;
    map.reserve(marks);
    for (const Gaussian& mark : gaussians) map.push_back(drawn(random, mark.mean, mark.S));
    return map;
}

double log_ratio(const Trajectory& x, const Map& m, std::span<const Sighting> sightings, bool oriented) {
    double total = 0.0;
    for (const Sighting& s : sightings) {
        const Vector place = relative(Frame(x[s.step]), m[s.mark]);
        Vector r = deviation(s.y, place);
        if (!oriented) r.t = 0.0;
        total -= 0.5 * (exact_squares(s.z, s.q, place, oriented) - squared(inverse(s.C).matrix, r));
    }
    return total;
}

bool Correction::accepts(Random& random, const Trajectory& trial, std::span<const Sighting> sightings, bool oriented) {
    Map candidate = draw_map(random, trial, sightings, map.size(), oriented);
    const double value = log_ratio(trial, candidate, sightings, oriented);
    if (logarithm(random.uniform()) >= value - log_weight) return false;
    map = std::move(candidate);
    log_weight = value;
    return true;
}

}  // namespace vmslam::gibbs
