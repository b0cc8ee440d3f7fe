// Graph SLAM: read a log, solve, and print the poses (x, y, heading) of all steps.
#include <cmath>
#include <cstdio>
#include <exception>

#include "log_file.hpp"
#include "vmslam/solve/graph.hpp"

using namespace vmslam;

int main(int argc, char** argv) try {
    if (argc != 2) {
        std::fprintf(stderr, "usage: solve LOG\n");
        return 2;
    }
    const Log log = read_log(argv[1]);

    // an anchor, a motion edge for each control, and an edge between all poses that saw the same landmark
    const solve::Graph graph = solve::graph_of(log);
    solve::Run run{{.tolerance = 1e-9}, dead_reckoning(log)};
    graph.solve(run);

    std::fprintf(stderr, "J = %.6g after %d steps%s: %s\n", run.costs.empty() ? NAN : run.costs.back(), run.steps(),
                 run.converged ? "" : ", not converged", solve::describe(run.end));
    if (const auto bound = graph.lower_bound(run.state))
        std::fprintf(stderr, "no state has a J below %.6g: %s\n", bound->lowest,
                     bound->global ? "this is the global minimum" : "there may be a lower minimum");
    for (std::size_t t = 0; t < log.poses(); ++t)
        std::printf("%.12g %.12g %.12g\n", run.state[3 * t], run.state[3 * t + 1], edges::wrap(run.state[3 * t + 2]));
    return run.converged ? 0 : 1;
} catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
}
