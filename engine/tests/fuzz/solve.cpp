#include <algorithm>

#include "input.hpp"
#include "vmslam/solve/graph.hpp"

namespace fuzz {

using namespace vmslam;

namespace {

bool finite(std::span<const double> numbers) {
    return std::all_of(numbers.begin(), numbers.end(), [](double x) { return std::isfinite(x); });
}

/// A graph of relative poses between any nodes, which may fall into pieces.
solve::Graph relative_graph(Input& input, std::size_t nodes) {
    solve::Graph graph(static_cast<sparse::Index>(nodes));
    graph.add_anchor(0, input.place(1.0, 1.0), input.positive(1e3));
    std::vector<edges::RelativeEdge> edges;
    for (std::size_t j = 1; j < nodes; ++j)
        for (std::size_t k = input.between(0, 2); k > 0; --k) {
            const auto i = static_cast<sparse::Index>(input.one_in(3) ? input.below(j) : j - 1);
            const edges::Symmetric omega{input.positive(100.0), input.number(5.0), input.positive(100.0),
                                         input.number(5.0),     input.number(5.0), input.positive(100.0)};
            edges.push_back({i, static_cast<sparse::Index>(j), input.place(1.0, 1.0), omega});
            if (input.one_in(2)) std::swap(edges.back().i, edges.back().j);
        }
    graph.add_relative(std::move(edges), kernel(input));
    return graph;
}

}  // namespace

void fuzz_solve(Input& input) {
    const bool relative = input.one_in(3);
    const Log recorded = log(input, 40);
    const MotionNoise noise{input.positive(0.2), input.positive(0.01), input.positive(0.1), input.positive(0.2),
                            input.positive(1e-4)};
    const solve::Graph graph =
        relative ? relative_graph(input, recorded.poses()) : solve::graph_of(recorded, noise, sensor(input), kernel(input));
    solve::Run run{{.tolerance = 1e-9, .most_steps = 30}, dead_reckoning(recorded)};
    graph.solve(run, static_cast<int>(input.between(1, 2)));
    if (!run.converged) return;
    expect(finite(run.state) && finite(run.costs), "a solution is finite");
    graph.covariances(run.state);
    // a maximum or a saddle is left again: an end is never above the start, up to rounding. Where rounding of the state makes
    // more of J than J itself, as with information of 1e30, damped steps may raise J by as much
    expect(run.costs.back() <= run.costs.front() * (1 + 1e-6) + 1e-9 || graph.state_dependent ||
               run.end == solve::End::rounding_floor,
           "an end is below its start");
}

}  // namespace fuzz
