#include "vmslam/factors/landmark.hpp"

#include <utility>

namespace vmslam::factors {

using namespace edges;

namespace {

Vector residual(const PlacedSighting& a, const PlacedSighting& b) {
    const double dx = b.y.x - a.y.x, dy = b.y.y - a.y.y;
    return {a.axes.c * dx + a.axes.s * dy, -a.axes.s * dx + a.axes.c * dy, wrap(b.y.t - a.y.t)};
}

/// +-dy/d(pose) in turned axes, by a perturbation in the pose's own axes: columns along, across and turning.
struct ByPose {
    Vector column[3];

    ByPose(const PlacedSighting& s, double heading, const Rotation& axes, double sign) {
        const Rotation pose(heading);
        const double along = sign * (axes.c * pose.c + axes.s * pose.s), across = sign * (axes.s * pose.c - axes.c * pose.s);
        column[0] = {along, -across, 0.0};
        column[1] = {across, along, 0.0};
        column[2] = {sign * (axes.c * s.lever.x + axes.s * s.lever.y), sign * (axes.c * s.lever.y - axes.s * s.lever.x),
                     sign};
    }
};

/// de/da and de/db of a pair whose poses have these headings.
std::pair<ByPose, ByPose> by_poses(const PlacedSighting& p, const PlacedSighting& q, double at_p, double at_q,
                                   const Vector& e, bool turning) {
    ByPose A(p, at_p, p.axes, -1.0);
    // the axes of e turn with the first pose
    if (turning) A.column[2].x += e.y, A.column[2].y -= e.x;
    return {A, ByPose(q, at_q, p.axes, 1.0)};
}

}  // namespace

std::vector<PlacedSighting> LandmarkPairs::placed(std::span<const double> x) const {
    std::vector<PlacedSighting> out;
    for (std::size_t k = 0; k < nodes.size(); ++k) {
        const double *const pose = x.data() + 3 * nodes[k], *const seen = z.data() + k * dimension;
        const Rotation robot(pose[2]), direction(pose[2] + seen[1]);
        const double vx = seen[0] * direction.c + robot.c * offset_x - robot.s * offset_y;
        const double vy = seen[0] * direction.s + robot.s * offset_x + robot.c * offset_y;
        const double facing = dimension == 3 ? pose[2] + seen[1] - seen[2] : 0.0;
        out.push_back(
            {nodes[k], {pose[0] + vx, pose[1] + vy, facing}, {-vy, vx}, turning ? Rotation(pose[2] + ahead[k]) : Rotation()});
    }
    return out;
}

std::vector<double> LandmarkPairs::linearized(const std::array<double, 3>& first, const std::array<double, 3>& second) const {
    // relative to the first pose, so that nothing is lost far from the origin
    const double x[] = {0.0, 0.0, first[2], second[0] - first[0], second[1] - first[1], second[2]};
    const std::vector<PlacedSighting> at = placed(x);
    const Vector e = residual(at[0], at[1]);
    const auto [A, B] = by_poses(at[0], at[1], first[2], second[2], e, turning);
    std::vector<double> out;
    out.reserve(7 * dimension);
    for (const Vector& v : {e, A.column[0], A.column[1], A.column[2], B.column[0], B.column[1], B.column[2]}) {
        out.insert(out.end(), {v.x, v.y});
        if (dimension == 3) out.push_back(v.t);
    }
    return out;
}

double LandmarkPairs::cost(std::span<const double> x) const {
    const std::vector<PlacedSighting> at = placed(x);
    double total = 0.0;
    for (std::size_t k = 0; k < a.size(); ++k) {
        const Vector e = residual(at[a[k]], at[b[k]]);
        total += dot(information[k] * e, e);
    }
    return total;
}

LandmarkPairs::Sums LandmarkPairs::sums(std::span<const double> x) const {
    const std::vector<PlacedSighting> at = placed(x);
    const std::size_t size = x.size();
    Sums out{std::vector<double>(size * size, 0.0), std::vector<double>(size, 0.0)};
    for (std::size_t k = 0; k < a.size(); ++k) {
        const PlacedSighting &p = at[a[k]], &q = at[b[k]];
        const Vector e = residual(p, q), g = information[k] * e;
        const auto [A, B] = by_poses(p, q, x[3 * p.node + 2], x[3 * q.node + 2], e, turning);
        out.total += dot(g, e);
        for (int u = 0; u < 3; ++u) {
            const Index i = 3 * p.node, j = 3 * q.node;
            out.slope[i + u] += dot(A.column[u], g);
            out.slope[j + u] += dot(B.column[u], g);
            for (int v = 0; v < 3; ++v) {
                const Vector WA = information[k] * A.column[v], WB = information[k] * B.column[v];
                const double mixed = dot(A.column[u], WB);
                out.omega[(i + u) * size + i + v] += dot(A.column[u], WA);
                out.omega[(j + u) * size + j + v] += dot(B.column[u], WB);
                out.omega[(i + u) * size + j + v] += mixed;
                out.omega[(j + v) * size + i + u] += mixed;
            }
        }
    }
    return out;
}

}  // namespace vmslam::factors
