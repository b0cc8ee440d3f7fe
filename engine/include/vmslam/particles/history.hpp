// The genealogy of the particles: the histories of all living particles, in little memory.
//
// The tree is stored in two flat arrays with one row per particle and level: the particle's pose, the row of its parent in the
// level before, and the particle's index at that level. A level is a step. Resampling copies nothing; it only changes the
// row to which each living particle points. Data written elsewhere at a level, by particle index (landmark columns, for
// example), can be read through the ancestors.
//
// Rows without living descendants are removed whenever the number of rows has about doubled since the last removal. The cost
// is constant per particle and step, and the memory is proportional to the tree of survivors, about T + N log N rows (Jacob,
// Murray and Rubenthaler, Path storage in the particle filter, Statistics and Computing 2015).
//
// Rejected: one array per step, combined on request, which took 0.4 s for the mean history of 21,000 steps.
#pragma once

#include <array>
#include <span>
#include <utility>

#include "vmslam/particles/rows.hpp"

namespace vmslam::particles {

/// The numbers of a landmark, and the particles' ancestors by which they are read; null numbers: there is none.
struct LandmarkView {
    const Blocks* numbers;
    const Index* ancestors;

    /// The place of a particle's numbers.
    std::size_t at(std::size_t particle) const {
        return ancestors ? static_cast<std::size_t>(ancestors[particle]) : particle;
    }
};

class History {
   public:
    explicit History(std::size_t particles);

    /// The number of stored poses.
    std::size_t stored_rows() const { return first_.back(); }
    std::size_t bytes() const;

    /// Make room for a level; then `write` its poses in any number of ranges that together cover all particles.
    void open_level(bool is_step = true);
    void write(const Rows& poses, std::size_t lo, std::size_t hi);
    /// Replace the poses of the last step, before the next `branch`.
    void amend(const Rows& poses, std::size_t lo, std::size_t hi);

    /// Let particle i descend from particle ancestors[i] from now on; ascending.
    void branch(std::span<const Index> ancestors);
    /// The level at which data can be written by the current particle indices: the last one, or after a `branch` a new one, which
    /// is opened.
    std::int64_t level_to_write();
    /// Whether every particle still has the index that it had at a level.
    bool is_living(std::int64_t level) const { return level >= living_ && !branched_; }
    /// The index that each living particle's ancestor had at a level, until the next `branch`; null: its own.
    const Index* ancestors(std::int64_t level);

    /// The history of one living particle: (x, y, theta) of each step.
    std::vector<std::array<double, 3>> trajectory(std::size_t particle) const;

    /// The weighted mean of all living histories, for weights that sum to 1, of the points at `lever` in the axes of the
    /// poses, the heading as the direction of the mean of (cos, sin); and the number of distinct ancestors of the living
    /// particles at each step.
    struct Summary {
        std::vector<std::array<double, 3>> means;
        std::vector<std::int64_t> distinct;
    };
    Summary summary(std::span<const double> weights, const std::array<double, 2>& lever = {});

    /// Remove the rows without living descendants.
    void prune();

   private:
    std::size_t levels() const { return first_.size() - 1; }
    std::vector<bool> rows_with_descendants(std::size_t* unchanged) const;
    Ancestry indices(std::size_t level) const;

    std::size_t particles_;
    std::vector<std::array<double, 3>> poses_;
    /// the row of the parent of each row, and the particle's index at that level
    struct Origin {
        Index parent, number;
    };
    std::vector<Origin> origins_;
    /// the row of each living particle
    std::vector<Index> line_;
    /// the first row of each level, and the end of the last one
    std::vector<std::size_t> first_{0};
    std::vector<bool> is_step_;
    /// The indices that the ancestors of the living particles had at each level, where `branch` was called at b and at c:
    ///
    ///     levels      before b       from b to c       since c
    ///     indices     inherited_     parent_           their own
    ///                                ^ previous_       ^ living_
    ///
    /// After a `branch` no level is the particles' own (`branched_`) until the next one is opened.
    std::int64_t living_ = 0, previous_ = 0;
    bool branched_ = false;
    Ancestry parent_;
    /// of the levels that were asked for
    std::vector<std::pair<std::int64_t, Ancestry>> inherited_;
    /// the number of levels when rows were last removed, and the number of rows from which on they are removed again
    std::size_t settled_ = 0, limit_;
};

}  // namespace vmslam::particles
