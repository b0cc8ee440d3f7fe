// Proofs that a state is a global minimum, and the factorisation of their matrices.
#include <nanobind/stl/complex.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/tuple.h>

#include <optional>
#include <tuple>

#include "arrays.hpp"
#include "bindings.hpp"
#include "vmslam/certificate/proof.hpp"
#include "vmslam/edges/family.hpp"

namespace vmslam::python::certificate_bindings {

using namespace certificate;

/// The upper triangle of a symmetric matrix (d, d); false where it is not symmetric, but for rounding.
bool take_upper(const double* W, int d, double tolerance, double* upper) {
    for (int j = 0, k = 0; j < d; ++j)
        for (int i = 0; i <= j; ++i, ++k) {
            const double apart = std::abs(W[i * d + j] - W[j * d + i]);
            if (apart > tolerance * (std::abs(W[i * d + i]) + std::abs(W[j * d + j]))) return false;
            upper[k] = W[i * d + j];
        }
    return true;
}

/// Edges given by arrays; false where the information of one is not symmetric, but for rounding.
bool add(edges::ConstantEdges& to, const In<Index>& first, const In<Index>& second, const In<double>& start,
         const In<double>& end, const std::optional<In<double>>& turn, const In<double>& information, double tolerance) {
    const int d = static_cast<int>(information.shape(1));
    for (std::size_t e = 0; e < first.size(); ++e) {
        const double *const a = start.data() + 2 * e, *const b = end.data() + 2 * e;
        to.edges.push_back({first.data()[e],
                            second.data()[e],
                            {a[0], a[1]},
                            {b[0], b[1]},
                            turn ? turn->data()[e] : 0.0,
                            turn.has_value(),
                            {}});
        if (!take_upper(information.data() + d * d * e, d, tolerance, &to.edges.back().information.xx)) return false;
    }
    return true;
}

/// First, second, d_a, d_b, turn (None without a heading row), the upper triangles of Omega (E, 6), and the landmarks.
nb::tuple arrays(const edges::ConstantEdges& from) {
    const bool oriented = !from.edges.empty() && from.edges.front().oriented;
    return nb::make_tuple(rows_of(from.edges, &Edge::first), rows_of(from.edges, &Edge::second),
                          rows_of(from.edges, &Edge::d_a), rows_of(from.edges, &Edge::d_b),
                          oriented ? nb::cast(rows_of(from.edges, &Edge::turn)) : nb::none(),
                          rows_of(from.edges, &Edge::information), rows_of(from.landmarks));
}

Out<Index> points_of_nodes(const edges::ConstantEdges& from, Index nodes) {
    const std::vector<char> points = points_of(from.edges, nodes);
    std::vector<Index> chosen;
    for (Index k = 0; k < nodes; ++k)
        if (points[k]) chosen.push_back(k);
    return array(std::move(chosen));
}

/// A proof with the pattern that it needs.
class OwnedProof : public Proof {
   public:
    OwnedProof(const In<Index>& start, const In<Index>& rows, std::shared_ptr<sparse::Symbolic> symbolic)
        : Proof({span(start), span(rows)}, std::move(symbolic)), start_(start), rows_(rows) {}

    /// The edges become those of the proof.
    void begin_at(edges::ConstantEdges& taken, const In<double>& state, const In<Index>& fixed) {
        edges = std::move(taken.edges);
        std::vector<char> free(state.size() / 3, 1);
        for (const Index node : span(fixed)) free[node] = 0;
        begin(span(state), std::move(free));
    }

   private:
    In<Index> start_, rows_;
};

void bind(nb::module_& m) {
    nb::class_<edges::ConstantEdges>(m, "ConstantEdges")
        .def(nb::init<>())
        // the edges of a family at a state; its landmarks (K, 3), or None
        .def(
            "take",
            [](edges::ConstantEdges& to, const edges::Family& family, const In<double>& state) -> std::optional<Out<double>> {
                const std::size_t before = to.landmarks.size();
                require(family.constant(state.data(), static_cast<Index>(state.shape(0)), to),
                        "the information of these edges is not constant");
                if (to.landmarks.size() == before) return std::nullopt;
                return rows_of(std::vector(to.landmarks.begin() + static_cast<std::ptrdiff_t>(before), to.landmarks.end()));
            })
        .def("add", &add, nb::arg("first"), nb::arg("second"), nb::arg("start"), nb::arg("end"), nb::arg("turn").none(),
             nb::arg("information"), nb::arg("tolerance"))
        .def_prop_ro("arrays", &arrays)
        // the pattern that a number of nodes have by the edges, and the nodes whose headings no edge depends on
        .def("pattern",
             [](const edges::ConstantEdges& from, Index nodes) {
                 const sparse::OwnedPattern pattern = pattern_of(from.edges, nodes);
                 return std::tuple(array(pattern.start), array(pattern.rows), points_of_nodes(from, nodes));
             })
        // whether an edge depends on the heading of one of some nodes
        .def("turn_with", [](const edges::ConstantEdges& from, Index nodes, In<Index> some) {
            const std::vector<char> points = points_of(from.edges, nodes);
            return std::ranges::any_of(span(some), [&](Index k) { return !points[k]; });
        });
    nb::enum_<Finding>(m, "Finding")
        .value("global_minimum", Finding::global)
        .value("zero", Finding::zero)
        .value("other_cost", Finding::other_cost)
        .value("unsplit", Finding::unsplit)
        .value("not_stationary", Finding::not_stationary)
        .value("negative", Finding::negative)
        .value("without_bound", Finding::without_bound)
        .value("indefinite", Finding::indefinite);
    nb::class_<OwnedProof>(m, "Proof")
        .def(nb::init<const In<Index>&, const In<Index>&, std::shared_ptr<sparse::Symbolic>>())
        .def("begin", &OwnedProof::begin_at)
        .def_prop_ro("cost", &Proof::cost)
        // what a proof finds, the lower bound, the number of edges without a split, the ends of the edge without a lower
        // bound, or None, and a direction (N, 2) in which S is not positive, or None
        .def("judge",
             [](OwnedProof& proof, double cost, bool thorough) {
                 Judgement found = released([&] { return judge(proof, cost, thorough); });
                 std::optional<std::pair<Index, Index>> ends;
                 if (found.edge >= 0) ends.emplace(proof.edges[found.edge].first, proof.edges[found.edge].second);
                 std::optional<Out<Complex>> direction;
                 const std::size_t nodes = found.direction.size() / 2;
                 if (nodes) direction = array(std::move(found.direction), {nodes, 2});
                 return std::tuple(found.finding, found.lowest, found.unsplit, ends, direction);
             })
        // S and half the gradient (N, 2) of the function below J for a split
        .def("function_of", [](const OwnedProof& proof, double share) {
            QuadraticBound f = proof.function_of(share);
            const std::size_t blocks = f.values.size() / 4, nodes = f.gradient.size() / 2;
            return std::pair(array(std::move(f.values), {blocks, 2, 2}), array(std::move(f.gradient), {nodes, 2}));
        });
    // beta and kappa of one edge
    m.def("split_information", [](In<double> w, double share) {
        const Split s = split(records<edges::Symmetric>(w, 1)[0], share);
        return std::pair(s.beta, s.kappa);
    });
    // of a factor of A: c (N,) in the order of elimination, the parts (N,) of the diagonal of A that bound the errors, in the
    // same order, and the bound on b^H A^-1 b
    m.def("rounding_bounds", [](HermitianFactor& factor, In<Complex> b) {
        const std::vector<double> c = rounding_of(factor.symbolic());
        return std::tuple(array(c), array(factor_errors(factor.symbolic(), c)), square_bound(factor, span(b), c));
    });
}

}  // namespace vmslam::python::certificate_bindings
