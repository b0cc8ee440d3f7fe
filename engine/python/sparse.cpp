// Patterns, orders and factors.
#include <nanobind/stl/complex.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/shared_ptr.h>

#include <algorithm>
#include <limits>
#include <optional>

#include "arrays.hpp"
#include "bindings.hpp"
#include "vmslam/sparse/factor.hpp"
#include "vmslam/sparse/ordering.hpp"
#include "vmslam/sparse/pattern.hpp"

namespace vmslam::python::sparse_bindings {

using namespace sparse;

Pattern pattern_of(const In<Index>& start, const In<Index>& rows) { return {span(start), span(rows)}; }

void bind_patterns(nb::module_& m) {
    // of groups of nodes: (starts (G+1,), members) for each family
    m.def("pattern", [](Index nodes, nb::list families) {
        std::vector<Index> sizes, members;
        for (const nb::handle family : families) {
            const auto [starts, own] = nb::cast<std::pair<In<Index>, In<Index>>>(family);
            const auto at = span(starts);
            for (std::size_t g = 1; g < at.size(); ++g) sizes.push_back(at[g] - at[g - 1]);
            members.insert(members.end(), own.data(), own.data() + own.size());
        }
        OwnedPattern pattern = pattern_of_groups(nodes, sizes, members);
        return std::pair(array(std::move(pattern.start)), array(std::move(pattern.rows)));
    });
    m.def("pattern_fault", [](In<Index> start, In<Index> rows) { return pattern_of(start, rows).fault(); });
    m.def("blocks_of_nodes", [](In<Index> start, In<Index> rows, In<Index> nodes) {
        return array(blocks_of_nodes(pattern_of(start, rows), span(nodes)));
    });
    // the block between two nodes each, and the first pair that the pattern does not have, or -1
    m.def("pair_blocks", [](In<Index> start, In<Index> rows, In<Index> first, In<Index> second) {
        const Pattern pattern = pattern_of(start, rows);
        std::vector<Index> blocks(first.size());
        for (std::size_t e = 0; e < blocks.size(); ++e) blocks[e] = block_or_none(pattern, first.data()[e], second.data()[e]);
        const auto missing = std::find(blocks.begin(), blocks.end(), -1);
        const Index at = missing == blocks.end() ? -1 : missing - blocks.begin();
        return std::pair(array(std::move(blocks)), at);
    });
}

void bind_orders(nb::module_& m) {
    m.def("minimum_degree", [](In<Index> start, In<Index> rows, double dense) {
        const Pattern pattern = pattern_of(start, rows);
        return array(minimum_degree(pattern, degree_limit(pattern.size(), dense)));
    });
    m.def("fill_reducing", [](In<Index> start, In<Index> rows, Node smallest, double worth) {
        return array(fill_reducing(pattern_of(start, rows), {smallest, worth}));
    });
    m.def("flops_of",
          [](In<Index> start, In<Index> rows, In<Node> order) { return flops_of(pattern_of(start, rows), span(order)); });
    const auto graph = [](const In<Index>& start, const In<Node>& list) { return Neighbours{copy_of(start), copy_of(list)}; };
    m.def("separator_depths",
          [graph](In<Index> start, In<Node> list, Node limit) { return array(separator_depths(graph(start, list), limit)); });
    m.def("separate", [graph](In<Index> start, In<Node> list, InOut<signed char> side) {
        return separate(graph(start, list), span(side));
    });
}

void bind_symbolic(nb::module_& m) {
    nb::class_<Symbolic>(m, "Symbolic")
        .def_prop_ro(
            "order", [](const Symbolic& s) { return array(s.order); }, nb::rv_policy::reference)
        .def_prop_ro("numbers", [](const Symbolic& s) { return s.panel_start.back(); })
        .def_ro("parts", &Symbolic::parts)
        .def_ro("blocks", &Symbolic::blocks);
    m.def(
        "analyze",
        [](In<Index> start, In<Index> rows, std::optional<In<Node>> order, int threads, std::optional<In<Index>> points) {
            const Pattern pattern = pattern_of(start, rows);
            const nb::gil_scoped_release other_threads;
            std::vector<char> is_point(pattern.size(), 0);
            if (points)
                for (const Index node : span(*points)) is_point.at(node) = 1;
            return std::make_shared<Symbolic>(order ? analyze(pattern, span(*order), shape_of<Real3>, threads, is_point)
                                                    : analyze(pattern, shape_of<Real3>, threads, is_point));
        },
        nb::arg("start"), nb::arg("rows"), nb::arg("order").none(), nb::arg("threads"), nb::arg("points") = nb::none());
    m.def("for_proof", [](const Symbolic& s) { return std::make_shared<Symbolic>(reshaped(s, shape_of<Hermitian2>)); });
}

template <class Block>
auto bind_factor(nb::module_& m, const char* name) {
    using Value = typename Block::Value;
    using F = Factor<Block>;
    return nb::class_<F>(m, name)
        .def("__init__", [](F* at, std::shared_ptr<Symbolic> s) { new (at) F(std::move(s)); })
        .def(
            "factorize", [](F& f, In<Value> values, double damping) { return f.factorize(span(values), damping); }, release())
        .def(
            "solve",
            [](F& f, In<Value> b, InOut<Value> x) {
                const std::size_t numbers = f.symbolic().order.size() * Block::rows;
                require(b.size() == numbers && x.size() == numbers, "right-hand side and solution have a row for each node");
                return f.solve(span(b), span(x));
            },
            release())
        .def("null_vector", [](const F& f, Index pivot) {
            const std::size_t nodes = f.symbolic().order.size(), rows = Block::rows;
            return array(f.null_vector(pivot), {nodes, rows});
        });
}

void bind_inverse(nb::module_& m) {
    nb::class_<SelectedInverse>(m, "SelectedInverse")
        .def(nb::init<const Factor<Real3>&>(), release())
        .def("diagonal", [](const SelectedInverse& z) { return array(z.diagonal(), {z.diagonal().size() / 9, 3, 3}); })
        // blocks (E, 3, 3) in the rows and columns of pairs of nodes, NaN where the pattern of L lacks one
        .def("pairs", [](const SelectedInverse& z, In<Index> rows, In<Index> columns) {
            std::vector<double> out(9 * rows.size(), std::numeric_limits<double>::quiet_NaN());
            for (std::size_t e = 0; e < rows.size(); ++e)
                if (const auto block = z.block(static_cast<Node>(rows.data()[e]), static_cast<Node>(columns.data()[e])))
                    std::copy(block->begin(), block->end(), out.begin() + 9 * e);
            return array(std::move(out), {rows.size(), 3, 3});
        });
}

void bind(nb::module_& m) {
    bind_patterns(m);
    bind_orders(m);
    bind_symbolic(m);
    bind_factor<Real3>(m, "RealFactor")
        .def("log_determinant", &Factor<Real3>::log_determinant)
        .def(
            "solve_columns",
            [](const Factor<Real3>& f, In<double> b, InOut<double> x) {
                const std::size_t nodes = f.symbolic().order.size(), columns = b.ndim() == 3 ? b.shape(2) : 0;
                require(has_shape(b, {nodes, 3, columns}) && has_shape(x, {nodes, 3, columns}),
                        "right-hand sides and solutions have the shape (nodes, 3, columns)");
                return solve_columns(f, span(b), static_cast<Index>(columns), span(x));
            },
            release());
    bind_factor<Hermitian2>(m, "HermitianFactor");
    bind_inverse(m);
}

}  // namespace vmslam::python::sparse_bindings
