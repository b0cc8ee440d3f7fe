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
      limits_(Block::rows * symbolic_->nodes()),
      rhs_(Block::planes * Block::rows * symbolic_->nodes()),
      work_(Block::planes * symbolic_->tallest) {
    for (Node s = 0; s < symbolic_->supernodes(); ++s) members_[symbolic_->part[s]].push_back(s);
    for (int part = 0; part < std::max(symbolic_->parts, symbolic_->threads); ++part)
        packed_.emplace_back(packing<Block>(symbolic_->widest, symbolic_->tallest));
}

template <class Block>
Index Factor<Block>::factorize_supernode(Node s, std::span<const Value> values, double damping, std::span<Numbers> scratch) {
    const Symbolic& t = *symbolic_;
    const Panel<Block> panel{panels_.data() + t.panel_start[s], t.front(s), scratch};
    const Step h = panel.front.height;
    std::memset(panel.x, 0, Block::columns * panel.front.w * h * sizeof(double));
    for (Index q = t.entry_start[s]; q < t.entry_start[s + 1]; ++q) {
        const Entry& entry = t.entries[q];
        Block::put(panel.node(entry.column) + panel.row(entry.row), h, values.data() + Block::size * entry.block(),
                   entry.transposed());
    }
    double* const limits = limits_.data() + Block::rows * t.first[s];
    for (Step j = 0; j < panel.front.w; ++j)
        for (int c = 0; c < Block::rows; ++c) {
            double& d = Block::diagonal(panel.node(j) + panel.row(j), h, c);
            d *= 1.0 + damping;
            limits[Block::rows * j + c] = d > 0.0 ? Block::tolerance * d : 0.0;
        }
    for (Node q = t.child_start[s]; q < t.child_start[s + 1]; ++q) {
        const Node c = t.children[q];
        extend<Block>(t.front(c), t.relative.data() + t.row_start[c], t.run_end.data() + t.row_start[c], 0, t.split[c],
                      updates_.data() + t.stack_start[c], panel.x, h, panel.front.pad, 0);
    }
    if (const Index bad = panel.factorize(limits); bad >= 0) return Block::rows * t.first[s] + bad;
    if (panel.front.r == 0) return -1;
    // only the columns are needed before the factorisation, so the update matrix is written by the product and never cleared
    double* const update = updates_.data() + t.stack_start[s];
    panel.update_matrix(update);
    for (Node q = t.child_start[s]; q < t.child_start[s + 1]; ++q) {
        const Node c = t.children[q];
        const Front front = t.front(c);
        extend<Block>(front, t.relative.data() + t.row_start[c], t.run_end.data() + t.row_start[c], t.split[c], front.r,
                      updates_.data() + t.stack_start[c], update, panel.front.update_height, panel.front.update_pad,
                      panel.front.w);
    }
    return -1;
}

template <class Block>
Index Factor<Block>::factorize_part(int part, std::span<const Value> values, double damping) {
    // the last part has all threads for itself
    const bool last = part + 1 == symbolic_->parts;
    const auto scratch = last ? std::span(packed_) : std::span(packed_).subspan(part, 1);
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
