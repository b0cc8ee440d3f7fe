// An online system as bytes, and back. Fields are written one by one, because what lies between them is undefined.
#include <algorithm>
#include <cstdint>
#include <cstring>
#include <tuple>
#include <type_traits>

#include "vmslam/online/system.hpp"

namespace vmslam::online {
namespace {

constexpr char title[] = "vmslam online 8";

auto fields(auto& value)
    requires std::is_same_v<std::remove_const_t<std::remove_reference_t<decltype(value)>>, Node>
{
    auto& [x, base, axes, base_axes, kept, diagonal, place_std, heading_std, changed, home, edges, owned, local, point, gone,
           held, borrows] = value;
    return std::tie(x, base, axes, base_axes, kept, diagonal, place_std, heading_std, changed, home, edges, owned, local,
                    point, gone, held, borrows);
}
auto fields(auto& value)
    requires std::is_same_v<std::remove_const_t<std::remove_reference_t<decltype(value)>>, Edge>
{
    auto& [z, omega, linear, weight, cost, squares, ends, next, owner, next_owned, place, lever, form, oriented, robust,
           sighting] = value;
    return std::tie(z, omega, linear, weight, cost, squares, ends, next, owner, next_owned, place, lever, form, oriented,
                    robust, sighting);
}
auto fields(auto& value)
    requires std::is_same_v<std::remove_const_t<std::remove_reference_t<decltype(value)>>, Supernode>
{
    auto& g = value;
    return std::tie(g.w, g.r, g.wide, g.tall, g.parent, g.child, g.sibling, g.frame, g.marked, g.ascending, g.absolute,
                    g.largest_decrease, g.separator_change, g.largest_squares, g.nodes, g.row, g.relative, g.run_end, g.seen,
                    g.numbers);
}
auto fields(auto& value)
    requires std::is_same_v<std::remove_const_t<std::remove_reference_t<decltype(value)>>, Prior>
{
    auto& [members, information, rhs, centre, relative, pivot, linear, pull, at, group] = value;
    return std::tie(members, information, rhs, centre, relative, pivot, linear, pull, at, group);
}
auto fields(auto& value)
    requires std::is_same_v<std::remove_const_t<std::remove_reference_t<decltype(value)>>, Memory>
{
    auto& m = value;
    return std::tie(m.cost, m.limit, m.bent.convex, m.bent.exact, m.hold, m.shrinks);
}

template <class T>
concept Record = requires(T& value) { fields(value); };

class Writer {
   public:
    std::string bytes;

    void raw(const void* from, std::size_t size) { bytes.append(static_cast<const char*>(from), size); }
    template <class T>
    void operator()(const std::vector<T>& values) {
        (*this)(values.size());
        for (const T& value : values) (*this)(value);
    }
    void operator()(const Numbers& numbers) {
        (*this)(numbers.size());
        raw(numbers.data(), numbers.size() * sizeof(double));
    }
    void operator()(const Supernode& group) {
        // what is above the diagonal of U has never been set
        Supernode whole = group;
        const Front front = whole.front();
        for (sparse::Index j = 0; j < 3 * front.r; ++j)
            std::fill_n(whole.update() + j * front.update_height, front.update_pad + j, 0.0);
        record(whole);
    }
    template <class T>
    void operator()(const T& value) {
        if constexpr (Record<const T>)
            record(value);
        else {
            static_assert(std::is_trivially_copyable_v<T>);
            raw(&value, sizeof value);
        }
    }

   private:
    void record(const auto& value) {
        std::apply([&](const auto&... field) { ((*this)(field), ...); }, fields(value));
    }
};

class Reader {
   public:
    explicit Reader(std::string_view bytes) : rest_(bytes) {}
    bool good = true;
    bool finished() const { return good && rest_.empty(); }

    void raw(void* to, std::size_t size) {
        good = good && size <= rest_.size();
        if (!good) return;
        if (size > 0) std::memcpy(to, rest_.data(), size);
        rest_.remove_prefix(size);
    }
    template <class T>
    void operator()(std::vector<T>& values) {
        std::size_t size = 0;
        (*this)(size);
        // an element has at least one byte
        if (size > rest_.size()) good = false;
        values.assign(good ? size : 0, T{});
        for (T& value : values) (*this)(value);
    }
    void operator()(Numbers& numbers) {
        std::ptrdiff_t size = 0;
        (*this)(size);
        if (size < 0 || static_cast<std::size_t>(size) > rest_.size() / sizeof(double)) good = false;
        if (!good) return;
        numbers = Numbers(size);
        raw(numbers.data(), size * sizeof(double));
    }
    template <class T>
    void operator()(T& value) {
        if constexpr (Record<T>)
            std::apply([&](auto&... field) { ((*this)(field), ...); }, fields(value));
        else {
            static_assert(std::is_trivially_copyable_v<T>);
            raw(&value, sizeof value);
        }
    }

   private:
    std::string_view rest_;
};

/// A number that changes with every byte (FNV-1a), by which damaged bytes are found.
std::uint64_t checksum(std::string_view bytes) {
    std::uint64_t sum = 0xcbf29ce484222325;
    for (const char byte : bytes) sum = (sum ^ static_cast<unsigned char>(byte)) * 0x100000001b3;
    return sum;
}

}  // namespace

std::string OnlineSystem::save() const {
    Writer write;
    write.raw(title, sizeof title);
    write(tolerance_), write(most_passes_), write(passes), write(converged), write(batch_solutions);
    write(graph_.nodes), write(graph_.edges), write(graph_.gains), write(graph_.has_single_numbers);
    for (const edges::Kernel& kernel : graph_.kernels) write(kernel.kind), write(kernel.c);
    write(tree_.groups), write(std::vector<Id>(tree_.released().begin(), tree_.released().end()));
    write(tree_.step), write(tree_.pivot_tolerance);
    write(priors_), write(memory_), write(ordered_), write(covariances_ready_), write(lost_);
    write(checksum(write.bytes));
    return std::move(write.bytes);
}

bool OnlineSystem::restore(std::string_view bytes) {
    std::uint64_t sum = 0;
    if (bytes.size() < sizeof sum) return false;
    std::memcpy(&sum, bytes.data() + bytes.size() - sizeof sum, sizeof sum);
    bytes.remove_suffix(sizeof sum);
    if (sum != checksum(bytes)) return false;
    Reader read(bytes);
    char found[sizeof title] = {};
    read.raw(found, sizeof found);
    if (!read.good || std::memcmp(found, title, sizeof title) != 0) return false;
    std::vector<Id> released;
    tree_.clear();
    read(tolerance_), read(most_passes_), read(passes), read(converged), read(batch_solutions);
    read(graph_.nodes), read(graph_.edges), read(graph_.gains), read(graph_.has_single_numbers);
    for (edges::Kernel& kernel : graph_.kernels) read(kernel.kind), read(kernel.c);
    read(tree_.groups), read(released);
    read(tree_.step), read(tree_.pivot_tolerance);
    read(priors_), read(memory_), read(ordered_), read(covariances_ready_), read(lost_);
    tree_.set_released(std::move(released));
    return read.finished();
}

}  // namespace vmslam::online
