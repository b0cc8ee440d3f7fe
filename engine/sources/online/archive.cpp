// An online system as bytes, and back: its graph, its priors and the estimate. The tree follows from these.
#include <cstdint>
#include <cstring>
#include <type_traits>

#include "vmslam/online/system.hpp"

namespace vmslam::online {
namespace {

constexpr char title[] = "vmslam online 10";

/// Writes values, or reads them where there are bytes to read. Fields are named one by one, because what lies between them is
/// undefined.
class Archive {
   public:
    std::string written;
    bool good = true;

    Archive() = default;
    explicit Archive(std::string_view bytes) : rest_(bytes), reads_(true) {}
    bool finished() const { return good && rest_.empty(); }

    template <class... Values>
    void operator()(Values&... values) {
        (transfer(values), ...);
    }

   private:
    template <class T>
    void transfer(T& value) {
        static_assert(std::is_trivially_copyable_v<T>);
        if (!reads_) {
            written.append(reinterpret_cast<const char*>(&value), sizeof value);
            return;
        }
        good = good && sizeof value <= rest_.size();
        if (!good) return;
        rest_.copy(reinterpret_cast<char*>(&value), sizeof value);
        rest_.remove_prefix(sizeof value);
    }
    template <class T>
    void transfer(std::vector<T>& values) {
        std::size_t size = values.size();
        transfer(size);
        // an element has at least one byte
        good = good && (!reads_ || size <= rest_.size());
        if (reads_) values.assign(good ? size : 0, T{});
        for (T& value : values) transfer(value);
    }
    void transfer(edges::Kernel& k) { (*this)(k.kind, k.c); }
    void transfer(Node& n) { (*this)(n.x, n.place_std, n.heading_std, n.edges, n.point, n.gone, n.held, n.borrows); }
    void transfer(Edge& e) { (*this)(e.z, e.omega, e.lever, e.ends, e.next, e.kind, e.oriented, e.robust); }
    void transfer(Prior& p) { (*this)(p.members, p.information, p.rhs, p.centre, p.relative, p.pivot); }

    std::string_view rest_;
    bool reads_ = false;
};

/// A number that changes with every byte (FNV-1a), by which damaged bytes are found.
std::uint64_t checksum(std::string_view bytes) {
    std::uint64_t sum = 0xcbf29ce484222325;
    for (const char byte : bytes) sum = (sum ^ static_cast<unsigned char>(byte)) * 0x100000001b3;
    return sum;
}

}  // namespace

template <class Each>
void OnlineSystem::transfer(Each& each) {
    each(tolerance_, most_passes_, passes, converged, batch_solutions, ordered_);
    each(graph_.nodes, graph_.edges, graph_.gains, graph_.has_single_numbers, priors_);
    for (edges::Kernel& kernel : graph_.kernels) each(kernel);
}

std::string OnlineSystem::save() {
    // nodes that still have to follow their supernode are saved where they are; saving changes nothing here
    OnlineSystem moved = *this;
    moved.complete();
    Archive archive;
    moved.transfer(archive);
    std::uint64_t sum = checksum(archive.written);
    archive.written.append(title, sizeof title);
    archive(sum);
    return std::move(archive.written);
}

bool OnlineSystem::restore(std::string_view bytes) {
    std::uint64_t sum = 0;
    constexpr std::size_t tail = sizeof title + sizeof sum;
    if (bytes.size() < tail) return false;
    const char* const end = bytes.data() + bytes.size() - tail;
    std::memcpy(&sum, end + sizeof title, sizeof sum);
    bytes.remove_suffix(tail);
    if (std::memcmp(end, title, sizeof title) != 0 || sum != checksum(bytes)) return false;
    Archive archive(bytes);
    transfer(archive);
    if (!archive.finished()) return false;
    memory_ = {};
    memory_.bent = usual_bent();
    // the estimate is the one that was saved: the new tree does not move it
    if (begin_at(places(), {})) tree_.stay();
    return true;
}

}  // namespace vmslam::online
