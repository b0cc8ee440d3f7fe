#include "vmslam/gibbs/problem.hpp"

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

double cost(const Problem& problem, const Trajectory& x, const Map& m, bool exact, std::span<double> squares) {
    double total = 0.0;
    for (Number t = 0; t < problem.steps(); ++t) {
        const Motion& motion = problem.motions[t];
        total += squared(motion.information, deviation(motion.mean, relative(Frame(x[t]), x[t + 1])));
    }
    each_with_pose(x, problem.sightings, [&](const Frame& pose, const Sighting& s) {
        const Vector place = relative(pose, m[s.mark]);
        const double value =
            exact ? exact_squares(s.z, s.q, place, problem.oriented) : squared(s.weight, deviation(s.seen.mean, place));
        if (!squares.empty()) squares[&s - problem.sightings.data()] = value;
        // Student's t: (nu + n) log(1 + e' C^-1 e / nu)
        const double degrees = problem.degrees;
        total += degrees > 0 ? (degrees + problem.coordinates()) * logarithm(1.0 + value / degrees) : value;
    });
    return 0.5 * total;
}

Map draw_map(Random& random, const Trajectory& x, std::span<const Sighting> sightings, Number marks, bool oriented) {
    std::vector<Gaussian> gaussians(marks);
    each_with_pose(x, sightings,
                   [&](const Frame& pose, const Sighting& s) { fuse(gaussians[s.mark], composed(pose, s.seen), oriented); });
    Map map;
    for (const Gaussian& mark : gaussians) map.push_back(drawn(random, mark.mean, mark.S));
    return map;
}

}  // namespace vmslam::gibbs
