// Edge families and robust kernels.
#include <nanobind/stl/array.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/tuple.h>

#include <algorithm>
#include <bit>

#include "arrays.hpp"
#include "bindings.hpp"
#include "vmslam/edges/inverses.hpp"
#include "vmslam/edges/linearized.hpp"
#include "vmslam/edges/marginal.hpp"
#include "vmslam/edges/polar.hpp"
#include "vmslam/edges/relative.hpp"
#include "vmslam/edges/single_numbers.hpp"
#include "vmslam/edges/virtual_motion.hpp"
#include "vmslam/log.hpp"

namespace vmslam::python::edges_bindings {

using namespace edges;

/// The symmetric part of matrices (d, d), on which alone the cost depends.
Symmetric symmetric(const double* W, int d) {
    const auto both = [&](int r, int c) { return (W[r * d + c] + W[c * d + r]) / 2; };
    if (d == 2) return {W[0], both(0, 1), W[3], 0.0, 0.0, 0.0};
    return {W[0], both(0, 1), W[4], both(0, 2), both(1, 2), W[8]};
}

std::vector<RelativeEdge> relative_edges(const In<Index>& first, const In<Index>& second, const In<double>& measured,
                                         const In<double>& information) {
    const int d = static_cast<int>(measured.shape(1));
    const std::vector<Vector> z = filled<Vector>(measured);
    std::vector<RelativeEdge> edges(first.size());
    for (std::size_t k = 0; k < edges.size(); ++k)
        edges[k] = {first.data()[k], second.data()[k], z[k], symmetric(information.data() + k * d * d, d)};
    return edges;
}

Kernel kernel_of(int code, double width) { return {static_cast<Robust>(code), width}; }

Sightings seen(const In<double>& z, const In<double>& noisy, const In<double>& trust, const std::array<double, 6>& sensor,
               int code, double width) {
    return {filled<Sighting>(z),           filled<Sighting>(noisy), copy_of(trust),
            std::bit_cast<Sensor>(sensor), kernel_of(code, width),  z.shape(1) == 3};
}

System system_of(const In<Index>& start, const In<Index>& rows, const InOut<double>& values, const InOut<double>& xi) {
    return {{span(start), span(rows)}, values.data(), xi.data()};
}

void bind_families(nb::module_& m) {
    nb::class_<Family>(m, "Family")
        .def(
            "cost",
            [](const Family& f, In<double> state, In<double> reference) {
                return f.accumulate({state.data(), reference.data()}, nullptr, {});
            },
            release())
        .def(
            "add",
            [](const Family& f, In<double> state, In<double> reference, In<Index> start, In<Index> rows, InOut<double> values,
               InOut<double> xi, In<Index> pairs) {
                System system = system_of(start, rows, values, xi);
                return f.accumulate({state.data(), reference.data()}, &system, span(pairs));
            },
            release())
        .def("squares",
             [](const Family& f, In<double> state, In<double> trust) { return array(f.squares(state.data(), span(trust))); })
        // the nodes (E,) and (E,), values and information of the relative headings, or positions, that the edges measure
        .def("headings",
             [](const Family& f) {
                 const std::vector<HeadingRelation> found = f.headings();
                 return std::tuple(rows_of(found, &HeadingRelation::first), rows_of(found, &HeadingRelation::second),
                                   rows_of(found, &HeadingRelation::value), rows_of(found, &HeadingRelation::information));
             })
        .def("positions", [](const Family& f, In<double> state) {
            std::vector<Index> first, second;
            std::vector<double> value, information;
            for (const auto& [i, j, x, y, xx, xy, yy] : f.positions(state.data())) {
                first.push_back(i);
                second.push_back(j);
                value.insert(value.end(), {x, y});
                information.insert(information.end(), {xx, xy, xy, yy});
            }
            const std::size_t count = first.size();
            return std::tuple(array(std::move(first)), array(std::move(second)), array(std::move(value), {count, 2}),
                              array(std::move(information), {count, 2, 2}));
        });
    nb::class_<RelativeEdges, Family>(m, "RelativeEdges")
        .def("__init__", [](RelativeEdges* at, In<Index> first, In<Index> second, In<double> measured, In<double> information,
                            bool world, int code, double width) {
            new (at) RelativeEdges(relative_edges(first, second, measured, information), measured.shape(1) == 3, world,
                                   kernel_of(code, width));
        });
    nb::class_<PositionEdges, Family>(m, "PositionEdges")
        .def("__init__", [](PositionEdges* at, In<Index> nodes, In<double> places, In<double> information, In<double> levers,
                            int code, double width) {
            std::vector<Position> positions;
            for (const RelativeEdge& each : relative_edges(nodes, nodes, places, information)) {
                const double* const lever = levers.data() + 2 * positions.size();
                positions.push_back({each.i, each.z, each.omega, {lever[0], lever[1]}});
            }
            new (at) PositionEdges(std::move(positions), kernel_of(code, width));
        });
    nb::class_<NumberEdges, Family>(m, "NumberEdges")
        .def("__init__", [](NumberEdges* at, bool bearing, In<Index> first, In<Index> second, In<double> measured,
                            In<double> information, std::array<double, 2> offset, int code, double width) {
            std::vector<NumberEdge> edges(first.size());
            for (std::size_t k = 0; k < edges.size(); ++k)
                edges[k] = {
                    first.data()[k], second.data()[k], measured.data()[k], information.data()[k], {offset[0], offset[1]}};
            new (at) NumberEdges(bearing ? Number::bearing : Number::range, std::move(edges), kernel_of(code, width));
        });
    nb::class_<PolarEdges, Family>(m, "PolarEdges")
        .def("__init__", [](PolarEdges* at, In<Index> first, In<Index> second, In<double> z, In<double> noisy,
                            In<double> trust, std::array<double, 6> sensor, int code, double width) {
            new (at) PolarEdges(copy_of(first), copy_of(second), seen(z, noisy, trust, sensor, code, width));
        });
    nb::class_<VirtualMotionEdges, Family>(m, "VirtualMotionEdges")
        .def("__init__",
             [](VirtualMotionEdges* at, In<Index> starts, In<Index> nodes, In<double> z, In<double> noisy, In<double> trust,
                std::array<double, 6> sensor, int code, double width, bool tempered, bool body) {
                 new (at) VirtualMotionEdges({copy_of(starts), copy_of(nodes), seen(z, noisy, trust, sensor, code, width)},
                                             tempered, body);
             });
    nb::class_<MarginalEdges, Family>(m, "MarginalEdges")
        .def("__init__",
             [](MarginalEdges* at, In<Index> starts, In<Index> nodes, In<double> z, In<double> noisy, In<double> trust,
                std::array<double, 6> sensor, int code, double width, bool body) {
                 new (at) MarginalEdges({copy_of(starts), copy_of(nodes), seen(z, noisy, trust, sensor, code, width)}, body);
             })
        // e (M, 3), W (M, 6), its factor of trust and kernel (M,), the lever (M, 2), m̂ (G, 3) and the cost
        .def("around_means", [](const MarginalEdges& edges, In<double> state, In<double> reference) {
            const AroundMeans around = edges.around_means({state.data(), reference.data()});
            return nb::make_tuple(rows_of(around.sightings, &AroundMean::e), rows_of(around.sightings, &AroundMean::W),
                                  rows_of(around.sightings, &AroundMean::factor),
                                  rows_of(around.sightings, &AroundMean::lever), rows_of(around.means), around.cost);
        });
}

/// The controls (S, 2) and durations (S,) of motions that begin with the controls at `starts` (T+1,).
std::vector<Control> controls_of(const In<double>& u, const In<double>& dt, const In<Index>& starts) {
    const std::size_t count = dt.size();
    require(has_shape(u, {count, 2}) && starts.size() > 0 && starts.data()[0] == 0 && std::ranges::is_sorted(span(starts)) &&
                span(starts).back() == static_cast<Index>(count),
            "the arrays of controls do not fit together");
    std::vector<Control> controls(count);
    for (std::size_t k = 0; k < count; ++k) controls[k] = {u.data()[2 * k], u.data()[2 * k + 1], dt.data()[k]};
    return controls;
}

/// Call use(first control, number of controls) for each motion.
template <class Use>
void for_each_motion(const In<Index>& starts, Use use) {
    for (std::size_t t = 0; t + 1 < starts.size(); ++t) {
        const auto first = static_cast<std::size_t>(starts.data()[t]);
        use(first, static_cast<std::size_t>(starts.data()[t + 1]) - first);
    }
}

void append(std::vector<double>& to, const Vector& v) { to.insert(to.end(), {v.x, v.y, v.t}); }
void append(std::vector<double>& to, const Symmetric& P) {
    to.insert(to.end(), {P.xx, P.xy, P.xt, P.xy, P.yy, P.yt, P.xt, P.yt, P.tt});
}

/// What controls and sightings measure.
void bind_measured(nb::module_& m) {
    // where a control leads from the origin (3,), and the covariance of that (3, 3)
    m.def("moved", [](const std::array<double, 8>& noise, double nu, double omega, double dt) {
        const Control u{nu, omega, dt};
        const auto [end, P] = moved(std::span(&u, 1), std::bit_cast<MotionNoise>(noise));
        std::vector<double> place, covariance;
        append(place, end);
        append(covariance, P);
        return std::pair(array(std::move(place)), array(std::move(covariance), {3, 3}));
    });
    // the motions (T, 3) and their covariances (T, 3, 3); variances (S, 3) are `ControlVariances`
    m.def("accumulate", [](In<double> u, In<double> dt, In<Index> starts, In<double> given) {
        const std::vector<Control> controls = controls_of(u, dt, starts);
        const auto variances = records<ControlVariances>(given, controls.size());
        std::vector<double> ends, covariances;
        for_each_motion(starts, [&](std::size_t first, std::size_t count) {
            const auto [end, P] =
                moved(std::span(controls).subspan(first, count), std::span(variances).subspan(first, count));
            append(ends, end);
            append(covariances, P);
        });
        const std::size_t motions = starts.size() - 1;
        return std::pair(array(std::move(ends), {motions, 3}), array(std::move(covariances), {motions, 3, 3}));
    });
    // the motions (T, 3), and the derivative (S, 3, 2) of each by its controls
    m.def("accumulated_slopes", [](In<double> u, In<double> dt, In<Index> starts) {
        const std::vector<Control> controls = controls_of(u, dt, starts);
        std::vector<ControlSlope> by_control(controls.size());
        std::vector<double> ends;
        for_each_motion(starts, [&](std::size_t first, std::size_t count) {
            append(ends, slopes(std::span(controls).subspan(first, count), std::span(by_control).subspan(first, count)));
        });
        return std::pair(array(std::move(ends), {starts.size() - 1, 3}),
                         array<double>(std::move(by_control), {controls.size(), 3, 2}));
    });
    // the places (K, d) of sightings (K, d) in the axes of the robot, and their covariances (K, d, d) at the sightings `noisy`
    m.def("places", [](const std::array<double, 6>& numbers, In<double> z, In<double> noisy) {
        require(z.ndim() == 2 && has_shape(noisy, {z.shape(0), z.shape(1)}), "sightings have rows of the same length");
        const auto sensor = std::bit_cast<Sensor>(numbers);
        const std::size_t d = z.shape(1);
        std::vector<double> places, covariances;
        for (const Sighting& seen : filled<Sighting>(z)) {
            const Rotation along(seen.bearing);
            const double heading = wrap(seen.bearing - seen.orientation);
            const double place[] = {sensor.offset_x + seen.range * along.c, sensor.offset_y + seen.range * along.s, heading};
            places.insert(places.end(), place, place + d);
        }
        for (const Sighting& at : filled<Sighting>(noisy)) {
            const auto [xx, xy, yy, xt, yt, tt] = landmark_covariance(sensor, at.range, Rotation(at.bearing), d == 3);
            const double rows[3][3] = {{xx, xy, xt}, {xy, yy, yt}, {xt, yt, tt}};
            for (std::size_t r = 0; r < d; ++r) covariances.insert(covariances.end(), rows[r], rows[r] + d);
        }
        const std::size_t count = z.shape(0);
        return std::pair(array(std::move(places), {count, d}), array(std::move(covariances), {count, d, d}));
    });
}

void bind_linearized(nb::module_& m) {
    // the inverses (E, d, d), and the first matrix that has none, or -1
    m.def("inverses", [](In<double> matrices, double least) {
        require(matrices.ndim() == 3 && matrices.shape(1) == matrices.shape(2) && matrices.shape(1) - 1 < 3,
                "matrices have one to three rows, and as many columns");
        std::vector<double> out(matrices.size());
        const Index wrong = inverses(span(matrices), matrices.shape(1), least, out);
        return std::pair(array(std::move(out), {matrices.shape(0), matrices.shape(1), matrices.shape(1)}), wrong);
    });
    m.def(
        "add_linearized",
        [](In<Index> first, In<Index> second, In<Index> pairs, In<double> e, In<double> A, In<double> B, In<double> P,
           In<double> W, In<Index> start, In<Index> rows, InOut<double> values, InOut<double> xi, InOut<double> mixed,
           InOut<double> own, InOut<double> gradient) {
            const std::size_t E = first.size(), n = start.size() - 1, K = gradient.size(), d = e.ndim() == 2 ? e.shape(1) : 0;
            require((d == 2 || d == 3) && second.size() == E && pairs.size() == E && has_shape(e, {E, d}) &&
                        has_shape(A, {E, d, 3}) && has_shape(B, {E, d, 3}) && has_shape(P, {E, d, K}) &&
                        has_shape(W, {E, d, d}) && has_shape(mixed, {n, 3, K}) && has_shape(own, {K, K}) &&
                        has_shape(values, {rows.size(), 3, 3}) && has_shape(xi, {n, 3}),
                    "the arrays of edges, system and border do not fit together");
            for (std::size_t k = 0; k < E; ++k) {
                const Index i = first.data()[k], j = second.data()[k], pair = pairs.data()[k];
                require(std::min({i, j, pair}) >= 0 && static_cast<std::size_t>(std::max(i, j)) < n && i != j &&
                            static_cast<std::size_t>(pair) < rows.size(),
                        "an edge is between two different nodes of the system");
            }
            System system = system_of(start, rows, values, xi);
            add({span(first), span(second), span(pairs), d, K, e.data(), A.data(), B.data(), P.data(), W.data()}, system,
                {mixed.data(), own.data(), gradient.data()});
        },
        release());
}

void bind_kernels(nb::module_& m) {
    const auto each = [](const In<double>& squares, auto function) {
        std::vector<double> out(squares.size());
        for (std::size_t k = 0; k < out.size(); ++k) out[k] = function(squares.data()[k]);
        return array(std::move(out));
    };
    m.def("robust_loss", [each](int code, double width, In<double> squares) {
        return each(squares, [kernel = kernel_of(code, width)](double r2) { return kernel.loss(r2); });
    });
    m.def("robust_weight", [each](int code, double width, In<double> squares) {
        return each(squares, [kernel = kernel_of(code, width)](double r2) { return kernel.weight(r2); });
    });
}

void bind(nb::module_& m) {
    bind_families(m);
    bind_measured(m);
    bind_linearized(m);
    bind_kernels(m);
}

}  // namespace vmslam::python::edges_bindings
