// What GTSAM's custom factors compute in the engine.
#include <nanobind/stl/array.h>
#include <nanobind/stl/pair.h>

#include <array>

#include "arrays.hpp"
#include "bindings.hpp"
#include "vmslam/factors/landmark.hpp"
#include "vmslam/factors/whitened_edges.hpp"

namespace vmslam::python::factors_bindings {

using namespace factors;

void bind_whitened(nb::module_& m) {
    nb::class_<WhitenedEdges>(m, "WhitenedEdges")
        .def("__init__",
             [](WhitenedEdges* at, In<Index> first, In<Index> second, In<Index> rows, In<double> z, In<double> root,
                In<double> frozen, In<Index> codes, In<double> widths, Index poses, bool world) {
                 const std::size_t count = first.size();
                 const auto measured = records<edges::Vector>(z, count);
                 const auto roots = records<std::array<double, 9>>(root, count);
                 std::vector<WhitenedEdge> edges;
                 for (std::size_t k = 0; k < count; ++k)
                     edges.push_back({first.data()[k],
                                      second.data()[k],
                                      static_cast<int>(rows.data()[k]),
                                      measured[k],
                                      roots[k],
                                      frozen.data()[k],
                                      {static_cast<edges::Robust>(codes.data()[k]), widths.data()[k]}});
                 new (at) WhitenedEdges(std::move(edges), poses, world);
             })
        .def("residuals", [](const WhitenedEdges& edges, In<double> x) { return array(edges.residuals(span(x))); })
        .def("linearized", [](const WhitenedEdges& edges, In<double> x) {
            auto [residuals, jacobians] = edges.linearized(span(x));
            const std::size_t nodes = x.size() / 3, rows = residuals.size();
            return std::pair(array(std::move(residuals)), array(std::move(jacobians), {nodes, 3, rows}));
        });
}

void bind_pairs(nb::module_& m) {
    nb::class_<LandmarkPairs>(m, "LandmarkPairs")
        .def("__init__",
             [](LandmarkPairs* at, In<Index> nodes, In<double> z, In<double> ahead, std::array<double, 2> offset,
                bool turning, In<Index> a, In<Index> b, In<double> information) {
                 std::vector<edges::Symmetric> omega(a.size());
                 for (std::size_t k = 0; k < omega.size(); ++k) {
                     const double* const W = information.data() + 9 * k;
                     omega[k] = {W[0], W[3], W[4], W[6], W[7], W[8]};
                 }
                 new (at) LandmarkPairs{copy_of(nodes), copy_of(z),      copy_of(ahead), static_cast<int>(z.shape(1)),
                                        offset[0],      offset[1],       turning,        copy_of(a),
                                        copy_of(b),     std::move(omega)};
             })
        // y (K, 3), the lever (K, 2), and the cosine and sine of the axes (K, 2)
        .def("placed",
             [](const LandmarkPairs& pairs, In<double> x) {
                 const std::vector<PlacedSighting> at = pairs.placed(span(x));
                 return nb::make_tuple(rows_of(at, &PlacedSighting::y), rows_of(at, &PlacedSighting::lever),
                                       rows_of(at, &PlacedSighting::axes));
             })
        // (7, d): e, and the columns of its derivatives by both poses
        .def("linearized",
             [](const LandmarkPairs& pairs, std::array<double, 3> a, std::array<double, 3> b) {
                 return array(pairs.linearized(a, b), {7, static_cast<std::size_t>(pairs.dimension)});
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
