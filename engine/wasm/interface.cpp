// The engine as functions of a WebAssembly module: numbers, and places of numbers in the memory of the module.
//
// `vmslam.js` calls them. Rows are: controls (nu, omega, dt); sightings (landmark, range, bearing, orientation), in logs with the
// step in front; noise (nn, no, on, oo, epsilon, range rate, std of bearing, std of orientation).
#include <cstdlib>
#include <map>
#include <numeric>

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

/// Poses and landmarks of the online solver by their names.
struct Online {
    Robot robot;
    online::OnlineSystem system{1e-7, 15};
    online::Number pose;
    std::map<std::int64_t, online::Number> landmarks;

    Online(const double* start, const Robot& robot) : robot(robot), pose(system.add_node()) {
        const online::Triple first{start[0], start[1], start[2]};
        system.add_prior({&pose, 1}, {&first, 1}, {1e6, 0, 0, 0, 1e6, 0, 0, 0, 1e6}, false);
        system.solve({&pose, 1}, {}, {&pose, 1});
    }

    bool step(const double* control, const double* sightings, int count) {
        const auto known = static_cast<online::Number>(system.graph().nodes.size());
        const auto pose_before = pose;
        const auto landmarks_before = landmarks;
        std::vector<online::NewEdge> edges;
        if (control != nullptr) {
            const auto [z, omega] = measured(control_of(control), robot.motion);
            edges.push_back({pose, system.add_node(), online::Kind::motion, true, z, omega});
            pose = edges.back().second;
        }
        for (int k = 0; k < count; ++k) {
            const auto [place, fresh] = landmarks.try_emplace(landmark_of(sightings + 4 * k), -1);
            if (fresh) place->second = system.add_node();
            const auto [z, omega] = measured(sighting_of(sightings + 4 * k), robot.oriented, robot.sensor);
            edges.push_back({pose, place->second, online::Kind::sighting, robot.oriented, z, omega});
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

/// Write the poses (motions + 1, 3) of the graph of a log, J and the number of steps; returns whether they converged.
VMSLAM_EXPORT(vm_solve)
int vm_solve(const double* start, const double* controls, int motions, const double* sightings, int count,
             const double* noise, int oriented, double* poses, double* summary) {
    const Robot robot(noise, oriented);
    Log log{{start[0], start[1], start[2]}, {}, {}, robot.oriented};
    for (int t = 0; t < motions; ++t) log.controls.push_back(control_of(controls + 3 * t));
    for (int k = 0; k < count; ++k) {
        const double* const row = sightings + 5 * k;
        log.sightings.push_back({static_cast<std::size_t>(row[0]), landmark_of(row + 1), sighting_of(row + 1)});
    }
    solve::Run run{{.tolerance = 1e-9}, dead_reckoning(log)};
    solve::graph_of(log, robot.motion, robot.sensor).solve(run);
    std::copy(run.state.begin(), run.state.end(), poses);
    summary[0] = run.costs.back(), summary[1] = run.steps();
    return run.converged;
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
/// Weigh by sightings, and update the maps; `version` 0: FastSLAM 1.0, 1: 2.0. Returns the effective sample size; -1 if only new
/// landmarks were seen, or the sightings are impossible for all particles.
VMSLAM_EXPORT(vm_fastslam_weigh) double vm_fastslam_weigh(FastSlam* slam, const double* sightings, int count, int version) {
    std::vector<particles::LandmarkId> names;
    std::vector<particles::Sighting> seen;
    const edges::Sensor& sensor = slam->robot.sensor;
    for (int k = 0; k < count; ++k) {
        const edges::Sighting z = sighting_of(sightings + 4 * k);
        names.push_back(landmark_of(sightings + 4 * k));
        const double orientation = slam->robot.oriented ? sensor.orientation : 1.0;
        seen.push_back({{z.range, z.bearing, z.orientation}, {sensor.range(z.range), sensor.bearing, orientation}});
    }
    if (!slam->filter.weigh_identified(names, seen, static_cast<particles::Version>(version))) return -1.0;
    const auto [possible, log_evidence, ess] = slam->filter.reweigh();
    return possible ? ess : -1.0;
}
/// Systematic resampling from an offset in [0, 1).
VMSLAM_EXPORT(vm_fastslam_resample) void vm_fastslam_resample(FastSlam* slam, double offset) {
    std::vector<double> sums(slam->filter.particles());
    const std::span<const double> weights = slam->filter.weights();
    std::partial_sum(weights.begin(), weights.end(), sums.begin());
    slam->filter.branch(particles::evenly_spaced(sums, offset));
}
VMSLAM_EXPORT(vm_fastslam_best) int vm_fastslam_best(FastSlam* slam) { return static_cast<int>(slam->filter.best()); }
/// Write the poses (3, N): all x, all y, all headings; and the log weights (N).
VMSLAM_EXPORT(vm_fastslam_particles) void vm_fastslam_particles(FastSlam* slam, double* poses, double* log_weights) {
    const auto count = static_cast<std::ptrdiff_t>(slam->filter.particles());
    for (int k = 0; k < 3; ++k) std::copy_n(slam->filter.poses()->row(k), count, poses + k * count);
    std::copy_n(slam->filter.log_weights()->row(0), count, log_weights);
}
/// Write x and y of a landmark in the map of a particle; returns 0 if there is none of this name.
VMSLAM_EXPORT(vm_fastslam_landmark)
int vm_fastslam_landmark(FastSlam* slam, int particle, double name, double* landmark) {
    particles::IdentifiedMap& map = *slam->filter.identified();
    if (!map.has(static_cast<std::int64_t>(name))) return 0;
    const auto [numbers, ancestors] = map.view(static_cast<std::int64_t>(name));
    const auto at = static_cast<std::size_t>(ancestors ? ancestors[particle] : particle);
    landmark[0] = numbers->at(0, at), landmark[1] = numbers->at(1, at);
    return 1;
}
