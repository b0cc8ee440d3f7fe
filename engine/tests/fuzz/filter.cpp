#include <algorithm>
#include <numeric>

#include "input.hpp"
#include "vmslam/particles/filter.hpp"

namespace fuzz {

using namespace vmslam;
using namespace vmslam::particles;

namespace {

class Steps {
   public:
    explicit Steps(Input& input)
        : input_(input), kind_(static_cast<Kind>(input.below(3))), oriented_(input.one_in(2)), filter_(begin(input)) {
        if (kind_ == Kind::ids) {
            std::optional<RangeNoise> noise;
            if (input.one_in(3)) noise = {input.positive(0.1), input.positive(0.01)};
            filter_.use_ids(oriented_, input.one_in(2) ? 0 : input.below(8), noise);
            if (input.one_in(4)) filter_.place(3, input.place(2.0, 1.0), {0.1, 0.0, 0.1, 0.0, 0.0, 0.1});
        }
        if (kind_ == Kind::no_ids) filter_.use_no_ids(oriented_, options(input), confusion(input));
    }

    void step() {
        filter_.move(motion(), !input_.one_in(4));
        for (std::size_t scan = input_.below(3); scan > 0; --scan) {
            weigh();
            if (!filter_.reweigh().possible) continue;
            expect(filter_.weights()[filter_.best()] == 1.0, "the largest weight is 1");
            filter_.remember();
            if (input_.one_in(2)) branch();
        }
        filter_.end_step();
        look();
    }

    /// A copy draws the same numbers in the next step.
    void compare_copy() {
        Filter copy(filter_);
        const Motion next = motion();
        copy.move(next, false);
        filter_.move(next, false);
        const std::size_t count = filter_.particles();
        // as bits, because poses may be no numbers
        expect(std::equal(bytes(copy), bytes(copy) + count * sizeof(double), bytes(filter_)),
               "a copy continues as the filter");
    }

   private:
    enum class Kind { known, ids, no_ids };
    static Filter begin(Input& input) {
        Rows poses(3, input.between(1, 40));
        for (int row = 0; row < 3; ++row)
            for (std::size_t i = 0; i < poses.particles(); ++i) poses.row(row)[i] = input.number(1.0);
        return {std::move(poses), input.between(1, 2), input.one_in(2)};
    }
    static const char* bytes(const Filter& filter) { return reinterpret_cast<const char*>(filter.poses()->row(0)); }
    static AnonymousOptions options(Input& input) {
        const auto limit = [&](double size) { return input.one_in(2) ? std::nan("") : input.positive(size); };
        return {input.positive(20.0), input.positive(10.0), input.below(4), {limit(0.1), limit(5.0), limit(2.0)}};
    }
    static Confusion confusion(Input& input) {
        Confusion out{input.one_in(2) ? 0 : input.between(1, 3), {}};
        out.numbers.assign(out.classes * (out.classes + 1), 1.0 / static_cast<double>(std::max<std::size_t>(1, out.classes)));
        return out;
    }

    Motion motion() {
        if (input_.one_in(4))
            return {WholeMotion{{input_.number(0.5), 0.0, input_.number(0.3)}, {0.01, 0, 0.01, 0, 0, 0.01}}, input_.bits()};
        return {ControlMotion{input_.number(0.5), input_.number(0.5), input_.positive(0.1), input_.positive(0.1),
                              input_.positive(1.0), input_.positive(1e-4)},
                input_.bits()};
    }
    void weigh() {
        std::vector<particles::Sighting> sightings(input_.between(1, 6));
        for (auto& [z, variances] : sightings) {
            z = {input_.positive(3.0), input_.number(1.0), input_.number(1.0)};
            variances = {input_.positive(0.05), input_.positive(0.005), input_.positive(0.005)};
        }
        const auto version = static_cast<Version>(input_.below(3));
        std::vector<std::int64_t> names(sightings.size());
        if (kind_ == Kind::known) {
            std::vector<KnownSighting> known;
            for (const auto& one : sightings) {
                const double variance = input_.below(2) == 0 ? 0.0 : input_.positive(0.1);
                known.push_back({{input_.number(3.0), input_.number(3.0), 0.0},
                                 {variance, 0.0, variance, 0.0, 0.0, variance},
                                 one,
                                 oriented_});
            }
            filter_.weigh_known(known);
        } else if (kind_ == Kind::ids) {
            for (auto& name : names) name = static_cast<std::int64_t>(input_.below(8));
            filter_.weigh_identified(names, sightings, version);
        } else {
            for (auto& name : names)
                name = static_cast<std::int64_t>(input_.below(filter_.anonymous()->confusion().classes + 1));
            filter_.weigh_anonymous(sightings, names, version);
        }
    }
    void branch() {
        std::vector<double> sums(filter_.particles());
        std::partial_sum(filter_.weights().begin(), filter_.weights().end(), sums.begin());
        filter_.branch(evenly_spaced(sums, 0.37));
    }
    void look() {
        const auto particle = input_.below(filter_.particles());
        filter_.history().trajectory(particle);
        if (input_.one_in(4))
            filter_.history().summary(
                std::vector<double>(filter_.particles(), 1.0 / static_cast<double>(filter_.particles())));
        for (const LandmarkId id : filter_.landmarks()) filter_.view(id);
    }

    Input& input_;
    Kind kind_;
    bool oriented_;
    Filter filter_;
};

}  // namespace

void fuzz_filter(Input& input) {
    Steps steps(input);
    for (std::size_t t = input.between(1, 30); t > 0; --t) {
        steps.step();
        if (input.one_in(10)) steps.compare_copy();
    }
}

}  // namespace fuzz
