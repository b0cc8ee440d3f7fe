// Elimination tree, column counts and relaxed supernodes.
#include <algorithm>
#include <numeric>

#include "vmslam/sparse/ordering.hpp"
#include "vmslam/sparse/symbolic.hpp"

namespace vmslam::sparse {
namespace {

// The cost of one supernode [ns]: of its own, for each number of its panel, each flop, and each number of the update matrix
// that the parent adds. Fitted by timing settings on seven pose graphs, a field of 10^4 poses and a path of 10^5.
constexpr double cost_node = 150.0, cost_panel = 2.0, cost_flop = 0.04, cost_update = 2.0;

double flops_of_columns(double width, double below) {
    return width * width * width / 3.0 + width * width * below + width * below * below;
}

double cost(int planes, double width, double below) {
    return cost_node + planes * (cost_panel * width * (width + below) + cost_update * 0.5 * below * below) +
           planes * planes * cost_flop * flops_of_columns(width, below);
}

/// The tree of columns during amalgamation: its children, and the columns of each supernode as a chain.
class ColumnTree {
   public:
    ColumnTree(const EliminationTree& tree, int planes)
        : planes_(planes),
          parent_(tree.parent),
          count_(tree.count),
          below_(tree.numbers),
          width_(tree.sizes),
          child_(tree.parent.size(), -1),
          sibling_(tree.parent.size(), -1),
          head_(tree.parent.size()),
          next_(tree.parent.size(), -1),
          cost_(tree.parent.size()) {
        std::iota(head_.begin(), head_.end(), 0);
    }

    Supernodes amalgamate() {
        for (Node p = 0; p < size(); ++p) {
            cost_[p] = cost(planes_, width_[p], below_[p]);
            // the children that add no zeros first, so that the others are compared with the full width
            for (const bool relaxed : {false, true}) merge_children(p, relaxed);
            if (const Node q = parent_[p]; q >= 0) {
                sibling_[p] = child_[q];
                child_[q] = p;
            }
        }
        return postordered();
    }

   private:
    Node size() const { return static_cast<Node>(parent_.size()); }

    void merge_children(Node p, bool relaxed) {
        Node previous = -1;
        for (Node c = child_[p], following; c >= 0; c = following) {
            following = sibling_[c];
            const Node w = width_[c] + width_[p];
            const bool merge =
                relaxed ? cost(planes_, w, below_[p]) < cost_[c] + cost_[p] : below_[c] == width_[p] + below_[p];
            if (!merge) {
                previous = c;
                continue;
            }
            cost_[p] = cost(planes_, w, below_[p]);
            width_[p] = w;
            next_[c] = head_[p];
            head_[p] = head_[c];
            // the grandchildren take the place of c; they are not tested again, as they were tested against c
            Node g = child_[c];
            (previous < 0 ? child_[p] : sibling_[previous]) = g >= 0 ? g : following;
            if (g < 0) continue;
            while (sibling_[g] >= 0) g = sibling_[g];
            sibling_[g] = following;
            previous = g;
        }
    }

    /// A stack instead of recursion: the tree of a path is as deep as the path is long.
    Supernodes postordered() {
        Supernodes result;
        result.columns.reserve(size());
        std::vector<Node> stack;
        for (Node root = 0; root < size(); ++root) {
            if (parent_[root] >= 0) continue;
            stack.push_back(root);
            while (!stack.empty()) {
                const Node p = stack.back(), c = child_[p];
                if (c >= 0) {
                    child_[p] = sibling_[c];
                    stack.push_back(c);
                    continue;
                }
                result.first.push_back(static_cast<Node>(result.columns.size()));
                result.below.push_back(count_[p] - 1);
                for (Node j = head_[p]; j >= 0; j = next_[j]) result.columns.push_back(j);
                stack.pop_back();
            }
        }
        result.first.push_back(size());
        return result;
    }

    int planes_;
    const std::vector<Node>&parent_, &count_;
    std::vector<Node> below_, width_;  ///< in numbers
    std::vector<Node> child_, sibling_, head_, next_;
    std::vector<double> cost_;
};

}  // namespace

Order inverse(std::span<const Node> order) {
    Order position(order.size());
    for (std::size_t k = 0; k < order.size(); ++k) position[order[k]] = static_cast<Node>(k);
    return position;
}

Node Pattern::fault() const {
    for (Node j = 0; j < size(); ++j) {
        Index previous = -1;
        for (Index p = start[j]; p < start[j + 1]; ++p) {
            if (rows[p] <= previous) return j;
            previous = rows[p];
        }
        if (previous != j) return j;
    }
    return -1;
}

RowLists permuted(const Pattern& pattern, std::span<const Node> position) {
    const Node n = pattern.size();
    RowLists lists{std::vector<Index>(n + 1, 0), {}};
    for (Node j = 0; j < n; ++j)
        for (Index p = pattern.start[j]; p < pattern.start[j + 1] - 1; ++p)
            ++lists.start[std::max(position[pattern.rows[p]], position[j]) + 1];
    for (Node k = 0; k < n; ++k) lists.start[k + 1] += lists.start[k];
    lists.columns.resize(lists.start[n]);
    std::vector<Index> fill(lists.start.begin(), lists.start.end() - 1);
    for (Node j = 0; j < n; ++j)
        for (Index p = pattern.start[j]; p < pattern.start[j + 1] - 1; ++p) {
            const auto [low, high] = std::minmax(position[pattern.rows[p]], position[j]);
            lists.columns[fill[high]++] = low;
        }
    return lists;
}

// Walking every row subtree costs one step for each block of L, which the factorisation pays tenfold; the near-linear count
// of Gilbert, Ng and Peyton would save less than 1 % of the analysis here.
EliminationTree::EliminationTree(const RowLists& lists, std::vector<Node> of_nodes)
    : parent(lists.start.size() - 1, -1),
      count(parent.size(), 1),
      row_length(parent.size(), 0),
      sizes(std::move(of_nodes)),
      numbers(parent.size(), 0) {
    std::vector<Node> mark(parent.size(), -1);
    for (Node k = 0; k < static_cast<Node>(parent.size()); ++k) {
        mark[k] = k;
        for (Index p = lists.start[k]; p < lists.start[k + 1]; ++p)
            for (Node i = lists.columns[p]; mark[i] != k; i = parent[i]) {
                if (parent[i] < 0) parent[i] = k;
                ++count[i];
                numbers[i] += sizes[k];
                ++row_length[k];
                mark[i] = k;
            }
    }
}

Index EliminationTree::blocks() const { return std::accumulate(count.begin(), count.end(), Index{0}); }

double EliminationTree::flops() const {
    double total = 0.0;
    for (std::size_t k = 0; k < sizes.size(); ++k) total += flops_of_columns(sizes[k], numbers[k]);
    return total;
}

double flops_of(const Pattern& pattern, std::span<const Node> order) {
    return EliminationTree(permuted(pattern, inverse(order)), std::vector<Node>(order.size(), 3)).flops();
}

Supernodes amalgamate(const EliminationTree& tree, int planes) { return ColumnTree(tree, planes).amalgamate(); }

}  // namespace vmslam::sparse
