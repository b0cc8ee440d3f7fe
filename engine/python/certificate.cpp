// The function below J at a candidate state, and the steps around the factorisation of its matrix.
#include <nanobind/stl/complex.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/tuple.h>

#include <tuple>

#include "arrays.hpp"
#include "bindings.hpp"
#include "vmslam/certificate/minorant.hpp"
#include "vmslam/certificate/proof.hpp"

namespace vmslam::python::certificate_bindings {

using namespace certificate;
using sparse::Node;
using Complexes = std::complex<double>;
using release = nb::call_guard<nb::gil_scoped_release>;

/// Edges at a candidate state, whose arrays the object keeps.
class Candidate {
   public:
    Candidate(In<double> state, In<Place> first, In<Place> second, In<double> start, In<double> end, In<double> turn,
              In<bool> oriented, In<double> information)
        : state_(std::move(state)),
          first_(std::move(first)),
          second_(std::move(second)),
          start_(std::move(start)),
          end_(std::move(end)),
          turn_(std::move(turn)),
          oriented_(std::move(oriented)),
          information_(std::move(information)),
          edges_{span(first_), span(second_), span(start_), span(end_), span(turn_), span(oriented_), span(information_)},
          forces_(certificate::forces(span(state_), edges_)) {}

    const Edges& edges() const { return edges_; }
    std::span<const double> state() const { return span(state_); }
    const std::vector<Force>& forces() const { return forces_; }

    template <class T, class Value>
    Out<T> each(Value value) const {
        std::vector<T> out(forces_.size());
        for (std::size_t e = 0; e < out.size(); ++e) out[e] = value(forces_[e]);
        return array(std::move(out));
    }

   private:
    In<double> state_;
    In<Place> first_, second_;
    In<double> start_, end_, turn_;
    In<bool> oriented_;
    In<double> information_;
    Edges edges_;
    std::vector<Force> forces_;
};

Out<bool> booleans(const std::vector<Force>& forces) {
    auto* const owned = new bool[forces.size()];
    for (std::size_t e = 0; e < forces.size(); ++e) owned[e] = forces[e].zero;
    return Out<bool>(owned, {forces.size()}, nb::capsule(owned, [](void* p) noexcept { delete[] static_cast<bool*>(p); }));
}

void bind_candidate(nb::module_& m) {
    nb::class_<Candidate>(m, "Candidate")
        .def(nb::init<In<double>, In<Place>, In<Place>, In<double>, In<double>, In<double>, In<bool>, In<double>>())
        .def_prop_ro(
            "cost", [](const Candidate& c) { return c.each<double>([](const Force& f) { return f.cost; }); },
            nb::rv_policy::move)
        .def_prop_ro(
            "reached",
            [](const Candidate& c) { return c.each<Complexes>([](const Force& f) { return Complexes(f.reached); }); },
            nb::rv_policy::move)
        .def_prop_ro(
            "zero", [](const Candidate& c) { return booleans(c.forces()); }, nb::rv_policy::move)
        // beta, A, error and slack of each edge
        .def("curvature",
             [](const Candidate& c, double share) {
                 std::vector<double> beta, A, error, slack;
                 for (const Curvature& curve : curvatures(c.edges(), c.forces(), share)) {
                     beta.push_back(curve.beta);
                     A.push_back(curve.A);
                     error.push_back(curve.error);
                     slack.push_back(curve.slack);
                 }
                 return std::tuple(array(std::move(beta)), array(std::move(A)), array(std::move(error)),
                                   array(std::move(slack)));
             })
        .def("minorant",
             [](const Candidate& c, In<bool> free, In<Place> start, In<Place> rows, In<double> beta, In<double> A,
                In<double> error, In<double> slack) {
                 std::vector<Curvature> curves(c.forces().size());
                 for (std::size_t e = 0; e < curves.size(); ++e)
                     curves[e] = {beta.data()[e], A.data()[e], error.data()[e], slack.data()[e]};
                 Minorant f = minorant(c.state(), c.edges(), span(free), span(start), span(rows), c.forces(), curves);
                 const std::size_t nodes = free.size();
                 return std::tuple(array(std::move(f.values), {rows.size(), 2, 2}), array(std::move(f.gradient), {nodes, 2}),
                                   array(std::move(f.scale), {nodes, 2}), array(std::move(f.error), {nodes, 2}), f.touched,
                                   f.slack);
             })
        .def("strains", [](const Candidate& c, In<Complexes> x) {
            std::vector<Complex> reached;
            for (const Force& f : c.forces()) reached.push_back(f.reached);
            Strains s = strains(c.state(), c.edges(), reached, span(x));
            return std::pair(array(std::move(s.stretched)), array(std::move(s.turned)));
        });
}

void bind_proof(nb::module_& m) {
    // beta and kappa of one edge
    m.def("split_information", [](In<double> w, double share) {
        const Split s = split(w.data(), share);
        return std::pair(s.beta, s.kappa);
    });
    m.def("take_upper", [](In<double> matrices, InOut<double> rows, double tolerance) {
        return take_upper(span(matrices), static_cast<Place>(matrices.shape(0)), static_cast<int>(matrices.shape(1)),
                          tolerance, span(rows));
    });
    m.def("hold_roots", [](In<Place> first, In<Place> second, InOut<bool> free) {
        return array(hold_roots(span(first), span(second), span(free)));
    });
    m.def("margins", [](In<double> scale, In<double> shifts, In<double> summation, In<double> rounding, In<Node> order) {
        Margins out = margins(span(scale), span(shifts), span(summation), span(rounding), span(order));
        const std::size_t nodes = shifts.size();
        return std::pair(array(std::move(out.assembled), {nodes, 2}), array(std::move(out.margin), {nodes, 2}));
    });
    m.def("changed", [](In<Complexes> values, In<Place> start, In<double> scale, In<double> shifts, In<double> assembled,
                        In<double> margin) {
        const std::size_t blocks = values.size() / 4;
        return array(changed(span(values), span(start), span(scale), span(shifts), span(assembled), span(margin)),
                     {blocks, 2, 2});
    });
}

void bind(nb::module_& m) {
    bind_candidate(m);
    bind_proof(m);
}

}  // namespace vmslam::python::certificate_bindings
