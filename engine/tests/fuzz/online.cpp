#include <map>
#include <string>

#include "input.hpp"
#include "vmslam/online/system.hpp"

namespace fuzz {

using namespace vmslam;
using namespace vmslam::online;

namespace {

/// A drive with loop closures, a lag and covariances at any time.
class Drive {
   public:
    explicit Drive(Input& input)
        : input_(input),
          oriented_(input.one_in(2)),
          sensor_(sensor(input)),
          system_(1e-7, static_cast<int>(input.between(1, 15))) {
        if (input.one_in(2)) system_.use_kernel(kernel(input), input.positive(1.0));
        poses_.push_back(system_.add_node());
        const Vector at = input.place(1.0, 1.0);
        const Triple start{at.x, at.y, at.t};
        system_.add_prior(poses_, {&start, 1}, {1e6, 0, 0, 0, 1e6, 0, 0, 0, 1e6}, false);
        system_.solve(poses_, {}, poses_);
    }

    void step() {
        const auto known = static_cast<Id>(system_.graph().nodes.size());
        const auto landmarks = landmarks_;
        std::vector<NewEdge> edges;
        const Id from = poses_.back();
        poses_.push_back(system_.add_node());
        const auto [z, omega] = measured(Control{input_.number(0.5), input_.number(0.5), input_.positive(1.0)});
        edges.push_back({{from, poses_.back()}, Kind::motion, true, z, omega});
        for (std::size_t k = input_.below(5); k > 0; --k) {
            const auto [known_one, fresh] = landmarks_.try_emplace(input_.below(12), -1);
            if (fresh) known_one->second = system_.add_node();
            const Measured seen = measured(sighting(input_), oriented_, sensor_);
            edges.push_back({{poses_.back(), known_one->second}, Kind::sighting, oriented_, seen.z, seen.omega});
        }
        const Id pose = poses_.back();
        const Symmetric W = input_.positive(100.0) * Symmetric{1, 0, 1, 0, 0, 1};
        if (input_.one_in(4)) {
            const Id other = poses_[input_.below(poses_.size() - 1)];
            edges.push_back({{other, pose}, Kind::relation, true, input_.place(2.0, 2.0), W});
        }
        if (input_.one_in(4)) {
            const Lever lever{input_.number(1.0), input_.number(1.0)};
            const bool oriented = input_.one_in(2), doubted = input_.one_in(2);
            edges.push_back({{pose, pose}, Kind::position, oriented, input_.place(20.0, 3.0), W, lever, doubted});
        }
        if (!landmarks_.empty() && input_.one_in(4)) {
            const Kind kind = input_.one_in(2) ? Kind::range : Kind::bearing;
            edges.push_back({{pose, landmarks_.begin()->second}, kind, false, {input_.positive(10.0), 0, 0}, {W.xx}});
        }
        if (system_.add(known, edges, {&poses_.back(), 1})) return;
        expect(system_.graph().nodes.size() == static_cast<std::size_t>(known), "a refused step leaves no node");
        poses_.pop_back();
        landmarks_ = landmarks;
    }

    void drop_oldest() {
        if (poses_.size() < 2) return;
        system_.marginalize(poses_.front(), {&poses_.back(), 1});
        poses_.erase(poses_.begin());
        if (!system_.crowded()) return;
        const std::vector<Id> number = system_.renumber();
        for (Id& pose : poses_) pose = number[pose];
        for (auto& [id, node] : landmarks_) node = number[node];
    }

    void look() {
        switch (input_.below(5)) {
            case 0: system_.relinearize({&poses_.back(), 1}); break;
            case 1: system_.complete(); break;
            case 2: system_.cost(); break;
            case 3: system_.values(poses_); break;
            default: system_.covariance({&poses_.back(), 1}, {&poses_.back(), 1});
        }
    }

    /// A saved system is the same when it is restored, and continues in its place.
    void save() {
        const std::string bytes = system_.save();
        OnlineSystem restored{0.0, 0};
        expect(restored.restore(bytes), "a saved system is restored");
        expect(restored.save() == bytes, "with all its numbers");
        OnlineSystem other{0.0, 0};
        expect(!other.restore(bytes.substr(0, input_.below(bytes.size()))), "a part of it is not");
        system_ = restored;
    }

   private:
    Input& input_;
    bool oriented_;
    edges::Sensor sensor_;
    OnlineSystem system_;
    std::vector<Id> poses_;
    std::map<std::size_t, Id> landmarks_;
};

}  // namespace

void fuzz_online(Input& input) {
    Drive drive(input);
    const std::size_t lag = input.between(1, 30);
    for (std::size_t t = input.between(1, 40); t > 0; --t) {
        drive.step();
        if (t < lag && input.one_in(2)) drive.drop_oldest();
        if (input.one_in(4)) drive.look();
        if (input.one_in(20)) drive.save();
    }
}

}  // namespace fuzz
