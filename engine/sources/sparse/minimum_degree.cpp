// Approximate minimum degree on a quotient graph (Amestoy, Davis and Duff, SIAM J. Matrix Anal. Appl. 17, 1996), with
// element absorption (also aggressive), mass elimination and indistinguishable nodes.
#include <algorithm>
#include <bit>
#include <cmath>
#include <numeric>

#include "vmslam/sparse/ordering.hpp"

namespace vmslam::sparse {
namespace {

/// The graph during elimination. Eliminating a node ties all its neighbours together. Instead of the edges between them the
/// node itself stays, as an element e, with the list Le of the nodes that it ties together. A node that is not yet eliminated
/// is a variable i, with the list Ei of its elements and then the list Ai of its neighbours by edges of the graph. Its
/// neighbours are Ai and the Le of all elements in Ei. No list ever becomes longer. Variables with the same neighbours become
/// one supervariable, whose weight is the number of its members.
///
/// The degree of a variable is the weight of its neighbours. For those of a new element p it is bounded from above by
///
///     |Ai \ i| + |Lp \ i| + sum over the other elements e of i of |Le \ Lp|,
///
/// which costs only one look at each list (it counts variables of several elements more than once).
class QuotientGraph {
   public:
    QuotientGraph(const Neighbours& graph, Node limit, std::span<const Node> stage)
        : QuotientGraph(graph.size(), 0, static_cast<Index>(graph.list.size()), stage) {
        std::copy(graph.start.begin(), graph.start.end() - 1, start_.begin());
        std::copy(graph.list.begin(), graph.list.end(), graph_.begin());
        for (Node i = 0; i < n_; ++i) {
            length_[i] = graph.degree(i);
            const bool dense = length_[i] > limit;
            if (!dense && !(length_[i] == 0 && stage_of(i) == now_)) continue;
            order_[dense ? --last_ : done_++] = i;
            weight_[i] = 0;
            alive_[i] = 0;
        }
        for (Node i = 0; i < n_; ++i) {
            if (weight_[i] == 0) continue;
            if (last_ < n_) {  // the dense nodes are left out
                Index q = start_[i];
                for (Index p = start_[i]; p < start_[i] + length_[i]; ++p)
                    if (alive_[graph_[p]]) graph_[q++] = graph_[p];
                length_[i] = static_cast<Node>(q - start_[i]);
            }
            degree_[i] = length_[i];
            if (stage_of(i) == now_) link(i, degree_[i]);
        }
    }

    /// With groups of nodes that are tied together as the first elements, behind the variables.
    QuotientGraph(Node nodes, std::span<const Index> sizes, std::span<const Index> members)
        : QuotientGraph(nodes, static_cast<Node>(sizes.size()), static_cast<Index>(2 * members.size()), {}) {
        Index place = 0;
        for (const Index i : members) ++elements_[i];
        for (Node i = 0; i < n_; place += elements_[i++]) start_[i] = place;
        const Index* member = members.data();
        for (Node e = n_; e < n_ + static_cast<Node>(sizes.size()); ++e) {
            start_[e] = place;
            length_[e] = degree_[e] = static_cast<Node>(sizes[e - n_]);
            for (; place < start_[e] + length_[e]; ++place, ++member) {
                graph_[place] = static_cast<Node>(*member);
                graph_[start_[*member] + length_[*member]++] = e;
            }
        }
        for (Node i = 0; i < n_; ++i) {
            for (Index p = start_[i]; p < start_[i] + length_[i]; ++p)
                for (const Node j : std::span(graph_).subspan(start_[graph_[p]], length_[graph_[p]]))
                    if (mark_[j] != stamp_ + i) mark_[j] = stamp_ + i, ++degree_[i];
            link(i, degree_[i] = std::max(degree_[i] - 1, 0));
        }
        stamp_ += n_;
    }

    /// Eliminate variables of the lowest degree, those of the present stage, until none is left; returns the order.
    Order eliminate() {
        while (done_ < last_) {
            const Node pivot = lowest_degree();
            if (pivot < 0) {
                start_stage();
                continue;
            }
            unlink(pivot);
            form_element(pivot);        // Lp, from the lists of the pivot and of its elements, which end here
            measure_overlaps();         // |Le \ Lp| of all other elements of the variables in Lp
            update_degrees(pivot);      // the bounds without |Lp \ i|; variables tied by p alone are eliminated with it
            merge_indistinguishable();  // variables of Lp with the same lists
            restore_degrees(pivot);     // add |Lp \ i| to the bounds; the variables go back into the lists by degree
            write(pivot);
        }
        return std::move(order_);
    }

   private:
    QuotientGraph(Node nodes, Node elements, Index entries, std::span<const Node> stage)
        : n_(nodes),
          last_(nodes),
          stage_(stage),
          graph_(entries * 3 / 2 + nodes + 1),
          start_(nodes + elements),
          free_(entries),
          length_(nodes + elements),
          elements_(nodes, 0),
          weight_(nodes, 1),
          degree_(nodes + elements, 0),
          alive_(nodes + elements, 1),
          mark_(nodes + elements, 0),
          head_(nodes + 1, -1),
          after_(nodes, -1),
          before_(nodes, -1),
          chain_(nodes, -1),
          tail_(nodes),
          bucket_(std::bit_ceil(static_cast<unsigned>(std::max(nodes, Node{1}))), -1),
          sibling_(nodes, -1),
          code_(nodes, 0),
          order_(nodes) {
        std::iota(tail_.begin(), tail_.end(), 0);
        if (!stage.empty()) now_ = *std::min_element(stage.begin(), stage.end());
    }

    Node stage_of(Node i) const { return stage_.empty() ? 0 : stage_[i]; }

    /// Put a variable into the list of those with degree d, and take it out again.
    void link(Node i, Node d) {
        degree_[i] = d;
        after_[i] = head_[d];
        before_[i] = -1;
        if (head_[d] >= 0) before_[head_[d]] = i;
        head_[d] = i;
    }

    void unlink(Node i) {
        const Node a = after_[i], b = before_[i];
        if (a >= 0) before_[a] = b;
        (b >= 0 ? after_[b] : head_[degree_[i]]) = a;
    }

    /// Take the variables of the next stage as candidates.
    void start_stage() {
        ++now_;
        lowest_ = 0;
        for (Node i = 0; i < n_; ++i)
            if (weight_[i] > 0 && stage_of(i) == now_) link(i, degree_[i]);
    }

    /// A variable of the lowest degree, or -1.
    Node lowest_degree() {
        while (lowest_ <= n_ && head_[lowest_] < 0) ++lowest_;
        return lowest_ > n_ ? -1 : head_[lowest_];
    }

    /// Copy the lists that are in use to the front of new memory, so that `needed` places are free.
    void make_room(Index needed) {
        const auto lists = static_cast<Node>(start_.size());
        Index total = 0;
        for (Node i = 0; i < lists; ++i)
            if (alive_[i]) total += length_[i];
        std::vector<Node> fresh(total + total / 2 + needed);
        free_ = 0;
        for (Node i = 0; i < lists; ++i) {
            if (!alive_[i]) continue;
            std::copy_n(graph_.begin() + start_[i], length_[i], fresh.begin() + free_);
            start_[i] = free_;
            free_ += length_[i];
        }
        graph_ = std::move(fresh);
    }

    /// The pivot becomes an element: the variables that it reaches directly or through its elements, which it absorbs. Their
    /// weights are negative until `restore_degrees`, so that each is counted once.
    void form_element(Node pivot) {
        const Node elements = elements_[pivot];
        Index needed = 0;
        for (Node s = 0; s < length_[pivot]; ++s) needed += s < elements ? length_[graph_[start_[pivot] + s]] : 1;
        if (elements > 0 && free_ + needed > static_cast<Index>(graph_.size())) make_room(needed + n_);
        pivot_weight_ = weight_[pivot];
        weight_[pivot] = -pivot_weight_;
        first_ = end_ = elements > 0 ? free_ : start_[pivot];
        reach_ = 0;
        for (Node s = 0; s <= elements; ++s) {
            Index low = start_[pivot] + elements, high = start_[pivot] + length_[pivot];
            if (s < elements) {
                const Node e = graph_[start_[pivot] + s];
                low = start_[e];
                high = low + length_[e];
                alive_[e] = 0;
            }
            for (Index p = low; p < high; ++p) {
                const Node i = graph_[p];
                if (weight_[i] <= 0) continue;
                reach_ += weight_[i];
                weight_[i] = -weight_[i];
                graph_[end_++] = i;
                if (stage_of(i) == now_) unlink(i);
            }
        }
        if (elements > 0) free_ = end_;
        start_[pivot] = first_;
        length_[pivot] = static_cast<Node>(end_ - first_);
    }

    /// |Le \ Lp| of every element e that meets the new one: |Le| minus the weights of the variables of Lp that have e in
    /// their lists.
    void measure_overlaps() {
        for (Index p = first_; p < end_; ++p) {
            const Node i = graph_[p], w = -weight_[i];
            for (Index q = start_[i]; q < start_[i] + elements_[i]; ++q) {
                const Node e = graph_[q];
                if (!alive_[e]) continue;
                if (mark_[e] >= stamp_)
                    mark_[e] -= w;
                else
                    mark_[e] = stamp_ + degree_[e] - w;
            }
        }
    }

    /// Bounds on the degrees of the variables of the new element. Elements that lie inside it are absorbed. Variables without
    /// other neighbours are eliminated with the pivot. The others get a hash of their lists.
    void update_degrees(Node pivot) {
        const unsigned mask = static_cast<unsigned>(bucket_.size()) - 1;
        for (Index p = first_; p < end_; ++p) {
            const Node i = graph_[p];
            const Index low = start_[i], middle = low + elements_[i], high = low + length_[i];
            Index q = low;
            Index external = 0;
            Index key = 0;
            for (Index r = low; r < middle; ++r) {
                const Node e = graph_[r];
                if (!alive_[e]) continue;
                const Index rest = mark_[e] - stamp_;
                if (rest > 0) {
                    external += rest;
                    graph_[q++] = e;
                    key += e;
                } else {
                    alive_[e] = 0;  // it lies inside the new element
                }
            }
            const Index kept = q - low;
            // the new element takes the entry of an absorbed element or an eliminated variable; there is at least one
            for (Index r = middle; r < high; ++r) {
                const Node j = graph_[r];
                if (weight_[j] <= 0) continue;
                external += weight_[j];
                graph_[q++] = j;
                key += j;
            }
            if (external == 0 && stage_of(i) == now_) {
                const Node w = -weight_[i];
                pivot_weight_ += w;
                reach_ -= w;
                weight_[i] = 0;
                alive_[i] = 0;
                chain_[tail_[pivot]] = i;
                tail_[pivot] = tail_[i];
                continue;
            }
            degree_[i] = static_cast<Node>(std::min<Index>(degree_[i], external));
            if (q > low + kept) graph_[q] = graph_[low + kept];
            graph_[low + kept] = pivot;
            elements_[i] = static_cast<Node>(kept + 1);
            length_[i] = static_cast<Node>(q - low + 1);
            code_[i] = static_cast<Node>(static_cast<unsigned>(key) & mask);
            sibling_[i] = bucket_[code_[i]];
            bucket_[code_[i]] = i;
        }
    }

    /// Variables with the same elements and variables become one: only those with the same hash are compared.
    void merge_indistinguishable() {
        for (Index p = first_; p < end_; ++p) {
            if (weight_[graph_[p]] >= 0) continue;
            const Node h = code_[graph_[p]];
            Node i = bucket_[h];
            bucket_[h] = -1;
            for (; i >= 0 && sibling_[i] >= 0; i = sibling_[i]) {
                stamp_ += n_;  // this also lifts the stamp above every |Le \ Lp| stored so far
                for (Index q = start_[i]; q < start_[i] + length_[i]; ++q) mark_[graph_[q]] = stamp_;
                Node previous = i;
                for (Node j = sibling_[i]; j >= 0; j = sibling_[j]) {
                    bool same = length_[j] == length_[i] && elements_[j] == elements_[i] && stage_of(j) == stage_of(i);
                    for (Index q = start_[j]; same && q < start_[j] + length_[j]; ++q) same = mark_[graph_[q]] == stamp_;
                    if (!same) {
                        previous = j;
                        continue;
                    }
                    weight_[i] += weight_[j];
                    weight_[j] = 0;
                    alive_[j] = 0;
                    chain_[tail_[i]] = j;
                    tail_[i] = tail_[j];
                    sibling_[previous] = sibling_[j];
                }
            }
        }
        stamp_ += n_ + 1;
    }

    /// The variables go back to the lists by degree; eliminated ones leave the new element.
    void restore_degrees(Node pivot) {
        const Node after = done_ + pivot_weight_;
        Index kept = first_;
        for (Index p = first_; p < end_; ++p) {
            const Node i = graph_[p], w = -weight_[i];
            if (w <= 0) continue;
            weight_[i] = w;
            const Node d = std::max(0, std::min(degree_[i] + reach_ - w, last_ - after - w));
            degree_[i] = d;
            if (stage_of(i) == now_) {
                link(i, d);
                lowest_ = std::min(lowest_, d);
            }
            graph_[kept++] = i;
        }
        if (free_ == end_) free_ = kept;
        length_[pivot] = static_cast<Node>(kept - first_);
        degree_[pivot] = reach_;
        weight_[pivot] = 0;
        if (kept == first_) alive_[pivot] = 0;
    }

    /// Write the members of the pivot to the order.
    void write(Node pivot) {
        for (Node i = pivot; i >= 0; i = chain_[i]) order_[done_++] = i;
    }

    Node n_, done_ = 0, last_, now_ = 0, lowest_ = 0;
    std::span<const Node> stage_;
    std::vector<Node> graph_;  ///< all lists: that of i begins at start_[i]; from free_ on there is room
    std::vector<Index> start_;
    Index free_;
    std::vector<Node> length_, elements_;  ///< of the list of a node; the number of its elements, which come first
    std::vector<Node> weight_, degree_;  ///< the weight is 0 once absorbed, and negative inside the new element
    std::vector<char> alive_;  ///< whether the list of a node is in use
    std::vector<Index> mark_;  ///< of an element that was met since the last stamp, |Le \ Lp| + stamp
    Index stamp_ = 1;  ///< marks below it are of earlier pivots
    std::vector<Node> head_, after_, before_;  ///< doubly linked lists of variables by degree
    std::vector<Node> chain_, tail_;  ///< the members of a supervariable, one after another
    std::vector<Node> bucket_, sibling_, code_;  ///< variables by the hash of their lists
    Order order_;
    // the element under construction: its place, and the weights of its variables and of the pivot
    Index first_ = 0, end_ = 0;
    Node reach_ = 0, pivot_weight_ = 0;
};

Order joined(const Reduced& reduced, const Order& tail) {
    Order order = reduced.head;
    order.reserve(order.size() + tail.size());
    for (const Node k : tail) order.push_back(reduced.nodes[k]);
    return order;
}

}  // namespace

Order minimum_degree(const Neighbours& graph, Node limit, std::span<const Node> stage) {
    return QuotientGraph(graph, limit, stage).eliminate();
}

Order minimum_degree(const Pattern& pattern, Node limit) {
    const Reduced reduced = without_low_degrees(pattern);
    return joined(reduced, minimum_degree(reduced.rest, limit, {}));
}

Order minimum_degree(Node nodes, std::span<const Index> sizes, std::span<const Index> members) {
    return QuotientGraph(nodes, sizes, members).eliminate();
}

Order nested_dissection(const Pattern& pattern, Node limit) {
    const Reduced reduced = without_low_degrees(pattern);
    const std::vector<Node> depth = separator_depths(reduced.rest, limit);
    const Node deepest = depth.empty() ? 0 : *std::max_element(depth.begin(), depth.end());
    std::vector<Node> stage(depth.size());
    for (std::size_t k = 0; k < depth.size(); ++k) stage[k] = depth[k] >= 0 ? deepest + 1 - depth[k] : 0;
    return joined(reduced, minimum_degree(reduced.rest, limit, stage));
}

Node degree_limit(Node nodes, double dense) {
    return dense < 0.0 ? nodes : static_cast<Node>(std::max(16.0, dense * std::sqrt(static_cast<double>(nodes))));
}

Order fill_reducing(const Pattern& pattern, const DissectionWorth& worth) {
    const Node n = pattern.size(), limit = degree_limit(n, 10.0);
    Order order = minimum_degree(pattern, limit);
    if (n < worth.smallest) return order;
    const double flops = flops_of(pattern, order);
    if (flops < worth.flops * static_cast<double>(2 * pattern.rows.size() - n)) return order;
    Order other = nested_dissection(pattern, limit);
    return flops_of(pattern, other) < flops ? other : order;
}

}  // namespace vmslam::sparse
