// Association of sightings without ids: joint hypotheses, and how often landmarks were in view.
#include <nanobind/stl/pair.h>

#include <algorithm>

#include "arrays.hpp"
#include "bindings.hpp"
#include "vmslam/association/growth.hpp"
#include "vmslam/association/search.hpp"
#include "vmslam/association/visibility.hpp"

namespace vmslam::python::association_bindings {

using namespace association;

/// Pairs (C) with residuals (C, d) and their covariance (C d, C d), in as many numbers. Landmarks are a copy that is checked.
Pairs pairs_of(std::span<const Number> landmarks, const In<double>& nu, const In<double>& covariance,
               const In<double>& weights, const In<bool>& allowed) {
    require(nu.ndim() == 2 && nu.shape(1) >= 1 && nu.shape(1) <= most_coordinates, "residuals have 1 to 3 coordinates");
    require(covariance.size() == nu.size() * nu.size(),
            "the covariance has a row and a column for each number of the residuals");
    const std::size_t count = nu.shape(0);
    require(landmarks.size() == count && weights.size() == count && allowed.size() == count,
            "the arrays of the pairs have different lengths");
    return {landmarks, {span(nu), span(covariance), nu.shape(1)}, span(weights), span(allowed)};
}

Out<std::int64_t> views(const In<double>& poses, const In<double>& landmarks, const In<double>& origin,
                        const In<double>& limits) {
    require(landmarks.ndim() == 2 && landmarks.shape(1) >= 2, "landmarks have at least two coordinates");
    require(poses.size() % 3 == 0 && origin.size() == 2 && limits.size() % 3 == 0, "poses and limits have three columns");
    const std::vector<FieldLimit> fields = records<FieldLimit>(limits, limits.size() / 3);
    std::vector<std::int64_t> counts = released([&] {
        return count_views(span(poses), span(landmarks), landmarks.shape(1), {origin.data()[0], origin.data()[1]}, fields);
    });
    return array(std::move(counts), {fields.size(), landmarks.shape(0)});
}

std::pair<Out<Number>, double> best(const In<Number>& start, const In<Number>& landmarks, const In<double>& nu,
                                    const In<double>& covariance, const In<double>& weights, const In<double>& bounds,
                                    const In<bool>& allowed, const In<double>& gates, Number most) {
    // copies: these are checked here, and other threads may change the arrays afterwards
    const std::vector<Number> starts = copy_of(start), numbers = copy_of(landmarks);
    const Pairs candidates = pairs_of(numbers, nu, covariance, weights, allowed);
    const std::size_t count = numbers.size();
    require(bounds.size() == count, "the arrays of the candidates have different lengths");
    require(!starts.empty() && starts.front() == 0 && starts.back() == Number(count) &&
                std::is_sorted(starts.begin(), starts.end()),
            "the starts of the items must ascend from 0 to the number of candidates");
    require(gates.size() >= starts.size(), "a gate is needed for every number of pairs");
    // they are numbered, so that a list of all landmarks is short
    for (const Number landmark : numbers)
        require(landmark >= 0 && landmark < Number(count), "landmarks must be numbered from 0");
    BestHypothesis found = released([&] { return best_hypothesis(candidates, starts, span(bounds), span(gates), most); });
    return {array(std::move(found.chosen)), found.evidence};
}

/// Hypotheses from rows of pairs (S, n): their members (S, C), evidence (S,) and best second pairs (S, 3).
nb::tuple grown(const In<Number>& begin, const In<Number>& items, const In<Number>& landmarks, const In<double>& nu,
                const In<double>& covariance, const In<double>& weights, const In<bool>& allowed, double gate_of_given,
                double gate, bool grow) {
    const Pairs pairs = pairs_of(span(landmarks), nu, covariance, weights, allowed);
    const std::size_t count = items.size();
    require(landmarks.size() == count, "the arrays of the pairs have different lengths");
    require(begin.ndim() == 2, "each hypothesis begins with a row of pairs");
    // a copy, which other threads cannot change after the check
    const std::vector<Number> beginnings = copy_of(begin);
    for (const Number c : beginnings)
        require(c >= -1 && c < Number(count), "a hypothesis begins with pairs that are not there");
    const std::size_t rows = begin.shape(0), given = begin.shape(1);
    std::vector<char> members(rows * count);
    std::vector<double> evidence(rows);
    std::vector<Number> second(rows * second_pairs);
    {
        const nb::gil_scoped_release other_threads;
        for (std::size_t k = 0; k < rows; ++k) {
            const auto first = std::span(beginnings).subspan(k * given, given);
            const Grown one = grown_from(first, pairs, span(items), {gate_of_given, gate, grow});
            std::copy(one.members.begin(), one.members.end(), members.begin() + k * count);
            evidence[k] = one.evidence;
            std::copy(one.second.begin(), one.second.end(), second.begin() + k * second_pairs);
        }
    }
    return nb::make_tuple(array<bool>(std::move(members), {rows, count}), array(std::move(evidence)),
                          array(std::move(second), {rows, second_pairs}));
}

void bind(nb::module_& m) {
    m.def("count_views", &views);
    m.def("best_hypothesis", &best);
    m.def("grow_hypotheses", &grown);
}

}  // namespace vmslam::python::association_bindings
