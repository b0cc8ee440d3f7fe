// The engine as functions of a WebAssembly module: numbers, and places of numbers in the memory of the module.
//
// `vmslam.js` calls them. Rows are: controls (nu, omega, dt); sightings (landmark, range, bearing, orientation), in logs with
// the step in front; noise (nn, no, on, oo, epsilon, range rate, std of bearing, std of orientation).
#include <cstdlib>
#include <map>

#include "vmslam/edges/marginal.hpp"
#include "vmslam/online/system.hpp"
#include "vmslam/particles/filter.hpp"
#include "vmslam/particles/weights.hpp"
#include "vmslam/solve/graph.hpp"

#define VMSLAM_EXPORT(name) extern "C" __attribute__((export_name(#name)))

namespace {

using namespace vmslam;

/// The noise models, and whether orientations are measured.
struct Robot {
    MotionNoise motion;
    edges::Sensor sensor;
    bool oriented;

    Robot(const double* n, int oriented)
        : motion{n[0], n[1], n[2], n[3], n[4]},
          sensor{n[5] * n[5], 0.0, n[6] * n[6], n[7] * n[7], 0.0, 0.0},
          oriented(oriented != 0) {}
};

Control control_of(const double* row) { return {row[0], row[1], row[2]}; }
edges::Sighting sighting_of(const double* row) { return {row[1], row[2], row[3]}; }
std::int64_t landmark_of(const double* row) { return static_cast<std::int64_t>(row[0]); }

/// The graph of a log, with a robust kernel on the sightings and without, and its landmarks.
struct LogGraph {
    Log log;
    solve::Graph graph, plain;
    edges::MarginalEdges map;

    LogGraph(Log recorded, const Robot& robot, const edges::Kernel& kernel, const solve::LogEdges& chosen)
        : log(std::move(recorded)),
          graph(solve::graph_of(log, robot.motion, robot.sensor, kernel, chosen)),
          plain(solve::graph_of(log, robot.motion, robot.sensor, {}, chosen)),
          map(solve::by_landmark(log, robot.sensor, kernel), chosen.body) {}
};

/// Poses and landmarks of the online solver by their names.
struct Online {
    Robot robot;
    online::OnlineSystem system{3e-8, 15};
    online::Id pose;
    std::map<std::int64_t, online::Id> landmarks;

    Online(const double* start, const Robot& robot) : robot(robot), pose(system.add_node()) {
        const online::Triple first{start[0], start[1], start[2]};
        system.add_prior({&pose, 1}, {&first, 1}, {1e6, 0, 0, 0, 1e6, 0, 0, 0, 1e6}, false);
        system.solve({&pose, 1}, {}, {&pose, 1});
    }

    bool step(const double* control, const double* sightings, int count) {
        const auto known = static_cast<online::Id>(system.graph().nodes.size());
        const auto pose_before = pose;
        const auto landmarks_before = landmarks;
        std::vector<online::NewEdge> edges;
        if (control != nullptr) {
            const auto [z, omega] = measured(control_of(control), robot.motion);
            edges.push_back({{pose, system.add_node()}, online::Kind::motion, true, z, omega});
            pose = edges.back().ends[1];
        }
        for (int k = 0; k < count; ++k) {
            const auto [place, fresh] = landmarks.try_emplace(landmark_of(sightings + 4 * k), -1);
            if (fresh) place->second = system.add_node();
            const auto [z, omega] = measured(sighting_of(sightings + 4 * k), robot.oriented, robot.sensor);
            edges.push_back({{pose, place->second}, online::Kind::sighting, robot.oriented, z, omega});
        }
        if (edges.empty() || system.add(known, edges, {&pose, 1})) return true;
        pose = pose_before;
        landmarks = landmarks_before;
        return false;
    }
};

struct FastSlam {
    Robot robot;
    particles::Filter filter;

    FastSlam(const double* start, int count, const Robot& robot) : robot(robot), filter(poses(start, count), 1, false) {
        filter.use_ids(robot.oriented, 0, std::nullopt);
    }
    static particles::Rows poses(const double* start, int count) {
        particles::Rows rows(3, static_cast<std::size_t>(count));
        for (int k = 0; k < 3; ++k) std::fill_n(rows.row(k), count, start[k]);
        return rows;
    }
};

}  // namespace

VMSLAM_EXPORT(vm_allocate) double* vm_allocate(int numbers) {
    return static_cast<double*>(std::malloc(sizeof(double) * static_cast<std::size_t>(numbers)));
}
VMSLAM_EXPORT(vm_free) void vm_free(double* numbers) { std::free(numbers); }

/// The graph of a log, whose motion t consists of the controls from starts[t] on. `options`: whether orientations are
/// measured, whether motion edges are used, kernel, its width, whether the frame is the landmark's, whether edges are
/// marginal even where there are pairs. A negative number of pairs is the graph of `graph_of`, otherwise its edges are added
/// one by one.
VMSLAM_EXPORT(vm_graph)
LogGraph* vm_graph(const double* start, const double* controls, const double* starts, int poses, const double* sightings,
                   int count, const double* noise, const double* options, const double* pairs, int pair_count) {
    const Robot robot(noise, options[0] != 0);
    Log log{{start[0], start[1], start[2]}, {}, {}, robot.oriented};
    for (int t = 0; t < poses; ++t) log.starts.push_back(static_cast<std::size_t>(starts[t]));
    for (std::size_t k = 0; k < log.starts.back(); ++k) log.controls.push_back(control_of(controls + 3 * k));
    for (int k = 0; k < count; ++k) {
        const double* const row = sightings + 5 * k;
        log.sightings.push_back({static_cast<std::size_t>(row[0]), landmark_of(row + 1), sighting_of(row + 1)});
    }
    solve::LogEdges chosen{options[1] != 0, options[4] != 0, pair_count >= 0, {}};
    if (options[5] == 0 && chosen.one_by_one) chosen.virtual_motions.emplace();
    for (int k = 0; chosen.virtual_motions && k < pair_count; ++k)
        chosen.virtual_motions->push_back(
            {static_cast<std::size_t>(pairs[2 * k]), static_cast<std::size_t>(pairs[2 * k + 1])});
    const edges::Kernel kernel{static_cast<edges::Robust>(options[2]), options[3]};
    return new LogGraph(std::move(log), robot, kernel, chosen);
}
VMSLAM_EXPORT(vm_graph_free) void vm_graph_free(LogGraph* graph) { delete graph; }
/// Write the poses (T + 1, 3) that follow from the controls alone.
VMSLAM_EXPORT(vm_graph_dead_reckoning) void vm_graph_dead_reckoning(const LogGraph* graph, double* poses) {
    const std::vector<double> found = dead_reckoning(graph->log);
    std::copy(found.begin(), found.end(), poses);
}
/// Write what each member contributes to J, and e' Omega e without the kernel; returns the number of members.
VMSLAM_EXPORT(vm_graph_costs) int vm_graph_costs(const LogGraph* graph, const double* poses, double* costs, double* squares) {
    const std::span<const double> state(poses, 3 * graph->log.poses());
    const std::vector<double> robust = graph->graph.costs(state), plain = graph->plain.costs(state);
    std::copy(robust.begin(), robust.end(), costs);
    std::copy(plain.begin(), plain.end(), squares);
    return static_cast<int>(robust.size());
}
/// At most so many Gauss-Newton steps from the poses, which they replace. Write the norm of the last one and the number of
/// steps. Returns 0: not converged, 1: converged, 2: the edges do not determine the poses.
VMSLAM_EXPORT(vm_graph_solve) int vm_graph_solve(const LogGraph* graph, double* poses, int most_steps, double* summary) {
    const auto size = 3 * graph->log.poses();
    solve::Run run{{.tolerance = 1e-9, .most_steps = most_steps}, {poses, poses + size}};
    graph->graph.solve(run);
    std::copy(run.state.begin(), run.state.end(), poses);
    summary[0] = run.norms.empty() ? 0.0 : run.norms.back(), summary[1] = run.steps();
    return run.converged ? 1 : run.end == solve::End::not_determined ? 2 : 0;
}
/// Write a lower bound on the cost of all poses, the cost at these poses, and whether no poses have a lower one: J, with a
/// kernel that with its weights held.
/// Returns 0 where the edges have no constant information, so that there is no proof.
VMSLAM_EXPORT(vm_graph_proof) int vm_graph_proof(const LogGraph* graph, const double* poses, double* bound) {
    const auto found = graph->graph.lower_bound({poses, 3 * graph->log.poses()});
    if (found) bound[0] = found->lowest, bound[1] = found->cost, bound[2] = found->global;
    return found.has_value();
}
/// Write the covariances (T + 1, 3, 3) at the poses; returns 0 where the edges do not determine the poses.
VMSLAM_EXPORT(vm_graph_covariances) int vm_graph_covariances(const LogGraph* graph, const double* poses, double* blocks) {
    const std::vector<double> found = graph->graph.covariances({poses, 3 * graph->log.poses()});
    std::copy(found.begin(), found.end(), blocks);
    return !found.empty();
}
/// Write the most probable landmarks (x, y, heading) for the poses, by increasing name.
VMSLAM_EXPORT(vm_graph_map) void vm_graph_map(const LogGraph* graph, const double* poses, double* landmarks) {
    for (const edges::Vector& m : graph->map.around_means({poses, poses}).means) landmarks = std::copy_n(&m.x, 3, landmarks);
}

/// Write h^-1(x, z) (3) and R Q R' (xx, xy, yy, xt, yt, tt), where Q is the noise at a range that need not be that of z.
VMSLAM_EXPORT(vm_place)
void vm_place(const double* pose, const double* sighting, const double* noise, double noise_range, double* out) {
    const Robot robot(noise, true);
    const auto [z, omega] = measured(edges::Sighting{sighting[0], sighting[1], sighting[2]}, true, robot.sensor);
    const edges::Rotation axes(pose[2]), along(pose[2] + sighting[1]);
    edges::Sensor sensor = robot.sensor;
    sensor.range_constant = sensor.range_variance(noise_range);
    sensor.range_by_square = 0.0;
    const edges::Symmetric C = edges::landmark_covariance(sensor, sighting[0], along, true);
    const edges::Vector d = edges::turned(axes, z), place{pose[0] + d.x, pose[1] + d.y, edges::wrap(pose[2] + z.t)};
    std::copy_n(&place.x, 3, out);
    std::copy_n(&C.xx, 6, out + 3);
}
/// Write the sighting (range, bearing, orientation) of a landmark (x, y, heading) from a pose without noise.
VMSLAM_EXPORT(vm_sight) void vm_sight(const double* pose, const double* landmark, double* sighting) {
    const double dx = landmark[0] - pose[0], dy = landmark[1] - pose[1], direction = std::atan2(dy, dx);
    sighting[0] = std::hypot(dx, dy);
    sighting[1] = edges::wrap(direction - pose[2]), sighting[2] = edges::wrap(direction - landmark[2]);
}

VMSLAM_EXPORT(vm_online) Online* vm_online(const double* start, const double* noise, int oriented) {
    return new Online(start, Robot(noise, oriented));
}
VMSLAM_EXPORT(vm_online_free) void vm_online_free(Online* online) { delete online; }
/// A motion, unless `control` is null, and the sightings from the new pose. Returns 0 where these leave a pose or landmark
/// undetermined: then nothing has changed.
VMSLAM_EXPORT(vm_online_step) int vm_online_step(Online* online, const double* control, const double* sightings, int count) {
    return online->step(control, sightings, count);
}
/// Write the newest pose (3).
VMSLAM_EXPORT(vm_online_pose) void vm_online_pose(Online* online, double* pose) {
    const online::Triple x = online->system.values({&online->pose, 1}).front();
    std::copy(x.begin(), x.end(), pose);
}
/// Write a landmark (3); returns 0 if there is none of this name.
VMSLAM_EXPORT(vm_online_landmark) int vm_online_landmark(Online* online, double name, double* landmark) {
    const auto found = online->landmarks.find(static_cast<std::int64_t>(name));
    if (found == online->landmarks.end()) return 0;
    const online::Triple x = online->system.values({&found->second, 1}).front();
    std::copy(x.begin(), x.end(), landmark);
    return 1;
}

VMSLAM_EXPORT(vm_fastslam) FastSlam* vm_fastslam(const double* start, int particles, const double* noise, int oriented) {
    return new FastSlam(start, particles, Robot(noise, oriented));
}
VMSLAM_EXPORT(vm_fastslam_free) void vm_fastslam_free(FastSlam* slam) { delete slam; }
/// Every particle draws its own motion; equal keys draw equal numbers.
VMSLAM_EXPORT(vm_fastslam_move) void vm_fastslam_move(FastSlam* slam, const double* control, std::uint64_t key) {
    slam->filter.move({slam->robot.motion.of(control_of(control)), key}, true);
}
/// Weigh by sightings, and update the maps; `version` 0: FastSLAM 1.0, 1: 2.0. Returns the effective sample size; -1 if only
/// new landmarks were seen, or the sightings are impossible for all particles.
VMSLAM_EXPORT(vm_fastslam_weigh) double vm_fastslam_weigh(FastSlam* slam, const double* sightings, int count, int version) {
    std::vector<particles::LandmarkId> names;
    std::vector<particles::Sighting> seen;
    const edges::Sensor& sensor = slam->robot.sensor;
    for (int k = 0; k < count; ++k) {
        const edges::Sighting z = sighting_of(sightings + 4 * k);
        names.push_back(landmark_of(sightings + 4 * k));
        const double orientation = slam->robot.oriented ? sensor.orientation : 1.0;
        seen.push_back({{z.range, z.bearing, z.orientation}, {sensor.range_variance(z.range), sensor.bearing, orientation}});
    }
    if (!slam->filter.weigh_identified(names, seen, static_cast<particles::Version>(version))) return -1.0;
    const auto [possible, log_evidence, ess] = slam->filter.reweigh();
    return possible ? ess : -1.0;
}
/// Systematic resampling from an offset in [0, 1); write the ancestor of each particle.
VMSLAM_EXPORT(vm_fastslam_resample) void vm_fastslam_resample(FastSlam* slam, double offset, double* ancestors) {
    std::vector<double> sums(slam->filter.particles());
    const std::span<const double> weights = slam->filter.weights();
    std::partial_sum(weights.begin(), weights.end(), sums.begin());
    const auto chosen = particles::evenly_spaced(sums, offset);
    std::copy(chosen.begin(), chosen.end(), ancestors);
    slam->filter.branch(chosen);
}
VMSLAM_EXPORT(vm_fastslam_best) int vm_fastslam_best(FastSlam* slam) { return static_cast<int>(slam->filter.best()); }
/// Write the poses (3, N): all x, all y, all headings; and the log weights (N).
VMSLAM_EXPORT(vm_fastslam_particles) void vm_fastslam_particles(FastSlam* slam, double* poses, double* log_weights) {
    const auto count = static_cast<std::ptrdiff_t>(slam->filter.particles());
    for (int k = 0; k < 3; ++k) std::copy_n(slam->filter.poses()->row(k), count, poses + k * count);
    std::copy_n(slam->filter.log_weights()->row(0), count, log_weights);
}
/// Write x and y of a landmark in the map of a particle and their covariance (xx, xy, yy); returns 0 if there is none of this
/// name.
VMSLAM_EXPORT(vm_fastslam_landmark)
int vm_fastslam_landmark(FastSlam* slam, int particle, double name, double* landmark) {
    const particles::LandmarkView view = slam->filter.view(static_cast<std::int64_t>(name));
    if (!view.numbers) return 0;
    const auto [x, y, xx, xy, yy] = particles::position_rows(slam->robot.oriented);
    for (const int row : {x, y, xx, xy, yy}) *landmark++ = view.numbers->at(row, view.at(static_cast<std::size_t>(particle)));
    return 1;
}
