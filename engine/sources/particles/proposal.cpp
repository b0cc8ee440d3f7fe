#include "vmslam/particles/proposal.hpp"

#include <algorithm>

namespace vmslam::particles {

using namespace numbers;

namespace {

/// The proposal takes epsilon as at least this share of the variance of the motion, so that P has an inverse,
constexpr double least_share = 1e-10;
/// and as at least this variance [m², rad²], 10 nm, so that the rounding of poses does not count as noise.
constexpr double least_epsilon = 1e-16;
/// The conditional variances of a draw are at least this share of the variances before the sightings; below is rounding.
constexpr double rounding_share = 1e-14;

double positive_root(double x) { return std::sqrt(std::fmax(x, 0.0)); }

}  // namespace

double widened(double epsilon, double variance) {
    return std::fmax(std::fmax(epsilon, least_share * variance), least_epsilon);
}

double lacking(const Symmetric& P) {
    const double least = widened(0.0, P.xx + P.yy + P.tt);
    const LowerRoot L(P, true);
    const double smallest = std::min({L.xx, L.yy, L.tt});
    return smallest * smallest < least ? least : 0.0;
}

WeightedDraw::WeightedDraw(const Motion& motion) : motion_(motion) {
    const Prediction predicted = predict(motion, true);
    angle_ = predicted.angle, mean_ = predicted.mean;
    Symmetric P = predicted.covariance;
    P.xx += predicted.epsilon, P.yy += predicted.epsilon, P.tt += predicted.epsilon;
    whiten(P);
    const auto* const u = std::get_if<ControlMotion>(&motion.model);
    if (!u) return;
    const Chord f = chord(u->nu, u->omega, u->dt);
    along_nu_ = f.by_nu * u->nu_std, along_ = f.along * u->omega_std;
    across_ = f.across * u->omega_std, turn_ = f.turn * u->omega_std;
    scale_ = std::sqrt(u->epsilon / predicted.epsilon);
    b0_ = {along_nu_ * w00_, along_nu_ * w10_, along_nu_ * w20_};
    b1_ = {along_ * w00_, along_ * w10_ + across_ * w11_, along_ * w20_ + across_ * w21_ + turn_ * w22_};
    c00_ = positive_root(1 - b0_.x * b0_.x - b0_.y * b0_.y - b0_.t * b0_.t);
    c10_ = c00_ > 0.0 ? -(b0_.x * b1_.x + b0_.y * b1_.y + b0_.t * b1_.t) / c00_ : 0.0;
    c11_ = positive_root(1 - b1_.x * b1_.x - b1_.y * b1_.y - b1_.t * b1_.t - c10_ * c10_);
}

void WeightedDraw::whiten(const Symmetric& P) {
    const LowerRoot L(P);
    w00_ = 1 / L.xx, w11_ = 1 / L.yy, w22_ = 1 / L.tt;
    w10_ = -L.yx / (L.xx * L.yy), w21_ = -L.ty / (L.yy * L.tt);
    w20_ = -(L.tx / L.xx + L.ty * w10_) / L.tt;
    log_scale_ = numbers::log(L.determinant());
    least_position_ = rounding_share * (P.xx + P.yy), least_heading_ = rounding_share * P.tt;
}

Drawn WeightedDraw::operator()(const Pose& start, const Gaussian& belief, const Bits& particles) const {
    const auto [n0, n1, n2, n3, n4] = five_normals<Lanes>(motion_.key, particles);
    // x* = m+ + L+ n, L+ L+' = P+
    const Lanes l00 = root(larger(belief.xx, all<Lanes>(least_position_))), l10 = belief.xy / l00, l20 = belief.xh / l00;
    const Lanes l11 = root(larger(Lanes(belief.yy - l10 * l10), all<Lanes>(least_position_)));
    const Lanes l21 = (belief.yh - l20 * l10) / l11;
    const Lanes l22 = root(larger(Lanes(belief.hh - l20 * l20 - l21 * l21), all<Lanes>(least_heading_)));
    const Pose x{belief.x + l00 * n0, belief.y + l10 * n0 + l11 * n1, belief.h + l20 * n0 + l21 * n1 + l22 * n2};
    // the deviation d from the prediction in the axes of the chord, and a = L^-1 d
    const auto [s, c] = sincos(Lanes(start.t + angle_));
    const Lanes dx = x.x - start.x, dy = x.y - start.y;
    const Pose d{c * dx + s * dy - mean_.x, c * dy - s * dx - mean_.y, wrap_angle(Lanes(x.t - start.t - mean_.t))};
    const Pose a{w00_ * d.x, w10_ * d.x + w11_ * d.y, w20_ * d.x + w21_ * d.y + w22_ * d.t};
    // log p(x*) - log q(x*) = -(a'a)/2 - log det L + (n'n)/2 + log det L+
    const Lanes squares = n0 * n0 + n1 * n1 + n2 * n2 - a.x * a.x - a.y * a.y - a.t * a.t;
    const Lanes log_ratio = 0.5 * squares + (numbers::log(Lanes(l00 * l11 * l22)) - log_scale_);
    if (std::holds_alternative<WholeMotion>(motion_.model)) return {{x.x, x.y, wrap_angle(x.t)}, log_ratio};
    const Pose e = with_control(start, d, a, n3, n4);
    return {{e.x, e.y, wrap_angle(e.t)}, log_ratio};
}

// the noise c of the control that led to x*, e = d - A c, and what f does with c beyond its linearisation
Pose WeightedDraw::with_control(const Pose& start, const Pose& d, const Pose& a, const Lanes& n3, const Lanes& n4) const {
    const Lanes c0 = b0_.x * a.x + b0_.y * a.y + b0_.t * a.t + c00_ * n3;
    const Lanes c1 = b1_.x * a.x + b1_.y * a.y + b1_.t * a.t + c10_ * n3 + c11_ * n4;
    const Lanes e0 = scale_ * (d.x - along_nu_ * c0 - along_ * c1), e1 = scale_ * (d.y - across_ * c1);
    const Lanes e2 = scale_ * (d.t - turn_ * c1);
    const auto [s, c] = sincos(Lanes(start.t + angle_));
    const Pose moved = driven(start, std::get<ControlMotion>(motion_.model), c0, c1);
    return {moved.x + c * e0 - s * e1, moved.y + s * e0 + c * e1, moved.t + e2};
}

}  // namespace vmslam::particles
