// Particle filters, their random numbers and their resampling.
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/unique_ptr.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <memory>
#include <mutex>
#include <stdexcept>

#include "arrays.hpp"
#include "bindings.hpp"
#include "vmslam/particles/filter.hpp"

namespace vmslam::python::filters_bindings {

using namespace particles;
using Numbers = In<double>;
using Numbers64 = In<std::int64_t>;

/// A filter that one Python thread uses at a time, while the others run.
class SharedFilter {
   public:
    SharedFilter(const Numbers& poses, std::size_t threads, bool records) : filter_(first_poses(poses), threads, records) {}
    explicit SharedFilter(const Filter& filter) : filter_(filter) {}

    template <class Work>
    auto with(const Work& work) {
        const nb::gil_scoped_release release;
        const std::lock_guard lock(mutex_);
        require(!incomplete_, "an earlier step of this filter ran out of memory: make a new one with fewer particles");
        try {
            return work(filter_);
        } catch (const std::bad_alloc&) {
            incomplete_ = true;
            throw;
        }
    }

   private:
    static Rows first_poses(const Numbers& poses) {
        require(poses.ndim() == 2 && poses.shape(1) == 3 && poses.shape(0) > 0 && poses.shape(0) < (1u << 30),
                "poses (N, 3)");
        Rows rows(3, poses.shape(0));
        for (std::size_t i = 0; i < rows.particles(); ++i)
            for (int k = 0; k < 3; ++k) rows.row(k)[i] = poses.data()[3 * i + k];
        return rows;
    }

    std::mutex mutex_;
    bool incomplete_ = false;  ///< whether a step ended halfway
    Filter filter_;
};

/// A read-only array (N, rows) that keeps the rows alive; (N,) for a single row.
nb::object view_of(std::shared_ptr<const Rows> rows) {
    auto* const owned = new std::shared_ptr<const Rows>(std::move(rows));
    const nb::capsule owner(owned, [](void* p) noexcept { delete static_cast<std::shared_ptr<const Rows>*>(p); });
    const Rows& r = **owned;
    if (r.rows() == 1) return nb::cast(nb::ndarray<nb::numpy, const double>(r.row(0), {r.particles()}, owner));
    return nb::cast(nb::ndarray<nb::numpy, const double>(r.row(0), {r.particles(), static_cast<std::size_t>(r.rows())}, owner,
                                                         {1, static_cast<std::int64_t>(r.stride())}));
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

IdentifiedMap& identified(Filter& f) {
    require(f.identified() != nullptr, "a filter that uses ids");
    return *f.identified();
}

AnonymousMap& anonymous(Filter& f) {
    require(f.anonymous() != nullptr, "a filter that uses no ids");
    return *f.anonymous();
}

LandmarkView checked_view(Filter& f, LandmarkId id) {
    const LandmarkView view = f.identified() ? f.identified()->view(id) : anonymous(f).view(id);
    if (!view.numbers) throw std::out_of_range("there is no such landmark");
    return view;
}

/// Means (k, n), covariances (k, n, n) and the evidence (k,) for a landmark in particles `first` to `first + count`.
nb::tuple landmark(SharedFilter& shared, LandmarkId id, std::size_t first, std::size_t count) {
    // the stored rows of the covariance, row by row of the matrix
    static constexpr int of_point[]{2, 3, 3, 4}, of_slice[]{3, 4, 4, 6}, of_three[]{3, 4, 5, 4, 6, 7, 5, 7, 8};
    std::vector<double> means, covariances, evidence;
    const int n = shared.with([&](Filter& f) {
        require(first <= f.particles() && count <= f.particles() - first, "particles of the filter");
        const LandmarkView view = checked_view(f, id);
        const Blocks& rows = *view.numbers;
        const bool oriented = f.identified() ? f.identified()->oriented() : anonymous(f).oriented();
        const int coordinates = oriented ? 3 : 2;
        const int* const entries = oriented ? of_three : rows.rows() != point_rows ? of_slice : of_point;
        for (std::size_t i = first; i < first + count; ++i) {
            const std::size_t at = view.at(i);
            for (int k = 0; k < coordinates; ++k) means.push_back(rows.at(k, at));
            for (int k = 0; k < coordinates * coordinates; ++k) covariances.push_back(rows.at(entries[k], at));
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

void bind_motion(nb::class_<SharedFilter>& c) {
    c.def("move_by_control", [](SharedFilter& s, std::uint64_t key, std::array<double, 6> u, bool corrects) {
        s.with([&](Filter& f) { f.move({ControlMotion{u[0], u[1], u[2], u[3], u[4], u[5]}, key}, corrects); });
    });
    c.def("move_by_gaussian", [](SharedFilter& s, std::uint64_t key, Numbers mean, Numbers covariance, bool corrects) {
        require(mean.size() == 3 && covariance.size() == 9, "a mean (3,) and a covariance (3, 3)");
        const WholeMotion motion{three_of(mean), six_of(covariance)};
        s.with([&](Filter& f) { f.move({motion, key}, corrects); });
    });
    c.def("end_step", [](SharedFilter& s) { s.with([](Filter& f) { f.end_step(); }); });
}

void bind_maps(nb::class_<SharedFilter>& c) {
    c.def(
        "use_ids",
        [](SharedFilter& s, bool oriented, std::size_t jointly, std::optional<std::array<double, 2>> range_noise) {
            std::optional<RangeNoise> noise;
            if (range_noise) noise = {(*range_noise)[0], (*range_noise)[1]};
            s.with([&](Filter& f) { f.use_ids(oriented, jointly, noise); });
        },
        nb::arg("oriented"), nb::arg("jointly"), nb::arg("range_noise").none());
    c.def("use_no_ids", [](SharedFilter& s, bool oriented, double border, double merge_gate, std::size_t merge_interval,
                           std::array<double, 3> limits, Numbers confusion) {
        require(confusion.ndim() == 2 && confusion.shape(1) == confusion.shape(0) + 1, "probabilities (n, n + 1)");
        Confusion classes{confusion.shape(0), {confusion.data(), confusion.data() + confusion.size()}};
        s.with([&](Filter& f) {
            f.use_no_ids(oriented, {border, merge_gate, merge_interval, {limits[0], limits[1], limits[2]}},
                         std::move(classes));
        });
    });
    c.def("place", [](SharedFilter& s, LandmarkId id, Numbers mean, Numbers covariance) {
        require(covariance.size() == mean.size() * mean.size(), "a covariance of as many coordinates as the mean");
        const Vector m = three_of(mean);
        const Symmetric S = six_of(covariance);
        s.with([&](Filter& f) {
            require(!identified(f).oriented() || mean.size() == 3, "landmarks with a heading");
            identified(f).place(id, m, S);
        });
    });
    c.def("landmarks", [](SharedFilter& s) {
        return array(s.with([](Filter& f) {
            return f.identified() ? f.identified()->ids() : f.anonymous() ? f.anonymous()->ids() : std::vector<LandmarkId>{};
        }));
    });
    c.def("landmark", landmark);
    c.def("class_probabilities", [](SharedFilter& s, std::int64_t id, std::size_t particle) {
        return array(s.with([&](Filter& f) { return class_probabilities(f, id, particle); }));
    });
    // the slices of the pool, and how many landmarks were created so far
    c.def("pool", [](SharedFilter& s) {
        return s.with([](Filter& f) {
            return std::array<std::int64_t, 2>{static_cast<std::int64_t>(anonymous(f).slices()), anonymous(f).created()};
        });
    });
}

void bind_weighing(nb::class_<SharedFilter>& c) {
    c.def("weigh_known", [](SharedFilter& s, Numbers landmarks, Numbers z, Numbers q, In<bool> oriented) {
        const std::vector<Sighting> sightings = sightings_of(z, q);
        require(landmarks.size() == 3 * sightings.size() && oriented.size() == sightings.size(),
                "as many landmarks as sightings");
        const std::vector<Vector> places = records<Vector>(landmarks, sightings.size());
        std::vector<KnownSighting> known;
        for (std::size_t k = 0; k < sightings.size(); ++k) known.push_back({places[k], sightings[k], oriented.data()[k]});
        s.with([&](Filter& f) { f.weigh_known(known); });
    });
    c.def("weigh_identified", [](SharedFilter& s, Numbers64 ids, Numbers z, Numbers q, int version) {
        const std::vector<Sighting> sightings = sightings_of(z, q);
        require(ids.size() == sightings.size(), "as many ids as sightings");
        const auto landmarks = copy_of(ids);
        return s.with([&](Filter& f) {
            require(identified(f).oriented() == (z.shape(1) == 3), "sightings with as many columns as the first ones");
            return f.weigh_identified(landmarks, sightings, version_of(version));
        });
    });
    c.def("weigh_anonymous", [](SharedFilter& s, Numbers z, Numbers q, Numbers64 shown, int version) {
        const std::vector<Sighting> sightings = sightings_of(z, q);
        require(shown.size() == sightings.size() && !sightings.empty(), "as many classes as sightings");
        const auto classes = copy_of(shown);
        s.with([&](Filter& f) {
            require(anonymous(f).oriented() == (z.shape(1) == 3), "sightings with as many columns as the first ones");
            const auto count = static_cast<std::int64_t>(anonymous(f).confusion().classes);
            for (const std::int64_t k : classes) require(k >= 0 && k <= count, "classes from 0 to n");
            f.weigh_anonymous(sightings, classes, version_of(version));
        });
    });
    c.def("weigh_by", [](SharedFilter& s, Numbers log_likelihoods) {
        const auto given = copy_of(log_likelihoods);
        s.with([&](Filter& f) {
            require(given.size() == f.particles(), "a log likelihood for each particle");
            f.weigh_by(given);
        });
    });
    c.def("reweigh", [](SharedFilter& s) {
        const auto [possible, log_evidence, ess] = s.with([](Filter& f) { return f.reweigh(); });
        return nb::make_tuple(possible, log_evidence, ess);
    });
    c.def("branch", [](SharedFilter& s, In<Index> ancestors) {
        const auto a = copy_of(ancestors);
        s.with([&](Filter& f) {
            const auto count = static_cast<Index>(f.particles());
            require(a.size() == f.particles() && a.front() >= 0 && a.back() < count && std::is_sorted(a.begin(), a.end()),
                    "ancestors (N,) must ascend from 0 to N - 1 at most");
            f.branch(a);
        });
    });
    c.def("remember", [](SharedFilter& s) { s.with([](Filter& f) { f.remember(); }); });
}

void bind_state(nb::class_<SharedFilter>& c) {
    c.def_prop_ro("poses", [](SharedFilter& s) { return view_of(s.with([](Filter& f) { return f.poses(); })); });
    c.def_prop_ro("log_weights", [](SharedFilter& s) { return view_of(s.with([](Filter& f) { return f.log_weights(); })); });
    c.def("log_likelihoods",
          [](SharedFilter& s) { return array(s.with([](Filter& f) { return copy_of(f.log_likelihoods()); })); });
    c.def("weights", [](SharedFilter& s) { return array(s.with([](Filter& f) { return copy_of(f.weights()); })); });
    c.def_prop_ro("best", [](SharedFilter& s) { return s.with([](Filter& f) { return f.best(); }); });
    c.def_prop_ro("threads", [](SharedFilter& s) { return s.with([](Filter& f) { return f.ranges().count(); }); });
    c.def_prop_ro("stored_poses",
                  [](SharedFilter& s) { return s.with([](Filter& f) { return f.history().stored_rows(); }); });
    c.def_prop_ro("history_bytes", [](SharedFilter& s) { return s.with([](Filter& f) { return f.history().bytes(); }); });
    c.def("level", [](SharedFilter& s) { return s.with([](Filter& f) { return f.history().level(); }); });
    c.def("ancestors", [](SharedFilter& s, std::int64_t level) {
        return array(s.with([&](Filter& f) {
            if (level < 0 || level > f.history().level()) throw std::out_of_range("there is no such level");
            const Index* const ancestors = f.history().ancestors(level);
            std::vector<std::int64_t> out(f.particles());
            for (std::size_t i = 0; i < out.size(); ++i) out[i] = ancestors ? ancestors[i] : static_cast<std::int64_t>(i);
            return out;
        }));
    });
    // the particles of all steps: poses (T + 1, N, 3), log weights (T + 1, N), and their indices in the step before
    c.def("recorded", [](SharedFilter& s) {
        std::vector<double> poses, log_weights;
        std::vector<Index> parents;
        const auto [steps, particles] = s.with([&](Filter& f) {
            require(f.record() != nullptr, "a filter that keeps a record");
            for (const RecordedStep& step : f.record()->steps()) {
                for (std::size_t i = 0; i < f.particles(); ++i)
                    poses.insert(poses.end(), {step.poses->row(0)[i], step.poses->row(1)[i], step.poses->row(2)[i]});
                log_weights.insert(log_weights.end(), step.log_weights->row(0), step.log_weights->row(0) + f.particles());
                parents.insert(parents.end(), step.parents.begin(), step.parents.end());
            }
            return std::pair(f.record()->steps().size(), f.particles());
        });
        return nb::make_tuple(array(std::move(poses), {steps, particles, 3}),
                              array(std::move(log_weights), {steps, particles}),
                              array(std::move(parents), {steps, particles}));
    });
    c.def("trajectory", [](SharedFilter& s, std::size_t particle) {
        return rows_of(s.with([&](Filter& f) { return f.history().trajectory(checked_particle(f, particle)); }));
    });
    c.def("summary", [](SharedFilter& s) {
        History::Summary out = s.with([](Filter& f) {
            std::vector<double> weights(f.particles());
            for (std::size_t i = 0; i < weights.size(); ++i) weights[i] = numbers::exp(f.log_weights()->row(0)[i]);
            return f.history().summary(weights);
        });
        return nb::make_tuple(rows_of(out.means), array(std::move(out.distinct)));
    });
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
    nb::class_<SharedFilter> filter(m, "ParticleFilter");
    filter.def(nb::init<const Numbers&, std::size_t, bool>());
    bind_motion(filter);
    bind_maps(filter);
    bind_weighing(filter);
    bind_state(filter);
    filter.def("__deepcopy__", [](SharedFilter& s, nb::handle) {
        return s.with([](const Filter& f) { return std::make_unique<SharedFilter>(f); });
    });
    filter.def("__getstate__", [](SharedFilter&) {
        throw nb::type_error("a particle filter cannot be pickled; pickle its result(), or copy it with copy.deepcopy");
    });
    bind_random(m);
}

}  // namespace vmslam::python::filters_bindings
