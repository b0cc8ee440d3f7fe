// What GTSAM's custom factors compute in the engine.
#include <nanobind/stl/array.h>
#include <nanobind/stl/pair.h>

#include <algorithm>
#include <array>

#include "arrays.hpp"
#include "bindings.hpp"
#include "vmslam/factors/landmark.hpp"
#include "vmslam/factors/relative_edges.hpp"

namespace vmslam::python::factors_bindings {

using namespace factors;

void bind_whitened(nb::module_& m) {
    nb::class_<RelativeEdges>(m, "WhitenedEdges")
        .def("__init__",
             [](RelativeEdges* at, In<Place> first, In<Place> second, In<Place> rows, In<double> z, In<double> root,
                In<double> frozen, In<Place> codes, In<double> widths, Place poses, bool world) {
                 std::vector<WhitenedEdge> edges(first.size());
                 for (std::size_t k = 0; k < edges.size(); ++k) {
                     WhitenedEdge& edge = edges[k];
                     edge.i = first.data()[k], edge.j = second.data()[k], edge.rows = static_cast<int>(rows.data()[k]);
                     edge.z = {z.data()[3 * k], z.data()[3 * k + 1], z.data()[3 * k + 2]};
                     std::copy_n(root.data() + 9 * k, 9, edge.root);
                     edge.frozen = frozen.data()[k];
                     edge.kernel = {static_cast<edges::Robust>(codes.data()[k]), widths.data()[k]};
                 }
                 new (at) RelativeEdges(std::move(edges), poses, world);
             })
        .def("residuals", [](const RelativeEdges& edges, In<double> x) { return array(edges.residuals(span(x))); })
        .def("linearized", [](const RelativeEdges& edges, In<double> x) {
            auto [residuals, jacobians] = edges.linearized(span(x));
            const std::size_t nodes = x.size() / 3, rows = residuals.size();
            return std::pair(array(std::move(residuals)), array(std::move(jacobians), {nodes, 3, rows}));
        });
}

void bind_pairs(nb::module_& m) {
    nb::class_<LandmarkPairs>(m, "LandmarkPairs")
        .def("__init__",
             [](LandmarkPairs* at, In<Place> nodes, In<double> z, In<double> ahead, std::array<double, 2> offset,
                bool turning, In<Place> a, In<Place> b, In<double> information) {
                 std::vector<edges::Symmetric> omega(a.size());
                 for (std::size_t k = 0; k < omega.size(); ++k) {
                     const double* const W = information.data() + 9 * k;
                     omega[k] = {W[0], W[3], W[4], W[6], W[7], W[8]};
                 }
                 new (at) LandmarkPairs{copy_of(nodes), copy_of(z),      copy_of(ahead), static_cast<int>(z.shape(1)),
                                        offset[0],      offset[1],       turning,        copy_of(a),
                                        copy_of(b),     std::move(omega)};
             })
        // y (K, d), the lever (K, 2), and the cosine and sine of the axes (K,)
        .def("placed",
             [](const LandmarkPairs& pairs, In<double> x) {
                 std::vector<double> y, lever, c, s;
                 for (const PlacedSighting& p : pairs.placed(span(x))) {
                     y.insert(y.end(), {p.y.x, p.y.y});
                     if (pairs.dimension == 3) y.push_back(p.y.t);
                     lever.insert(lever.end(), {p.lever.x, p.lever.y});
                     c.push_back(p.axes.c);
                     s.push_back(p.axes.s);
                 }
                 const std::size_t count = c.size();
                 return nb::make_tuple(array(std::move(y), {count, static_cast<std::size_t>(pairs.dimension)}),
                                       array(std::move(lever), {count, 2}), array(std::move(c)), array(std::move(s)));
             })
        .def("cost", [](const LandmarkPairs& pairs, In<double> x) { return pairs.cost(span(x)); })
        .def("sums", [](const LandmarkPairs& pairs, In<double> x) {
            auto sums = pairs.sums(span(x));
            const std::size_t size = x.size();
            return nb::make_tuple(array(std::move(sums.omega), {size, size}), array(std::move(sums.slope)), sums.total);
        });
}

void bind(nb::module_& m) {
    bind_whitened(m);
    bind_pairs(m);
}

}  // namespace vmslam::python::factors_bindings
