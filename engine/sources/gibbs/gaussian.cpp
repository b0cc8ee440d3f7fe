#include "vmslam/gibbs/gaussian.hpp"

namespace vmslam::gibbs {

double fuse(Gaussian& mark, const Gaussian& observed, bool oriented) {
    if (!mark.seen()) {
        mark = observed;
        return 0.0;
    }
    const auto& [y, C] = observed;
    const Symmetric& S = mark.S;
    const Inverse W = inverse(S + C);
    const Vector r = deviation(mark.mean, y, oriented), g = W.matrix * r;
    // mean + S (S + C)^-1 r
    const Vector d = S * g;
    // S (S + C)^-1 C, in which nothing cancels; row by row of the first product
    const Vector a = W.matrix * Vector{S.xx, S.xy, S.xt}, b = W.matrix * Vector{S.xy, S.yy, S.yt};
    const Vector c = W.matrix * Vector{S.xt, S.yt, S.tt};
    const Vector x{C.xx, C.xy, C.xt}, second{C.xy, C.yy, C.yt}, third{C.xt, C.yt, C.tt};
    mark = {{mark.mean.x + d.x, mark.mean.y + d.y, wrap_angle(mark.mean.t + d.t)},
            {dot(a, x), dot(a, second), dot(b, second), dot(a, third), dot(b, third), dot(c, third)}};
    return log_density(r, W, g);
}

void Information::add_at(const Vector& q, const Symmetric& W, const Vector& g) {
    const Vector lever{-q.y, q.x, 1.0}, w = W * lever;
    eta = eta + Vector{g.x, g.y, dot(g, lever)};
    L = L + Symmetric{W.xx, W.xy, W.yy, w.x, w.y, dot(w, lever)};
}

void Information::add_sighting(const Frame& pose, const Gaussian& mark, const Gaussian& sighting, bool oriented) {
    const auto& [y, C] = sighting;
    const Vector q = relative(pose, mark.mean);
    Symmetric W = inverse(edges::turned(pose.axes.inverse(), mark.S) + C).matrix;
    if (!oriented) W = {W.xx, W.xy, W.yy, 0.0, 0.0, 0.0};
    add_at(q, W, W * deviation(y, q, oriented));
}

Symmetric passed(const Symmetric& W, const Symmetric& M) {
    const Symmetric P = inverse(W + M).matrix;
    const Vector x{W.xx, W.xy, W.xt}, y{W.xy, W.yy, W.yt}, t{W.xt, W.yt, W.tt};
    const Vector d = W * (P * x), e = W * (P * y), f = W * (P * t);
    return {W.xx - d.x, W.xy - d.y, W.yy - e.y, W.xt - d.t, W.yt - e.t, W.tt - f.t};
}

}  // namespace vmslam::gibbs
