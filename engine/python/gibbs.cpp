// Particle Gibbs: what is sampled, and its chains.
#include <nanobind/stl/pair.h>
#include <nanobind/stl/unique_ptr.h>

#include <algorithm>

#include "bindings.hpp"
#include "shared_filter.hpp"
#include "vmslam/gibbs/backward.hpp"
#include "vmslam/gibbs/chain.hpp"

namespace vmslam::python::gibbs_bindings {

using namespace gibbs;
using Index = std::int64_t;
using python::rows_of;

/// The vectors of samples, (S, n, 3).
Out<double> rows_of(const std::vector<std::vector<Vector>>& samples, std::size_t rows) {
    std::vector<Vector> flat;
    for (const std::vector<Vector>& sample : samples) flat.insert(flat.end(), sample.begin(), sample.end());
    return array<double>(std::move(flat), {samples.size(), rows, 3});
}

/// Motions (T, 9) and sightings (K, 21) are rows of the numbers of `Motion` and `Seen`; `marks` (K,) the landmarks of these.
Problem problem_of(const In<double>& motions, const In<Index>& first, const In<Index>& marks, const In<double>& sightings,
                   Number landmarks, int columns, bool exact, double degrees) {
    const std::size_t T = motions.size() / width<Motion>, K = marks.size();
    require(first.size() == T + 2, "a problem needs the first sighting of every step and of the end");
    const std::span<const Index> starts = span(first);
    require(starts[0] == 0 && starts[T + 1] == Index(K) && std::is_sorted(starts.begin(), starts.end()),
            "the first sightings of the steps must ascend from 0 to the number of sightings");
    require(columns == 2 || columns == 3, "sightings have 2 or 3 columns");
    require(landmarks < (Number{1} << 31), "landmarks are numbered with 31 bits");
    Problem problem{records<Motion>(motions, T), {}, {starts.begin(), starts.end()}, landmarks, columns == 3, exact, degrees};
    const std::vector<Seen> seen = records<Seen>(sightings, K);
    for (Number t = 0; t <= T; ++t)
        for (Number k = problem.first[t]; k < problem.first[t + 1]; ++k) {
            const Index mark = marks.data()[k];
            require(mark >= 0 && mark < Index(landmarks), "a sighting names a landmark that is not there");
            problem.sightings.push_back({seen[k], t, Number(mark)});
        }
    return problem;
}

/// The cost and e' C^-1 e (K,) of the sightings.
std::pair<double, Out<double>> cost_of(const Problem& problem, const In<double>& poses, const In<double>& marks, bool exact) {
    const Trajectory x = records<Vector>(poses, problem.steps() + 1);
    const Map m = records<Vector>(marks, problem.marks);
    std::vector<double> squares(problem.sightings.size());
    const double value = cost(problem, x, m, exact, squares);
    return {value, array(std::move(squares))};
}

Out<double> drawn_map(const Problem& problem, const In<double>& poses, std::uint64_t key) {
    Random random(key);
    const Trajectory x = records<Vector>(poses, problem.steps() + 1);
    return rows_of(draw_map(random, x, problem.sightings, problem.marks, problem.oriented));
}

class SharedChain {
   public:
    SharedChain(std::uint64_t key, const In<double>& poses, const In<double>& guess) : random_(key) {
        require(poses.size() >= 6 && poses.size() % 3 == 0, "a chain has at least two poses");
        chain_.poses = records<Vector>(poses, poses.size() / 3);
        set_guess(guess);
    }

    void set_guess(const In<double>& guess) {
        const auto lock = use();
        chain_.guess = records<Vector>(guess, chain_.poses.size() - 1);
    }
    double accepted() const {
        const auto lock = use();
        return chain_.accepted;
    }
    Out<double> poses() const {
        const auto lock = use();
        return rows_of(chain_.poses);
    }

    nb::tuple run(const Problem& problem, const In<double>& poses, const In<double>& marks, const In<double>& rows,
                  const In<double>& deviations, Number particles, Number block, Number sweeps, int moves, bool warm_up) {
        const auto lock = use();
        const std::size_t count = problem.steps() + 1;
        require(chain_.poses.size() == count, "the chain has another number of poses than the problem");
        require(particles >= 2 && block >= 1 && moves >= 0, "a chain needs two particles and blocks of at least one step");
        const std::size_t width = 3 * problem.steps() + (problem.oriented ? 3 : 2) * problem.marks;
        require(rows.size() == width * deviations.size(), "the directions have another width than the state");
        const Directions directions{records<Vector>(poses, count), records<Vector>(marks, problem.marks), span(rows),
                                    span(deviations)};
        const ChainRules rules{particles, block, sweeps, moves, warm_up};
        const ChainSamples samples = released([&] { return chain_.run(random_, problem, directions, rules); });
        return nb::make_tuple(rows_of(samples.trajectories, count), rows_of(samples.maps, problem.marks));
    }

   private:
    /// The chain is used by one thread at a time.
    std::unique_lock<std::mutex> use() const {
        std::unique_lock lock(busy_, std::try_to_lock);
        if (!lock) throw std::runtime_error("the chain is in use by another thread");
        return lock;
    }

    Random random_;
    Chain chain_;
    mutable std::mutex busy_;
};

/// A sampler of the particles of all steps of a filter that keeps a record.
std::unique_ptr<BackwardSampler> sampler_of(SharedFilter& shared, const Problem& problem, Number candidates) {
    return shared.with([&](const particles::Filter& f) {
        require(f.record().has_value(), "a filter that keeps a record");
        return std::make_unique<BackwardSampler>(*f.record(), problem, candidates);
    });
}

nb::tuple draw_backwards(const BackwardSampler& sampler, std::uint64_t key) {
    Random random(key);
    const auto [path, map] = released([&] { return sampler.draw(random); });
    return nb::make_tuple(rows_of(path), rows_of(map));
}

void bind(nb::module_& m) {
    nb::class_<Problem>(m, "GibbsProblem").def(nb::new_(&problem_of)).def("cost", &cost_of).def("draw_map", &drawn_map);
    nb::class_<BackwardSampler>(m, "BackwardSampler").def(nb::new_(&sampler_of)).def("draw", &draw_backwards);
    nb::class_<SharedChain>(m, "GibbsChain")
        .def(nb::init<std::uint64_t, In<double>, In<double>>())
        .def("set_guess", &SharedChain::set_guess)
        .def("run", &SharedChain::run)
        .def_prop_ro("poses", &SharedChain::poses, nb::rv_policy::reference)
        .def_prop_ro("accepted", &SharedChain::accepted);
}

}  // namespace vmslam::python::gibbs_bindings
