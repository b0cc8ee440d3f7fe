#include "vmslam/sparse/factor.hpp"

#include <algorithm>
#include <cmath>

#include "sparse/supernode.hpp"

namespace vmslam::sparse {

template <class Block>
Factor<Block>::Factor(std::shared_ptr<const Symbolic> symbolic)
    : symbolic_(std::move(symbolic)),
      members_(symbolic_->parts),
      panels_(symbolic_->panel_start.back()),
      updates_(symbolic_->stack_size),
      limits_(symbolic_->head.back()),
      rhs_(Block::planes * symbolic_->head.back()),
      work_(Block::planes * symbolic_->tallest) {
    std::memset(rhs_.data(), 0, rhs_.size() * sizeof(double));
    for (Node s = 0; s < symbolic_->supernodes(); ++s) members_[symbolic_->part[s]].push_back(s);
    for (int part = 0; part < std::max(symbolic_->parts, symbolic_->threads); ++part)
        packed_.emplace_back(packing<Block>(symbolic_->widest, symbolic_->tallest));
}

template <class Block>
Index Factor<Block>::factorize_supernode(Node s, std::span<const Value> values, double damping, std::span<Numbers> scratch) {
    const Symbolic& t = *symbolic_;
    const Panel<Block> panel{panels_.data() + t.panel_start[s], t.front(s), scratch};
    const auto begin = t.begin<Block>(s);
    const Step h = panel.front.height;
    std::memset(panel.x, 0, Block::columns * panel.front.w * h * sizeof(double));
    for (Index q = t.entry_start[s]; q < t.entry_start[s + 1]; ++q) {
        const Entry& entry = t.entries[q];
        double* const at = panel.x + Block::planes * begin[entry.column] * h + panel.front.pad + begin[entry.row];
        const Value* const block = values.data() + Block::size * entry.block();
        if (entry.row_point() || entry.column_point()) [[unlikely]]
            put_of_points<Block>(at, h, block, entry);
        else
            Block::put(at, h, block, entry.transposed());
    }
    double* const limits = limits_.data() + t.head[s];
    // a front is filled up to whole blocks: rows after those that are used are rows of the identity
    const Step used = begin[t.width(s) - 1] + t.size(t.first[s + 1] - 1);
    for (Step i = 0; i < Block::rows * panel.front.w; ++i) {
        double& d = panel.x[i * (Block::planes * h + 1) + panel.front.pad];
        d = i < used ? d * (1.0 + damping) : 1.0;
        limits[i] = d > 0.0 ? Block::tolerance * d : 0.0;
    }
    for (Node q = t.child_start[s]; q < t.child_start[s + 1]; ++q) {
        const Node c = t.children[q];
        extend<Block>(t, c, 0, t.split[c], updates_.data() + t.stack_start[c], panel.x, h, panel.front.pad, 0);
    }
    if (const Index bad = panel.factorize(limits); bad >= 0) {
        // the node of this row of the front, and its number among all
        Node k = t.width(s) - 1;
        while (begin[k] > bad) --k;
        return Block::rows * (t.first[s] + k) + t.first_number(t.first[s] + k) + bad - begin[k];
    }
    if (panel.front.r == 0) return -1;
    // only the columns are needed before the factorisation, so the update matrix is written by the product and never cleared
    double* const update = updates_.data() + t.stack_start[s];
    panel.update_matrix(update);
    if (t.mixed<Block>()) panel.clear_above_diagonal(update);
    for (Node q = t.child_start[s]; q < t.child_start[s + 1]; ++q) {
        const Node c = t.children[q];
        extend<Block>(t, c, t.split[c], t.height_below(c), updates_.data() + t.stack_start[c], update,
                      panel.front.update_height, panel.front.update_pad, Block::rows * panel.front.w);
    }
    return -1;
}

template <class Block>
Index Factor<Block>::factorize_part(int part, std::span<const Value> values, double damping) {
    // the last part has all threads for itself
    const bool last = part + 1 == symbolic_->parts;
    const auto scratch = last ? std::span(packed_).first(symbolic_->threads) : std::span(packed_).subspan(part, 1);
    for (const Node s : members_[part])
        if (const Index bad = factorize_supernode(s, values, damping, scratch); bad >= 0) return bad;
    return -1;
}

template <class Block>
Index Factor<Block>::factorize(std::span<const Value> values, double damping) {
    const int last = symbolic_->parts - 1;
    std::vector<Index> bad(last, -1);
    if (last > 0) in_parallel(last, [&](int part) { bad[part] = factorize_part(part, values, damping); });
    // the first bad pivot in the order of elimination, as on one thread
    Index first = -1;
    for (const Index pivot : bad)
        if (pivot >= 0 && (first < 0 || pivot < first)) first = pivot;
    return first >= 0 ? first : factorize_part(last, values, damping);
}

template class Factor<Real2>;
template class Factor<Real3>;
template class Factor<Hermitian2>;

}  // namespace vmslam::sparse
