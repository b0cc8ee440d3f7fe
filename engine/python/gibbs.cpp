// Particle Gibbs: what is sampled, and its chains.
#include <nanobind/stl/pair.h>

#include <algorithm>
#include <atomic>

#include "arrays.hpp"
#include "bindings.hpp"
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

Problem problem_of(const In<double>& motions, const In<double>& information, const In<Index>& first, const In<Index>& marks,
                   const In<double>& y, const In<double>& C, const In<double>& weights, const In<double>& z,
                   const In<double>& q, Number landmarks, int columns, bool exact, double degrees) {
    const std::size_t T = motions.size() / 3, K = marks.size();
    require(first.size() == T + 2, "a problem needs the first sighting of every step and of the end");
    const std::span<const Index> starts = span(first);
    require(starts[0] == 0 && starts[T + 1] == Index(K) && std::is_sorted(starts.begin(), starts.end()),
            "the first sightings of the steps must ascend from 0 to the number of sightings");
    require(columns == 2 || columns == 3, "sightings have 2 or 3 columns");
    require(landmarks < (Number{1} << 31), "landmarks are numbered with 31 bits");
    Problem problem{{}, {}, {starts.begin(), starts.end()}, landmarks, columns == 3, exact, degrees};
    const std::vector<Vector> means = records<Vector>(motions, T), places = records<Vector>(y, K),
                              measured = records<Vector>(z, K);
    const std::vector<Vector> variances = records<Vector>(q, K);
    const std::vector<Symmetric> W = records<Symmetric>(information, T), spread = records<Symmetric>(C, K),
                                 weight = records<Symmetric>(weights, K);
    for (std::size_t t = 0; t < T; ++t) problem.motions.push_back({means[t], W[t]});
    for (Number t = 0; t <= T; ++t)
        for (Number k = problem.first[t]; k < problem.first[t + 1]; ++k) {
            const Index mark = marks.data()[k];
            require(mark >= 0 && mark < Index(landmarks), "a sighting names a landmark that is not there");
            problem.sightings.push_back({t, Number(mark), places[k], spread[k], weight[k], measured[k], variances[k]});
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

/// The bits of one of NumPy's bit generators, which must live as long. Its struct begins with its state and the function of
/// the next 64 bits; see `bitgen.h` of NumPy.
BitSource source_of(nb::handle generator) {
    const nb::object bits = generator.attr("capsule");
    require(PyCapsule_IsValid(bits.ptr(), "BitGenerator"), "random numbers come from a BitGenerator of NumPy");
    return *static_cast<BitSource*>(PyCapsule_GetPointer(bits.ptr(), "BitGenerator"));
}

Out<double> drawn_map(const Problem& problem, const In<double>& poses, nb::object generator) {
    Random random(source_of(generator));
    const Trajectory x = records<Vector>(poses, problem.steps() + 1);
    return rows_of(draw_map(random, x, problem.sightings, problem.marks, problem.oriented));
}

/// A chain with the generator that it keeps alive, for one thread at a time.
class SharedChain {
   public:
    SharedChain(nb::object generator, const In<double>& poses, const In<double>& guess)
        : generator_(std::move(generator)), random_(source_of(generator_)) {
        require(poses.size() >= 6 && poses.size() % 3 == 0, "a chain has at least two poses");
        chain_.poses = records<Vector>(poses, poses.size() / 3);
        set_guess(guess);
    }

    void set_guess(const In<double>& guess) {
        const Use use(busy_);
        chain_.guess = records<Vector>(guess, chain_.poses.size() - 1);
    }
    double accepted() const {
        const Use use(busy_);
        return chain_.accepted;
    }
    Out<double> poses() const {
        const Use use(busy_);
        return rows_of(chain_.poses);
    }

    nb::tuple run(const Problem& problem, const In<double>& poses, const In<double>& marks, const In<double>& rows,
                  const In<double>& deviations, Number particles, Number block, Number sweeps, int moves, bool warm_up) {
        const Use use(busy_);
        const std::size_t count = problem.steps() + 1;
        require(chain_.poses.size() == count, "the chain has another number of poses than the problem");
        require(particles >= 2 && block >= 1 && moves >= 0, "a chain needs two particles and blocks of at least one step");
        const std::size_t width = 3 * problem.steps() + (problem.oriented ? 3 : 2) * problem.marks;
        require(rows.size() == width * deviations.size(), "the directions have another width than the state");
        const Directions directions{records<Vector>(poses, count), records<Vector>(marks, problem.marks), span(rows),
                                    span(deviations)};
        ChainSamples samples;
        {
            const nb::gil_scoped_release other_threads;
            samples = chain_.run(random_, problem, directions, {particles, block, sweeps, moves, warm_up});
        }
        return nb::make_tuple(rows_of(samples.trajectories, count), rows_of(samples.maps, problem.marks));
    }

   private:
    /// The use of the chain by one thread.
    class Use {
       public:
        explicit Use(std::atomic_flag& busy) : busy_(busy) {
            if (busy_.test_and_set()) throw std::runtime_error("the chain is in use by another thread");
        }
        ~Use() { busy_.clear(); }
        Use(const Use&) = delete;

       private:
        std::atomic_flag& busy_;
    };

    nb::object generator_;
    Random random_;
    Chain chain_;
    mutable std::atomic_flag busy_;
};

/// Backward simulation with the arrays and the problem that it reads.
class SharedBackward {
   public:
    SharedBackward(In<double> poses, In<double> log_weights, const In<std::int32_t>& parents, Problem problem,
                   Number candidates)
        : poses_(std::move(poses)),
          log_weights_(std::move(log_weights)),
          parents_(copy_of(parents)),
          problem_(std::move(problem)),
          sampler_(sampler(recorded(), candidates)) {}

    nb::tuple draw(nb::object generator) const {
        Random random(source_of(generator));
        Trajectory x;
        Map m;
        {
            const nb::gil_scoped_release other_threads;
            x = sampler_.draw(random);
            m = draw_map(random, x, problem_.sightings, problem_.marks, problem_.oriented);
        }
        return nb::make_tuple(rows_of(x), rows_of(m));
    }

   private:
    RecordedParticles recorded() const {
        require(log_weights_.ndim() == 2 && log_weights_.shape(1) > 0, "log weights need a column for each particle");
        const std::size_t count = log_weights_.shape(1);
        require(log_weights_.shape(0) == problem_.steps() + 1 && parents_.size() == log_weights_.size() &&
                    poses_.size() == 3 * log_weights_.size(),
                "poses, log weights and parents must have a row for each step");
        for (const std::int32_t parent : parents_)
            require(parent >= 0 && std::size_t(parent) < count, "a parent is none of the particles");
        return {span(poses_), span(log_weights_), parents_, count};
    }

    BackwardSampler sampler(const RecordedParticles& particles, Number candidates) const {
        require(candidates > 0, "at least one particle must be considered");
        const nb::gil_scoped_release other_threads;
        return BackwardSampler(particles, problem_, candidates);
    }

    In<double> poses_, log_weights_;
    std::vector<std::int32_t> parents_;  ///< a copy, which nobody changes after the check
    Problem problem_;
    BackwardSampler sampler_;
};

void bind(nb::module_& m) {
    nb::class_<Problem>(m, "GibbsProblem")
        .def("__init__",
             [](Problem* at, In<double> motions, In<double> information, In<Index> first, In<Index> marks, In<double> y,
                In<double> C, In<double> weights, In<double> z, In<double> q, Number landmarks, int columns, bool exact,
                double degrees) {
                 new (at) Problem(
                     problem_of(motions, information, first, marks, y, C, weights, z, q, landmarks, columns, exact, degrees));
             })
        .def("cost", &cost_of)
        .def("draw_map", &drawn_map);
    nb::class_<SharedBackward>(m, "BackwardSampler")
        .def("__init__",
             [](SharedBackward* at, In<double> poses, In<double> log_weights, In<std::int32_t> parents,
                const Problem& problem, Number candidates) {
                 new (at) SharedBackward(std::move(poses), std::move(log_weights), parents, problem, candidates);
             })
        .def("draw", &SharedBackward::draw);
    nb::class_<SharedChain>(m, "GibbsChain")
        .def(nb::init<nb::object, In<double>, In<double>>())
        .def("set_guess", &SharedChain::set_guess)
        .def("run", &SharedChain::run)
        .def_prop_ro("poses", &SharedChain::poses, nb::rv_policy::move)
        .def_prop_ro("accepted", &SharedChain::accepted);
}

}  // namespace vmslam::python::gibbs_bindings
