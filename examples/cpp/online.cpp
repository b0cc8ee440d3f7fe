// Graph SLAM while the robot drives: after each step, print the newest pose (x, y, heading), the minimum over all edges so far.
#include <cstdio>
#include <exception>
#include <map>

#include "log_file.hpp"
#include "vmslam/online/system.hpp"

using namespace vmslam;
using namespace vmslam::online;

int main(int argc, char** argv) try {
    if (argc != 2) {
        std::fprintf(stderr, "usage: online LOG\n");
        return 2;
    }
    const Log log = read_log(argv[1]);

    // a step ends where the next pass would lower J by less than 3e-8 of it, at the latest after 15 passes
    OnlineSystem system{3e-8, 15};
    Id pose = system.add_node();
    system.add_prior({&pose, 1}, {&log.start, 1}, {1e6, 0, 0, 0, 1e6, 0, 0, 0, 1e6}, false);
    system.solve({&pose, 1}, {}, {&pose, 1});

    std::map<std::int64_t, Id> landmarks;
    for (std::size_t t = 0; t < log.poses(); ++t) {
        const auto known = static_cast<Id>(system.graph().nodes.size());
        std::vector<NewEdge> edges;
        if (t > 0) {
            const auto [z, omega] = measured(log.controls[t - 1]);
            edges.push_back({pose, system.add_node(), Kind::motion, true, z, omega});
            pose = edges.back().ends[1];
        }
        for (const LandmarkSighting& seen : log.sightings) {
            if (seen.step != t) continue;
            if (!landmarks.contains(seen.landmark)) landmarks[seen.landmark] = system.add_node();
            const auto [z, omega] = measured(seen.z, log.oriented);
            edges.push_back({pose, landmarks[seen.landmark], Kind::sighting, log.oriented, z, omega});
        }
        if (!edges.empty() && !system.add(known, edges, {&pose, 1}))
            throw std::runtime_error("step " + std::to_string(t) + " leaves a pose or landmark undetermined");
        const Triple x = system.values({&pose, 1}).front();
        std::printf("%.12g %.12g %.12g\n", x[0], x[1], edges::wrap(x[2]));
    }
    return 0;
} catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
}
