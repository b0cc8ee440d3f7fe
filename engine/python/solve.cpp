// Iterations on graphs of edge families, some of which may be written in Python.
#include <nanobind/stl/function.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <algorithm>

#include "arrays.hpp"
#include "bindings.hpp"
#include "vmslam/solve/graduated.hpp"
#include "vmslam/solve/grow.hpp"
#include "vmslam/solve/restarts.hpp"
#include "vmslam/solve/start.hpp"

namespace vmslam::python::solve_bindings {

using namespace solve;
using Factor = sparse::Factor<sparse::Real3>;

/// A state (n, 3) as an array of its own.
Out<double> state_array(const double* at, std::size_t size) {
    return array(std::vector<double>(at, at + size), {size / 3, 3});
}

/// A family written in Python, whose accumulate adds to a `BlockSystem`, which `make` makes of arrays; headings() and
/// positions(state) are `base.Relations`, or None. One of measurements that may be wrong is a `robust.SingleEdges`.
class PythonFamily : public edges::Family {
   public:
    PythonFamily(nb::object family, nb::object make, std::size_t size)
        : family_(std::move(family)), make_(std::move(make)), size_(size) {}
    PythonFamily(const PythonFamily&) = delete;
    PythonFamily& operator=(const PythonFamily&) = delete;
    ~PythonFamily() override {
        // those of `trusting` end while the engine runs, without Python's lock
        const nb::gil_scoped_acquire python;
        family_.reset();
        make_.reset();
        sums_.reset();
    }

    double accumulate(const edges::State& state, edges::System* system, std::span<const Index>) const override {
        const nb::gil_scoped_acquire python;
        const auto at = state_array(state.at, size_), reference = state_array(state.reference, size_);
        if (!system) return nb::cast<double>(family_.attr("accumulate")(at, reference, nb::none()));
        if (!sums_ || sums_->of != system->values) sums_.emplace(*system, make_, size_);
        std::fill_n(sums_->values.data(), sums_->values.size(), 0.0);
        std::fill_n(sums_->xi.data(), size_, 0.0);
        const double cost = nb::cast<double>(family_.attr("accumulate")(at, reference, sums_->system));
        for (std::size_t k = 0; k < sums_->values.size(); ++k) system->values[k] += sums_->values.data()[k];
        for (std::size_t k = 0; k < size_; ++k) system->xi[k] += sums_->xi.data()[k];
        return cost;
    }

    std::unique_ptr<const edges::Family> among(std::span<const Index> number) const override {
        const nb::gil_scoped_acquire python;
        nb::object part = family_.attr("renumbered")(array(std::vector(number.begin(), number.end())));
        if (part.is_none()) return nullptr;
        const auto count = std::count_if(number.begin(), number.end(), [](Index k) { return k >= 0; });
        return std::make_unique<PythonFamily>(std::move(part), make_, 3 * static_cast<std::size_t>(count));
    }

    std::size_t measurements() const override {
        const nb::gil_scoped_acquire python;
        return nb::cast<std::size_t>(family_.attr("measurements"));
    }

    std::unique_ptr<const edges::Family> trusting(std::span<const double> trust) const override {
        const nb::gil_scoped_acquire python;
        return std::make_unique<PythonFamily>(family_.attr("with_trust")(array(std::vector(trust.begin(), trust.end()))),
                                              make_, size_);
    }

    std::vector<double> squares(const double* state, std::span<const double> trust) const override {
        const nb::gil_scoped_acquire python;
        In<double> found;
        require(nb::try_cast(family_.attr("squares")(state_array(state, size_)), found) && found.size() == trust.size(),
                "squares(state) of edges that may be wrong must be one number for each measurement");
        return copy_of(found);
    }

    std::vector<edges::HeadingRelation> headings() const override {
        const nb::gil_scoped_acquire python;
        const auto relation = [](Index i, Index j, const double* value, const double* information) {
            return edges::HeadingRelation{i, j, *value, *information};
        };
        return read<edges::HeadingRelation>(family_.attr("headings")(), 1, relation);
    }

    std::vector<edges::PositionRelation> positions(const double* state) const override {
        const nb::gil_scoped_acquire python;
        const auto relation = [](Index i, Index j, const double* p, const double* W) {
            return edges::PositionRelation{i, j, p[0], p[1], W[0], (W[1] + W[2]) / 2, W[3]};
        };
        return read<edges::PositionRelation>(family_.attr("positions")(state_array(state, size_)), 2, relation);
    }

   private:
    /// Relations with values of `width` numbers, whose information has `width` rows.
    template <class Relation, class Make>
    std::vector<Relation> read(const nb::object& relations, std::size_t width, Make make) const {
        std::vector<Relation> out;
        if (relations.is_none()) return out;
        In<Index> first, second;
        In<double> value, information;
        require(nb::try_cast(relations.attr("first"), first) && nb::try_cast(relations.attr("second"), second) &&
                    nb::try_cast(relations.attr("value"), value) && nb::try_cast(relations.attr("information"), information),
                "relations consist of arrays: whole numbers of nodes, and floating-point numbers");
        const std::size_t count = first.size();
        require(second.size() == count && value.size() == count * width && information.size() == count * width * width,
                "relations have two nodes, a value and information each, and as many of all");
        for (std::size_t k = 0; k < count; ++k) {
            const Index i = first.data()[k], j = second.data()[k];
            require(std::min(i, j) >= 0 && static_cast<std::size_t>(std::max(i, j)) < size_ / 3,
                    "relations name a node that the graph lacks");
            out.push_back(make(i, j, value.data() + k * width, information.data() + k * width * width));
        }
        return out;
    }

    /// A `BlockSystem` with the pattern of a system, in memory that Python keeps as long as it is used there.
    struct Sums {
        const double* of;
        Out<double> values, xi;
        nb::object system;

        Sums(const edges::System& like, const nb::object& make, std::size_t size)
            : of(like.values),
              values(array(std::vector<double>(9 * like.rows.size()), {like.rows.size(), 3, 3})),
              xi(array(std::vector<double>(size), {size / 3, 3})),
              system(make(array(std::vector(like.start.begin(), like.start.end())),
                          array(std::vector(like.rows.begin(), like.rows.end())), values, xi)) {}
    };

    nb::object family_, make_;
    std::size_t size_;
    mutable std::optional<Sums> sums_;
};

/// A graph whose families and arrays Python owns.
class BoundGraph : public GraphObjective {
   public:
    BoundGraph(std::vector<Member> families, edges::System system, Held held, double constant, Factor& factor,
               nb::object owned)
        : GraphObjective(std::move(families), system, held, constant, factor), owned_(std::move(owned)) {}

   private:
    nb::object owned_;
};

/// An objective written in Python: linearize, cost, factorize, solve, xi and diagonal.
class PythonObjective : public Objective {
   public:
    explicit PythonObjective(nb::object object) : object_(std::move(object)) {}

    double linearize(std::span<const double> state, std::span<const double> reference) override {
        const nb::gil_scoped_acquire python;
        const double cost = nb::cast<double>(object_.attr("linearize")(whole(state), whole(reference)));
        read(object_.attr("xi"), xi_);
        return cost;
    }
    double cost(std::span<const double> state, std::span<const double> reference) override {
        const nb::gil_scoped_acquire python;
        return nb::cast<double>(object_.attr("cost")(whole(state), whole(reference)));
    }
    bool factorize(double damping) override {
        const nb::gil_scoped_acquire python;
        object_.attr("factorize")(damping);
        return true;
    }
    bool solve(std::span<double> delta) override {
        const nb::gil_scoped_acquire python;
        std::vector<double> found;
        read(object_.attr("solve")(), found);
        std::copy(found.begin(), found.end(), delta.begin());
        return true;
    }
    std::span<const double> xi() override { return xi_; }
    std::vector<double> diagonal() override {
        const nb::gil_scoped_acquire python;
        std::vector<double> out;
        read(object_.attr("diagonal")(), out);
        return out;
    }

   private:
    static Out<double> whole(std::span<const double> state) { return state_array(state.data(), state.size()); }
    static void read(nb::handle source, std::vector<double>& out) {
        const auto values = nb::cast<In<double>>(source);
        out.assign(values.data(), values.data() + values.size());
    }

    nb::object object_;
    std::vector<double> xi_;
};

/// What a search for lower states finds while other threads may use Python.
template <class Search>
std::pair<std::optional<Out<double>>, int> lowered(Search search) {
    const Lowered found = released(search);
    std::optional<Out<double>> to;
    if (found.state) to = state_array(found.state->data(), found.state->size());
    return {std::move(to), found.steps};
}

void bind_objectives(nb::module_& m) {
    nb::class_<PythonFamily, edges::Family>(m, "PythonFamily").def(nb::init<nb::object, nb::object, std::size_t>());
    nb::class_<Objective>(m, "Objective")
        .def_rw("state_dependent", &Objective::state_dependent)
        .def_rw("reweighted", &Objective::reweighted);
    nb::class_<BoundGraph, Objective>(m, "GraphObjective")
        // the tuple holds families, their pairs, the arrays of the system, what is held, and the factor
        .def("__init__", [](BoundGraph* at, nb::tuple owned, double constant) {
            std::vector<GraphObjective::Member> members;
            const nb::tuple families = owned[0], pairs = owned[1], system = owned[2], held = owned[3];
            for (std::size_t k = 0; k < families.size(); ++k)
                members.push_back({nb::cast<const edges::Family*>(families[k]), span(nb::cast<In<Index>>(pairs[k]))});
            const auto values = nb::cast<InOut<double>>(system[2]), xi = nb::cast<InOut<double>>(system[3]);
            const auto places = [](nb::handle h) { return span(nb::cast<In<Index>>(h)); };
            new (at) BoundGraph(std::move(members), {{places(system[0]), places(system[1])}, values.data(), xi.data()},
                                {places(held[0]), places(held[1])}, constant, *nb::cast<Factor*>(owned[4]), owned);
        });
    // initial values (n, 3), poses whose heading no edge measures, and a node that the edges do not tie, and one of a
    // relation that the pattern does not have, or -1
    m.def("rotation_first", [](const BoundGraph& graph, In<double> state, In<Index> held, Index poses) {
        Start start = rotation_first(graph, copy_of(state), span(held), poses);
        const std::size_t size = start.state.size();
        return std::tuple(array(std::move(start.state), {size / 3, 3}), std::move(start.unturned), start.untied,
                          start.unlisted);
    });
    // initial values (n, 3), or None where a family cannot be divided
    m.def("grow",
          [](const BoundGraph& graph, In<double> state, Index poses, Index each, In<Index> parents, In<double> offsets,
             In<Index> from) -> std::optional<Out<double>> {
              const Growth growth{poses, each, span(parents), span(offsets), span(from)};
              std::vector<double> start = copy_of(state);
              const auto grown = released([&] { return grow(graph, std::move(start), growth); });
              if (!grown) return std::nullopt;
              return state_array(grown->data(), grown->size());
          });
    m.def("most_steps_of_growth", [](Index poses, Index each) { return Growth{poses, each, {}, {}, {}}.most_steps(); });
    // from a state (n, 3): a lower one, or None where no other turn leads to one, and the number of steps
    m.def("lowered_by_turns", [](Objective& graph, In<double> state, In<double> motions, In<double> variances, double limit) {
        return lowered([&] { return lowered_by_turns(graph, span(state), {span(motions), span(variances)}, limit); });
    });
    // the same without halves of the measurements of the families with these numbers
    m.def("lowered_by_halves", [](std::vector<std::size_t> doubted, BoundGraph& graph, In<double> state, In<double> motions,
                                  In<double> variances, double limit) {
        return lowered(
            [&] { return lowered_by_halves(graph, doubted, span(state), {span(motions), span(variances)}, limit); });
    });
    nb::class_<PythonObjective, Objective>(m, "PythonObjective").def(nb::init<nb::object>());
}

void bind_runs(nb::module_& m) {
    nb::enum_<End>(m, "End")
        .value("most_steps", End::most_steps)
        .value("diverged", End::diverged)
        .value("cost_settled", End::cost_settled)
        .value("short_step", End::short_step)
        .value("small_decrease", End::small_decrease)
        .value("rounding_floor", End::rounding_floor)
        .value("no_lower_cost", End::no_lower_cost)
        .value("singular", End::singular)
        .value("not_determined", End::not_determined);
    nb::class_<Run>(m, "Run")
        .def(
            "__init__",
            [](Run* at, In<double> state, double tolerance, int most_steps, double cost_tolerance, bool descend, double kept,
               nb::object callback) {
                new (at)
                    Run{{tolerance, most_steps, cost_tolerance, descend, kept}, {state.data(), state.data() + state.size()}};
                if (callback.is_none()) return;
                // number, state, the cost before the step, and its norm
                at->observer = [callback](const Run& run) {
                    const nb::gil_scoped_acquire python;
                    callback(run.steps(), state_array(run.state.data(), run.state.size()), run.costs.back(),
                             run.norms.back());
                };
            },
            nb::arg("state"), nb::arg("tolerance"), nb::arg("most_steps"), nb::arg("cost_tolerance"), nb::arg("descend"),
            nb::arg("kept"), nb::arg("callback").none())
        .def_prop_ro(
            "state", [](const Run& run) { return state_array(run.state.data(), run.state.size()); }, nb::rv_policy::reference)
        .def_ro("costs", &Run::costs)
        .def_ro("norms", &Run::norms)
        .def_ro("converged", &Run::converged)
        .def_ro("end", &Run::end)
        .def_ro("cost_at_end", &Run::cost_at_end)
        .def_ro("damping", &Run::damping)
        .def_ro("damped_from", &Run::damped_from)
        .def_ro("curved_from", &Run::curved_from)
        .def_ro("factorizations", &Run::factorizations);
    m.def("gauss_newton", &gauss_newton, release());
    m.def("levenberg_marquardt", &levenberg_marquardt, nb::arg(), nb::arg(), nb::arg(), nb::arg() = false, release());
    nb::class_<AndersonAcceleration>(m, "AndersonAcceleration")
        .def(nb::init<>())
        .def("next", [](AndersonAcceleration& anderson, In<double> x, In<double> f) {
            const std::vector<double> next = anderson.next(span(x), span(f));
            return state_array(next.data(), next.size());
        });
    m.attr("promise") = promise;
    m.def("rounding", [](In<double> state, In<double> diagonal) { return rounding(span(state), span(diagonal)); });
}

void bind_graduation(nb::module_& m) {
    nb::class_<Graduation>(m, "Graduation")
        // doubted: (place among the families, c², edges that give their squares or None for themselves)
        .def(
            "__init__",
            [](Graduation* at, const BoundGraph& graph, nb::tuple doubted, double tolerance, int most_steps, In<double> state,
               In<double> trust) {
                std::vector<Doubted> families;
                for (const nb::handle each : doubted) {
                    const auto [member, limit, measured] =
                        nb::cast<std::tuple<std::size_t, double, std::optional<const edges::Family*>>>(each);
                    const edges::Family* own = graph.families().at(member).family;
                    families.push_back({member, own->measurements(), limit, measured.value_or(own)});
                }
                new (at) Graduation(graph, std::move(families), {tolerance, most_steps}, copy_of(state), copy_of(trust));
            },
            nb::keep_alive<1, 2>(), nb::keep_alive<1, 3>())
        .def("graduate", &Graduation::graduate, release())
        .def("settle", &Graduation::settle, release())
        .def("judge", &Graduation::judge, release())
        .def_prop_ro("truncated", &Graduation::truncated, release())
        .def_prop_ro(
            "state", [](const Graduation& at) { return state_array(at.state.data(), at.state.size()); },
            nb::rv_policy::reference)
        .def_prop_ro(
            "trust", [](const Graduation& at) { return array(at.trust); }, nb::rv_policy::reference)
        .def_ro("rounds", &Graduation::rounds)
        .def_ro("settled", &Graduation::settled)
        .def_ro("stuck", &Graduation::stuck);
    m.attr("LEAST_TRUST") = least_trust;
}

void bind(nb::module_& m) {
    bind_objectives(m);
    bind_graduation(m);
    bind_runs(m);
}

}  // namespace vmslam::python::solve_bindings
