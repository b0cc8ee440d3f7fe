// The online solver.
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <optional>
#include <stdexcept>
#include <string>

#include "arrays.hpp"
#include "bindings.hpp"
#include "vmslam/online/system.hpp"

namespace vmslam::python::online_bindings {

using namespace online;
using Numbers32 = std::vector<Id>;

/// The edges of a step.
struct NewEdges {
    std::vector<NewEdge> edges;

    /// Add those of one kind between nodes (E, 2) with measurements (E, d), information (E, d, d) and levers (E, 2) or none.
    /// `doubted` says whether a kernel acts on those that are no sightings.
    void add(Kind kind, const In<Id>& ends, const In<double>& measured, const In<double>& information,
             const std::optional<In<double>>& levers, bool doubted) {
        const std::size_t count = measured.shape(0), d = measured.ndim() == 2 ? measured.shape(1) : 0;
        require(d >= 1 && d <= 3 && has_shape(ends, {count, 2}) && has_shape(information, {count, d, d}) &&
                    (!levers || has_shape(*levers, {count, 2})),
                "the arrays of the new edges have different lengths");
        for (std::size_t e = 0; e < count; ++e) {
            const double *const z = measured.data() + d * e, *const W = information.data() + d * d * e;
            const Id* const nodes = ends.data() + 2 * e;
            NewEdge edge{{nodes[0], nodes[1]}, kind, d == 3, {}, {}, {}, doubted};
            std::copy_n(z, d, &edge.z.x);
            double* packed = &edge.omega.xx;
            for (std::size_t j = 0; j < d; ++j)
                for (std::size_t i = 0; i <= j; ++i) *packed++ = W[d * i + j];
            if (levers) edge.lever = {levers->data()[2 * e], levers->data()[2 * e + 1]};
            edges.push_back(edge);
        }
    }
};

/// The nodes, which must be nodes of the solver.
const Numbers32& checked(const OnlineSystem& s, const Numbers32& nodes) {
    const auto count = static_cast<Id>(s.graph().nodes.size());
    for (const Id node : nodes)
        if (node < 0 || node >= count) throw std::out_of_range("the online solver has no node " + std::to_string(node));
    return nodes;
}

std::vector<Triple> triples_of(const In<double>& rows) { return records<Triple>(rows, rows.size() / 3); }

void bind(nb::module_& m) {
    nb::enum_<Kind>(m, "OnlineEdge")
        .value("motion", Kind::motion)
        .value("sighting", Kind::sighting)
        .value("relation", Kind::relation)
        .value("range", Kind::range)
        .value("bearing", Kind::bearing)
        .value("position", Kind::position);
    nb::class_<NewEdges>(m, "NewEdges")
        .def(nb::init<>())
        .def("add", &NewEdges::add, nb::arg("kind"), nb::arg("ends"), nb::arg("measured"), nb::arg("information"),
             nb::arg("levers").none() = nb::none(), nb::arg("doubted") = false)
        .def("__len__", [](const NewEdges& added) { return added.edges.size(); });
    nb::class_<OnlineSystem>(m, "OnlineSystem")
        .def(nb::init<double, int>())
        .def("use_kernel", [](OnlineSystem& s, int kind, double width, double gain,
                              int rows) { s.use_kernel({static_cast<edges::Robust>(kind), width}, gain, rows); })
        .def("add_node", &OnlineSystem::add_node)
        .def("add_point", &OnlineSystem::add_point)
        .def("add_prior",
             [](OnlineSystem& s, const Numbers32& nodes, In<double> places, In<double> information, bool points,
                In<double> pivot) { s.add_prior(nodes, triples_of(places), copy_of(information), points, copy_of(pivot)); })
        .def("add",
             [](OnlineSystem& s, Id known, const NewEdges& added, const Numbers32& newest) {
                 // other threads wait: they may read this solver while it grows
                 return s.add(known, added.edges, newest);
             })
        .def("solve",
             [](OnlineSystem& s, const Numbers32& touched, const Numbers32& newest) { return s.solve(touched, {}, newest); })
        .def("solve_from",
             [](OnlineSystem& s, const Numbers32& nodes, In<double> places, const Numbers32& newest) {
                 return s.solve_from(checked(s, nodes), triples_of(places), newest);
             })
        .def("loosen", [](OnlineSystem& s, In<double> place,
                          In<double> information) { s.loosen(triples_of(place).at(0), copy_of(information)); })
        .def("relinearize", [](OnlineSystem& s, const Numbers32& newest) { s.relinearize(newest); })
        .def("marginalize", [](OnlineSystem& s, Id node, const Numbers32& newest) { return s.marginalize(node, newest); })
        .def("remove", [](OnlineSystem& s, Id landmark, const Numbers32& newest) { return s.remove(landmark, newest); })
        .def("crowded", &OnlineSystem::crowded)
        .def("renumber", &OnlineSystem::renumber)
        .def("complete", &OnlineSystem::complete)
        .def("values", [](OnlineSystem& s, const Numbers32& nodes) { return rows_of(s.values(checked(s, nodes))); })
        // the values of nodes as the last step left them
        .def("places",
             [](const OnlineSystem& s, const Numbers32& nodes) { return rows_of(s.graph().values(checked(s, nodes))); })
        // e' W e of edges as the last step left them, without their kernel
        .def("squares",
             [](const OnlineSystem& s, std::size_t first, std::size_t count) {
                 require(first + count <= s.graph().edges.size(), "the online solver has fewer edges");
                 std::vector<double> found;
                 for (std::size_t e = first; e < first + count; ++e) found.push_back(s.graph().edges[e].squares);
                 return found;
             })
        .def("cost", &OnlineSystem::cost)
        .def("cost_with_priors", &OnlineSystem::cost_with_priors)
        .def("covariance",
             [](OnlineSystem& s, const Numbers32& nodes, const Numbers32& newest) -> nb::object {
                 auto found = s.covariance(checked(s, nodes), checked(s, newest));
                 if (!found) return nb::none();
                 return nb::cast(array(std::move(*found), {3 * nodes.size(), 3 * nodes.size()}));
             })
        .def_prop_ro("num_nodes", [](const OnlineSystem& s) { return s.graph().nodes.size(); })
        .def_prop_ro("num_edges", [](const OnlineSystem& s) { return s.graph().edges.size(); })
        .def_prop_ro("num_priors", &OnlineSystem::priors)
        .def_prop_ro("bytes", &OnlineSystem::bytes)
        .def_ro("passes", &OnlineSystem::passes)
        .def_ro("converged", &OnlineSystem::converged)
        .def_ro("batch_solutions", &OnlineSystem::batch_solutions)
        // the smallest ratio of a pivot to its diagonal entry; tests make eliminations fail with it
        .def_prop_rw(
            "pivot_tolerance", [](OnlineSystem& s) { return s.tree().pivot_tolerance; },
            [](OnlineSystem& s, double value) { s.tree().pivot_tolerance = value; })
        .def("__deepcopy__", [](const OnlineSystem& s, nb::handle) { return OnlineSystem(s); })
        .def("__getstate__",
             [](OnlineSystem& s) {
                 const std::string bytes = s.save();
                 return nb::bytes(bytes.data(), bytes.size());
             })
        .def("__setstate__", [](OnlineSystem& s, nb::bytes state) {
            new (&s) OnlineSystem(0.0, 0);
            if (!s.restore({state.c_str(), state.size()}))
                throw std::invalid_argument(
                    "the bytes are damaged, or no saved online solver of this version; save it again");
        });
}

}  // namespace vmslam::python::online_bindings
