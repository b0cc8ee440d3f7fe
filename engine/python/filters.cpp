// Particle filters, their random numbers and their resampling.
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/unique_ptr.h>

#include <algorithm>

#include "bindings.hpp"
#include "shared_filter.hpp"
#include "vmslam/particles/weights.hpp"

namespace vmslam::python::filters_bindings {

using namespace particles;
using Numbers = In<double>;
using Numbers64 = In<std::int64_t>;

/// What Python gets: arrays for vectors.
template <class T>
T to_python(T value) {
    return value;
}
template <class T>
Out<T> to_python(std::vector<T> values) {
    return array(std::move(values));
}
/// A read-only array (N, rows) that keeps the rows alive; (N,) for a single row.
nb::object to_python(std::shared_ptr<const Rows> rows) {
    auto* const owned = new std::shared_ptr<const Rows>(std::move(rows));
    const nb::capsule owner(owned, [](void* p) noexcept { delete static_cast<std::shared_ptr<const Rows>*>(p); });
    const Rows& r = **owned;
    if (r.rows() == 1) return nb::cast(nb::ndarray<nb::numpy, const double>(r.row(0), {r.particles()}, owner));
    return nb::cast(nb::ndarray<nb::numpy, const double>(r.row(0), {r.particles(), static_cast<std::size_t>(r.rows())}, owner,
                                                         {1, static_cast<std::int64_t>(r.stride())}));
}

/// A method: what `work` does with the filter, while other Python threads run.
template <class Result, class... Arguments>
auto locked(Result (*work)(Filter&, Arguments...)) {
    return [work](SharedFilter& shared, Arguments... arguments) {
        const auto use = [&](Filter& f) { return work(f, arguments...); };
        if constexpr (std::is_void_v<Result>)
            shared.with(use);
        else
            return to_python(shared.with(use));
    };
}

std::size_t checked_particle(const Filter& f, std::size_t particle) {
    if (particle >= f.particles()) throw std::out_of_range("there is no such particle");
    return particle;
}

/// The sightings (K, 2 or 3) with variances (K, 2 or 3).
std::vector<Sighting> sightings_of(const Numbers& z, const Numbers& q) {
    const std::vector<Reading> measured = filled<Reading>(z), variances = filled<Reading>(q, 1.0);
    require(q.shape(0) == z.shape(0) && q.shape(1) == z.shape(1), "as many variances as sightings");
    std::vector<Sighting> out;
    for (std::size_t k = 0; k < measured.size(); ++k) out.push_back({measured[k], variances[k]});
    return out;
}

Vector three_of(const Numbers& mean) {
    require(mean.size() == 2 || mean.size() == 3, "two or three coordinates");
    return {mean.data()[0], mean.data()[1], mean.size() == 3 ? mean.data()[2] : 0.0};
}

Symmetric six_of(const Numbers& matrix) {
    require(matrix.size() == 4 || matrix.size() == 9, "a matrix (2, 2) or (3, 3)");
    const double* const P = matrix.data();
    if (matrix.size() == 4) return {P[0], P[1], P[3], 0.0, 0.0, 0.0};
    return {P[0], P[1], P[4], P[2], P[5], P[8]};
}

Version version_of(int code) {
    require(code >= 0 && code <= 2, "version 0, 1 or 2");
    return static_cast<Version>(code);
}

const IdentifiedMap& identified(const Filter& f) {
    require(f.identified().has_value(), "a filter that uses ids");
    return *f.identified();
}

const AnonymousMap& anonymous(const Filter& f) {
    require(f.anonymous().has_value(), "a filter that uses no ids");
    return *f.anonymous();
}

void check_columns(bool oriented, const Numbers& z) {
    require(oriented == (z.shape(1) == 3), "sightings with as many columns as the first ones");
}

LandmarkView checked_view(Filter& f, LandmarkId id) {
    const LandmarkView view = f.view(id);
    if (!view.numbers) throw std::out_of_range("there is no such landmark");
    return view;
}

/// Means (k, n), covariances (k, n, n) and the evidence (k,) for a landmark in particles `first` to `first + count`.
nb::tuple landmark(SharedFilter& shared, LandmarkId id, std::size_t first, std::size_t count) {
    std::vector<double> means, covariances, evidence;
    const int n = shared.with([&](Filter& f) {
        require(first <= f.particles() && count <= f.particles() - first, "particles of the filter");
        const LandmarkView view = checked_view(f, id);
        const Blocks& rows = *view.numbers;
        const bool oriented = f.identified() ? f.identified()->oriented() : anonymous(f).oriented();
        const int coordinates = oriented ? 3 : 2;
        // the stored rows of the covariance, row by row of the matrix; maps of sightings without ids always have headings
        const auto [x, y, xx, xy, yy] = position_rows(oriented || !f.identified());
        constexpr int xh = 5, yh = 7, hh = 8;
        const std::vector<int> entries =
            oriented ? std::vector{xx, xy, xh, xy, yy, yh, xh, yh, hh} : std::vector{xx, xy, xy, yy};
        for (std::size_t i = first; i < first + count; ++i) {
            const std::size_t at = view.at(i);
            for (int k = 0; k < coordinates; ++k) means.push_back(rows.at(k, at));
            for (const int row : entries) covariances.push_back(rows.at(row, at));
            evidence.push_back(f.identified() ? infinity : rows.at(evidence_row, at));
        }
        return coordinates;
    });
    const auto columns = static_cast<std::size_t>(n);
    return nb::make_tuple(array(std::move(means), {count, columns}), array(std::move(covariances), {count, columns, columns}),
                          array(std::move(evidence)));
}

std::vector<double> class_probabilities(Filter& f, std::int64_t id, std::size_t particle) {
    anonymous(f);
    const LandmarkView view = checked_view(f, id);
    std::vector<double> out;
    for (int row = first_class_row; row < view.numbers->rows(); ++row)
        out.push_back(view.numbers->at(row, view.at(checked_particle(f, particle))));
    return out;
}

void use_ids(Filter& f, bool oriented, std::size_t jointly, std::optional<std::array<double, 2>> range_noise) {
    std::optional<RangeNoise> noise;
    if (range_noise) noise = {(*range_noise)[0], (*range_noise)[1]};
    f.use_ids(oriented, jointly, noise);
}

void use_no_ids(Filter& f, bool oriented, double border, double merge_gate, std::size_t merge_interval,
                std::array<double, 3> limits, const Numbers& confusion) {
    require(confusion.ndim() == 2 && confusion.shape(1) == confusion.shape(0) + 1, "probabilities (n, n + 1)");
    f.use_no_ids(oriented, {border, merge_gate, merge_interval, {limits[0], limits[1], limits[2]}},
                 {confusion.shape(0), copy_of(confusion)});
}

void place(Filter& f, LandmarkId id, const Numbers& mean, const Numbers& covariance) {
    require(covariance.size() == mean.size() * mean.size(), "a covariance of as many coordinates as the mean");
    require(!identified(f).oriented() || mean.size() == 3, "landmarks with a heading");
    f.place(id, three_of(mean), six_of(covariance));
}

void weigh_known(Filter& f, const Numbers& landmarks, const Numbers& covariances, const Numbers& z, const Numbers& q,
                 const In<bool>& oriented) {
    const std::vector<Sighting> sightings = sightings_of(z, q);
    require(landmarks.size() == 3 * sightings.size() && covariances.size() == 9 * sightings.size() &&
                oriented.size() == sightings.size(),
            "as many landmarks as sightings");
    const std::vector<Vector> places = records<Vector>(landmarks, sightings.size());
    std::vector<KnownSighting> known;
    for (std::size_t k = 0; k < sightings.size(); ++k) {
        const double* const S = covariances.data() + 9 * k;
        known.push_back({places[k], {S[0], S[1], S[4], S[2], S[5], S[8]}, sightings[k], oriented.data()[k]});
    }
    f.weigh_known(known);
}

bool weigh_identified(Filter& f, const Numbers64& ids, const Numbers& z, const Numbers& q, int version) {
    const std::vector<Sighting> sightings = sightings_of(z, q);
    require(ids.size() == sightings.size(), "as many ids as sightings");
    check_columns(identified(f).oriented(), z);
    return f.weigh_identified(copy_of(ids), sightings, version_of(version));
}

void weigh_anonymous(Filter& f, const Numbers& z, const Numbers& q, const Numbers64& shown, int version) {
    const std::vector<Sighting> sightings = sightings_of(z, q);
    require(shown.size() == sightings.size() && !sightings.empty(), "as many classes as sightings");
    check_columns(anonymous(f).oriented(), z);
    const auto classes = copy_of(shown);
    const auto count = static_cast<std::int64_t>(anonymous(f).confusion().classes);
    for (const std::int64_t k : classes) require(k >= 0 && k <= count, "classes from 0 to n");
    f.weigh_anonymous(sightings, classes, version_of(version));
}

void weigh_by(Filter& f, const Numbers& log_likelihoods) {
    require(log_likelihoods.size() == f.particles(), "a log likelihood for each particle");
    f.weigh_by(span(log_likelihoods));
}

void branch(Filter& f, const In<Index>& ancestors) {
    const auto a = copy_of(ancestors);
    const auto count = static_cast<Index>(f.particles());
    require(a.size() == f.particles() && a.front() >= 0 && a.back() < count && std::is_sorted(a.begin(), a.end()),
            "ancestors (N,) must ascend from 0 to N - 1 at most");
    f.branch(a);
}

nb::tuple summary(SharedFilter& shared, std::array<double, 2> lever) {
    History::Summary out = shared.with([&](Filter& f) {
        std::vector<double> weights(f.particles());
        for (std::size_t i = 0; i < weights.size(); ++i) weights[i] = numbers::exp(f.log_weights()->row(0)[i]);
        return f.history().summary(weights, lever);
    });
    return nb::make_tuple(rows_of(out.means), array(std::move(out.distinct)));
}

void bind_random(nb::module_& m) {
    m.def("standard_normals", [](std::uint64_t key, std::size_t particles) {
        require(particles < (std::size_t{1} << 31), "particles");
        std::vector<numbers::FiveNormals<double>> out;
        out.reserve(particles);
        for (std::uint64_t i = 0; i < particles; ++i) out.push_back(numbers::five_normals<double>(key, i));
        return rows_of(out);
    });
    m.def("at_positions", [](Numbers cumulative, Numbers positions) {
        require(cumulative.size() > 0, "weights");
        return array(at_positions(span(cumulative), span(positions)));
    });
    m.def("evenly_spaced", [](Numbers cumulative, double offset) {
        require(cumulative.size() > 0, "weights");
        return array(evenly_spaced(span(cumulative), offset));
    });
}

void bind(nb::module_& m) {
    nb::class_<SharedFilter>(m, "ParticleFilter")
        .def(nb::init<const Numbers&, std::size_t, bool>())
        .def("move_by_control", locked(+[](Filter& f, std::uint64_t key, std::array<double, 6> u, bool corrects) {
                 f.move({ControlMotion{u[0], u[1], u[2], u[3], u[4], u[5]}, key}, corrects);
             }))
        .def("move_by_gaussian",
             locked(+[](Filter& f, std::uint64_t key, const Numbers& mean, const Numbers& covariance, bool corrects) {
                 require(mean.size() == 3 && covariance.size() == 9, "a mean (3,) and a covariance (3, 3)");
                 f.move({WholeMotion{three_of(mean), six_of(covariance)}, key}, corrects);
             }))
        .def("end_step", locked(+[](Filter& f) { f.end_step(); }))
        .def("use_ids", locked(use_ids), nb::arg("oriented"), nb::arg("jointly"), nb::arg("range_noise").none())
        .def("use_no_ids", locked(use_no_ids))
        .def("place", locked(place))
        .def("landmarks", locked(+[](Filter& f) { return f.landmarks(); }))
        .def("landmark", landmark)
        .def("class_probabilities", locked(class_probabilities))
        // the slices of the pool, and how many landmarks were created so far
        .def("pool", locked(+[](Filter& f) { return std::tuple(anonymous(f).slices(), anonymous(f).created()); }))
        .def("weigh_known", locked(weigh_known))
        .def("weigh_identified", locked(weigh_identified))
        .def("weigh_anonymous", locked(weigh_anonymous))
        .def("weigh_by", locked(weigh_by))
        .def("reweigh", locked(+[](Filter& f) {
                 const auto [possible, log_evidence, ess] = f.reweigh();
                 return std::tuple(possible, log_evidence, ess);
             }))
        .def("branch", locked(branch))
        .def("remember", locked(+[](Filter& f) { f.remember(); }))
        .def_prop_ro("poses", locked(+[](Filter& f) { return f.poses(); }))
        .def_prop_ro("log_weights", locked(+[](Filter& f) { return f.log_weights(); }))
        .def("log_likelihoods", locked(+[](Filter& f) { return copy_of(f.log_likelihoods()); }))
        .def("weights", locked(+[](Filter& f) { return copy_of(f.weights()); }))
        .def_prop_ro("best", locked(+[](Filter& f) { return f.best(); }))
        .def_prop_ro("threads", locked(+[](Filter& f) { return f.ranges().count(); }))
        .def_prop_ro("stored_poses", locked(+[](Filter& f) { return f.history().stored_rows(); }))
        .def_prop_ro("history_bytes", locked(+[](Filter& f) { return f.history().bytes(); }))
        .def("trajectory",
             [](SharedFilter& s, std::size_t particle) {
                 return rows_of(s.with([&](Filter& f) { return f.history().trajectory(checked_particle(f, particle)); }));
             })
        .def("summary", summary)
        .def("__deepcopy__",
             [](SharedFilter& s, nb::handle) {
                 return s.with([](const Filter& f) { return std::make_unique<SharedFilter>(f); });
             })
        .def("__getstate__", [](SharedFilter&) {
            throw nb::type_error("a particle filter cannot be pickled; pickle its result(), or copy it with copy.deepcopy");
        });
    bind_random(m);
}

}  // namespace vmslam::python::filters_bindings
