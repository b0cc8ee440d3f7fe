#include "vmslam/certificate/proof.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "vmslam/edges/arithmetic.hpp"
#include "vmslam/numbers/random.hpp"

namespace vmslam::certificate {
namespace {

constexpr double infinity = std::numeric_limits<double>::infinity();
/// The split of the information that is tried first, and those among which each edge may choose.
constexpr double first_share = 0.3, shares[] = {0.02, 0.05, 0.1, 0.2, 0.3, 0.45, 0.6, 0.8, 0.95};
/// The most times that the edges choose again.
constexpr int rounds = 8;
/// Factorisations spent on a lower bound where S is not positive definite.
constexpr int attempts = 9;
/// Residuals up to this part of what the edges measure count as zero: a solver stops at steps of 1e-9, not at the rounding
/// error of the state. The scale of the information does not matter here: at a wrong minimum of perfect measurements some
/// residuals are of the size of the world.
constexpr double negligible = 1e-6;

/// Hold one node of every piece that nothing ties to the world; the number of edges at each node.
std::vector<Index> hold_roots(std::span<const Edge> edges, std::span<char> free) {
    const auto n = static_cast<Index>(free.size());
    std::vector<Index> ends(n, 0), parent(n + 1);
    // node n is the world, which is also every node that is held
    std::iota(parent.begin(), parent.end(), 0);
    const auto root = [&](Index a) {
        for (; parent[a] != a; a = parent[a]) parent[a] = parent[parent[a]];
        return a;
    };
    // the lower number becomes the root, so that the first pose of a piece is held
    const auto join = [&](Index a, Index b) {
        a = root(a), b = root(b);
        if (a != b) parent[std::max(a, b)] = std::min(a, b);
    };
    for (const Edge& edge : edges) {
        if (edge.first >= 0) ++ends[edge.first];
        ++ends[edge.second];
        join(edge.first >= 0 ? edge.first : n, edge.second);
    }
    for (Index k = 0; k < n; ++k)
        if (!free[k]) join(n, k);
    const Index world = root(n);
    for (Index k = 0; k < n; ++k)
        if (parent[k] == k && k != world) free[k] = false;
    return ends;
}

}  // namespace

std::vector<double> rounding_of(const sparse::Symbolic& symbolic) {
    std::vector<double> out;
    out.reserve(symbolic.row_length.size());
    for (const sparse::Node length : symbolic.row_length) out.push_back(2 * roundoff * (16.0 + 4.0 * length));
    return out;
}

std::vector<double> factor_errors(const sparse::Symbolic& symbolic, std::span<const double> rounding) {
    std::vector<double> squares(rounding.size(), 0.0);
    std::vector<sparse::Node> rows;
    for (sparse::Node s = 0; s < symbolic.supernodes(); ++s) {
        rows.clear();
        for (sparse::Node k = symbolic.first[s]; k < symbolic.first[s + 1]; ++k) rows.push_back(k);
        rows.insert(rows.end(), symbolic.rows.begin() + symbolic.row_start[s],
                    symbolic.rows.begin() + symbolic.row_start[s + 1]);
        double sum = 0.0;
        for (const sparse::Node k : rows) sum += 2 * std::sqrt(rounding[k]);
        for (const sparse::Node k : rows) squares[k] += sum * sum;
    }
    for (std::size_t k = 0; k < squares.size(); ++k) squares[k] = 1.001 * std::sqrt(rounding[k] * squares[k]);
    return squares;
}

double square_bound(HermitianFactor& factor, std::span<const Complex> b, std::span<const double> rounding) {
    const double lost = 1.001 + std::sqrt(2 * std::accumulate(rounding.begin(), rounding.end(), 0.0));
    return factor.forward_square(b) * lost * lost;
}

void Proof::begin(std::span<const double> state, std::vector<char> free) {
    // relative to the first node: errors of rounding would grow with its distance from the origin of the world (UTM
    // coordinates are millions of metres); the rounding of these differences is part of `place_error`
    const Complex origin = state.empty() ? Complex{} : Complex{state[0], state[1]};
    state_.set(state, origin);
    for (Edge& edge : edges)
        if (edge.first < 0) edge.d_a -= origin;
    free_ = std::move(free);
    summation_.clear();
    for (const Index ends : hold_roots(edges, free_))
        summation_.push_back(roundoff * (128.0 + 4.0 * static_cast<double>(ends)));
    forces_.resize(edges.size());
    curves_.resize(edges.size());
    for (std::size_t e = 0; e < edges.size(); ++e) {
        const Edge& edge = edges[e];
        forces_[e] = force(state_[edge.first], state_[edge.second], edge);
        curves_[e] = curvature(edge, forces_[e], first_share);
    }
    write_function(function_, curves_);
}

void Proof::write_function(QuadraticBound& out, std::span<const Curvature> curves) const {
    write_quadratic_bound(state_, edges, free_, pattern_, forces_, curves, out);
}

std::vector<Curvature> Proof::curvatures_for(double share) const {
    std::vector<Curvature> curves;
    for (std::size_t e = 0; e < edges.size(); ++e) curves.push_back(curvature(edges[e], forces_[e], share));
    return curves;
}

QuadraticBound Proof::function_of(double share) const {
    QuadraticBound out;
    write_function(out, curvatures_for(share));
    return out;
}

double Proof::cost() const {
    return std::accumulate(forces_.begin(), forces_.end(), 0.0, [](double sum, const Force& f) { return sum + f.cost; });
}

bool Proof::zero() const {
    if (std::all_of(forces_.begin(), forces_.end(), [](const Force& f) { return f.zero; })) return true;
    double size = 0.0;
    for (std::size_t e = 0; e < edges.size(); ++e)
        if (edges[e].first >= 0) size = std::max(size, length(forces_[e].reached) + length(edges[e].d_b));
    for (std::size_t e = 0; e < edges.size(); ++e) {
        const Edge& edge = edges[e];
        const double turned = vmslam::edges::wrap(state_[edge.second].heading - state_[edge.first].heading - edge.turn);
        if (!(length(forces_[e].reached - edge.d_a) <= negligible * size)) return false;
        if (edge.oriented && !(std::abs(turned) <= negligible)) return false;
    }
    return true;
}

/// Factorise S with `shifts` on its diagonal entries for headings, less bounds on the rounding errors; false where S is not
/// proven positive definite.
///
/// S is at least the matrix as assembled minus `rounded_off`. L L^H is at most the same matrix minus `rounded_off` and
/// `margin` (2 N), so that S is at least L L^H plus `margin`.
bool Proof::factorize(std::span<const double> shifts, std::vector<double>& margin) {
    const std::vector<double>& scale = function_.scale;
    const sparse::Order& order = factor_.symbolic().order;
    margin.assign(scale.size(), 1.0);
    values_ = function_.values;
    for (std::size_t k = 0; k < order.size(); ++k)
        for (int c = 0; c < 2; ++c) {
            const Index i = order[k], at = 2 * i + c;
            double change = 1.0;  // where a node is not free, or no edge depends on this number of it
            if (scale[at] > 0) {
                const double shift = c == 0 ? shifts[i] : 0.0, size = scale[at] + shift;
                const double rounded_off = summation_[i] * size;  // a bound on the rounding errors of the sums over edges
                margin[at] = rounded_off + errors_[k] * size;
                change = shift - rounded_off - 2 * margin[at];
            }
            values_[4 * (pattern_.start[i + 1] - 1) + 3 * c] += change;
        }
    negative_.clear();
    const Index bad = factor_.factorize(values_);
    if (bad >= 0) negative_ = factor_.null_vector(bad);
    return bad < 0;
}

/// The bound with `shift`, in units of the scale of S, times abs(z_i)² - 1 added to the function for each node. That is zero
/// for all states, and large shifts make S positive definite. But the candidate is then no longer the minimum of the
/// function.
double Proof::shifted_bound(double shift) {
    std::vector<double> shifts(state_.size()), margin;
    for (Index i = 0; i < state_.size(); ++i) shifts[i] = shift * function_.scale[2 * i] / 8;
    if (!factorize(shifts, margin)) return -infinity;
    std::vector<Complex> gradient = function_.gradient;
    double lost = 0.0;
    for (std::size_t at = 0; at < margin.size(); ++at) {
        const Index i = static_cast<Index>(at / 2);
        const double moved = at % 2 == 0 ? shifts[i] : 0.0;
        if (free_[i]) gradient[at] += moved * state_[i].z;
        const double error = summation_[i] * (function_.error[at] + moved);
        lost += error * error / margin[at];
    }
    const double step = std::sqrt(square_bound(factor_, gradient, rounding_)) + 1.001 * std::sqrt(lost);
    return function_.touched - step * step - function_.slack;
}

/// The best lower bound among a few shifts, and the least of these with which S is positive definite.
Proof::Shifted Proof::least_shift() {
    Shifted found{shifted_bound(0.0), 0.0, true};
    if (negative_.empty()) return found;
    found.factored = false;
    double low = 0.0, high = 1e-6;
    for (int k = 0; k < attempts; ++k) {
        const double middle = !found.factored ? high : low > 0 ? std::sqrt(low * high) : high / 10;
        found.best = std::max(found.best, shifted_bound(middle));
        if (negative_.empty()) {
            high = found.shift = middle;
            found.factored = true;
        } else {
            low = middle;
            if (!found.factored) high *= 10;
        }
    }
    if (found.factored && !negative_.empty()) shifted_bound(found.shift);
    return found;
}

/// About the smallest direction (N, 2) of S against its scale, by inverse iteration with the shifted factor.
std::vector<Complex> Proof::smallest() {
    const std::vector<double>& scale = function_.scale;
    std::vector<Complex> x(scale.size()), weighted(scale.size());
    for (std::size_t at = 0; at < x.size(); ++at) x[at] = numbers::normal_pair<double>(0, at, 0).first;
    for (int k = 0; k < 5; ++k) {
        for (std::size_t at = 0; at < x.size(); ++at) weighted[at] = std::max(scale[at], 0.0) * x[at];
        factor_.solve(weighted, x);
        double square = 0.0;
        for (std::size_t at = 0; at < x.size(); ++at) square += std::max(scale[at], 0.0) * std::norm(x[at]);
        for (auto& value : x) value /= std::sqrt(square);
    }
    return x;
}

/// Average the split of each edge with the choice that is best in the smallest direction x of S. Its part of x^H S x has beta
/// times the square by which x stretches the edge, and A times the square by which x turns it.
void Proof::choose_splits(std::span<const std::vector<Curvature>> choices, double part) {
    const std::vector<Complex> x = smallest();
    const auto change = [&](Index node, int c) { return node >= 0 ? x[2 * node + c] : Complex{}; };
    for (std::size_t e = 0; e < edges.size(); ++e) {
        const auto [a, b] = std::pair(edges[e].first, edges[e].second);
        const Complex za = change(a, 0), zb = change(b, 0);
        const double stretched = square(change(b, 1) - change(a, 1) + zb * edges[e].d_b - za * forces_[e].reached);
        const double turned = square(zb * state_[a].z * conj(state_[b].z) - za);
        const auto gain = [&](const std::vector<Curvature>& choice) {
            return choice[e].beta < 0 ? -infinity : choice[e].beta * stretched + choice[e].A * turned;
        };
        const auto best = std::max_element(choices.begin(), choices.end(),
                                           [&](const auto& one, const auto& other) { return gain(one) < gain(other); });
        const Curvature& chosen = (*best)[e];
        Curvature& curve = curves_[e];
        curve = {curve.beta < 0 || chosen.beta < 0 ? -1.0 : (1 - part) * curve.beta + part * chosen.beta,
                 (1 - part) * curve.A + part * chosen.A, std::max(curve.error, chosen.error),
                 std::max(curve.slack, chosen.slack)};
    }
}

double Proof::raised_bound() {
    std::vector<std::vector<Curvature>> choices;
    for (const double share : shares) choices.push_back(curvatures_for(share));
    double best = -infinity;
    for (int k = 0; k < rounds; ++k) {
        const Shifted found = least_shift();
        best = std::max(best, found.best);
        if (found.shift == 0.0 || !found.factored) break;
        choose_splits(choices, 2.0 / (k + 3));
        write_function(function_, curves_);
    }
    return best;
}

sparse::OwnedPattern pattern_of(std::span<const Edge> edges, Index nodes) {
    std::vector<Index> sizes, tied;
    for (const Edge& edge : edges) {
        if (edge.first < 0) continue;
        sizes.push_back(2);
        tied.insert(tied.end(), {std::min(edge.first, edge.second), std::max(edge.first, edge.second)});
    }
    return sparse::pattern_of_groups(nodes, sizes, tied);
}

std::vector<char> points_of(std::span<const Edge> edges, Index nodes) {
    std::vector<char> points(nodes, 1);
    for (const Edge& edge : edges) {
        if (edge.first >= 0) points[edge.first] = 0;
        // see `write_quadratic_bound`
        if (edge.oriented || edge.d_b != Complex{}) points[edge.second] = 0;
    }
    return points;
}

namespace {

/// A sum of products, each of three numbers between -1 and 1, as numbers whose sum it is exactly.
class ExactSum {
   public:
    void add(double a, double b, double c) {
        const Exact two = two_product(a, b), high = two_product(two.value, c), low = two_product(two.error, c);
        for (const double term : {high.value, high.error, low.value, low.error}) add(term);
        // below that, errors of products are no numbers any more
        exact_ = exact_ && (two.value == 0 || std::abs(two.value) > smallest) &&
                 (high.value == 0 || std::abs(high.value) > smallest);
    }
    /// Whether the sum is zero or more for certain.
    bool not_negative() const {
        // the parts grow and do not overlap, so that the last one that is not zero has the sign
        int last = count_ - 1;
        while (last > 0 && parts_[last] == 0) --last;
        return exact_ && parts_[last] >= 0;
    }

   private:
    static constexpr double smallest = 1e-200;

    // Shewchuk, Adaptive precision floating-point arithmetic and fast robust geometric predicates, 1997
    void add(double term) {
        for (int k = 0; k < count_; ++k) {
            const Exact sum = two_sum(term, parts_[k]);
            parts_[k] = sum.error;
            term = sum.value;
        }
        parts_[count_++] = term;
    }

    double parts_[24];  ///< four of each product, of at most six
    int count_ = 0;
    bool exact_ = true;
};

/// A matrix with entries of 1 on the diagonal, or 0; `more` is added to these.
edges::Symmetric scaled(const edges::Symmetric& w, double more) {
    const auto size = [](double x) { return x > 0 ? std::sqrt(x) : 1.0; };
    const double x = size(w.xx), y = size(w.yy), t = size(w.tt);
    return {w.xx / x / x + more, w.xy / x / y, w.yy / y / y + more, w.xt / x / t, w.yt / y / t, w.tt / t / t + more};
}

/// Eigenvalues of scaled information that are negative by less than this are so by rounding.
constexpr double rounded = 64 * roundoff;

/// The edges without a split, and the first of them without a lower bound; an edge with a split has one.
Judgement judge_information(const Proof& proof) {
    Judgement found{Finding::global};
    for (std::size_t e = 0; e < proof.edges.size(); ++e) {
        if (proof.curvatures()[e].beta >= 0) continue;
        ++found.unsplit;
        const edges::Symmetric& w = proof.edges[e].information;
        if (semidefinite(w)) continue;
        const bool indefinite = !semidefinite(scaled(w, rounded));
        if (found.edge >= 0 && !indefinite) continue;
        found.finding = indefinite ? Finding::indefinite : Finding::without_bound;
        found.edge = static_cast<Index>(e);
        if (indefinite) break;
    }
    return found;
}

}  // namespace

bool semidefinite(const edges::Symmetric& w) {
    if (!(w.xx >= 0 && w.yy >= 0 && w.tt >= 0)) return false;
    // by a power of two, which rounds nothing
    int exponent;
    std::frexp(std::max({w.xx, w.yy, w.tt, std::abs(w.xy), std::abs(w.xt), std::abs(w.yt)}), &exponent);
    bool lost = false;
    const auto part = [&](double x) {
        const double scaled = std::ldexp(x, -exponent);
        lost = lost || std::ldexp(scaled, exponent) != x;
        return scaled;
    };
    const double xx = part(w.xx), xy = part(w.xy), yy = part(w.yy), xt = part(w.xt), yt = part(w.yt), tt = part(w.tt);
    if (lost) return false;
    const auto minor = [](double a, double b, double c) {
        ExactSum sum;
        sum.add(a, c, 1.0);
        sum.add(-b, b, 1.0);
        return sum.not_negative();
    };
    if (!minor(xx, xy, yy) || !minor(xx, xt, tt) || !minor(yy, yt, tt)) return false;
    ExactSum determinant;
    determinant.add(xx, yy, tt);
    determinant.add(xy, yt, xt);
    determinant.add(xy, yt, xt);
    determinant.add(-xx, yt, yt);
    determinant.add(-yy, xt, xt);
    determinant.add(-tt, xy, xy);
    return determinant.not_negative();
}

Judgement judge(Proof& proof, double cost, bool thorough) {
    Judgement found = judge_information(proof);
    if (found.edge >= 0) return found;
    const double exact = proof.cost();
    if (std::max(cost, exact) <= proven && proof.zero()) {
        found.finding = Finding::zero;
        return found;
    }
    if (!(std::abs(exact - cost) <= proven * cost + proof.slack())) {
        found.finding = Finding::other_cost;
        return found;
    }
    double bound = proof.bound();
    found.direction = proof.negative();
    if (!found.direction.empty() && thorough) bound = proof.raised_bound();
    found.lowest = std::max(0.0, std::min(bound, cost));
    if (cost - found.lowest <= proven * cost)
        found.finding = Finding::global;
    else if (found.unsplit)
        found.finding = Finding::unsplit;
    else
        found.finding = found.direction.empty() ? Finding::not_stationary : Finding::negative;
    return found;
}

std::optional<Bound> lower_bound(std::span<const double> state, std::vector<Edge> edges) {
    const auto nodes = static_cast<Index>(state.size() / 3);
    const sparse::OwnedPattern pattern = pattern_of(edges, nodes);
    Proof proof(pattern, std::make_shared<const sparse::Symbolic>(
                             analyze(pattern, sparse::shape_of<sparse::Hermitian2>, 1, points_of(edges, nodes))));
    proof.edges = std::move(edges);
    proof.begin(state, std::vector<char>(nodes, 1));
    const double cost = proof.cost();
    if (!(std::isfinite(cost) && cost >= -proof.slack())) return std::nullopt;
    const Judgement found = judge(proof, cost, true);
    if (found.edge >= 0) return std::nullopt;
    return Bound{found.lowest, cost, found.global()};
}

}  // namespace vmslam::certificate
