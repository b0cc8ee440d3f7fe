"""Variances of known shape from residuals: maximum likelihood for e ~ t_nu(0, sum_p theta_p C_p), theta_p >= 0.

Every residual e (d,) has a scale matrix that is a sum of known parts C_p (d, d), each times an unknown variance theta_p
that all residuals share. The noise of a motion is such a sum (`MotionModel.accumulate` is linear in nn², sigma_v², ...),
and so is that of a sighting. The distribution is Student's t with nu degrees of freedom, which are estimated, too: a
few wrong residuals make nu small and hardly change the variances; where the residuals are Gaussian nu becomes large.

A variance near zero has no useful standard error, because the likelihood is not quadratic there. For a variance of less
than two standard errors the upper end of its 95 % interval is given instead: the largest value at which the profile
likelihood, the maximum over all other variances, is not lower than the maximum by more than 1.645² / 2.

Sources: Lange, Little and Taylor, *Robust statistical modeling using the t distribution*, JASA 84(408), 1989; Pawitan,
*In all likelihood*, 2001, section 3.4 (the profile likelihood).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from ..errors import LogError
from ..se2 import Array

#: limits of nu; at the upper one the distribution is practically Gaussian
MIN_NU, MAX_NU = 1.0, 1e4

#: the starts of the search: the fraction of the residuals that the parts explain together, and nu
STARTS = ((1.0, 10.0), (0.1, 4.0))

#: a part that explains less than the first fraction of the typical variance is zero; the second one is the upper limit
NEGLIGIBLE, MOST_EXPLAINED = 1e-7, 100.0

#: where the logarithm of a variance in its unit is below the first number, a descent may be stuck although the log likelihood
#: would rise by the second one; the most descents after the first one
NEAR_ZERO, CLEAR_GAIN, ESCAPES = float(np.log(1e-3)), 0.01, 5

#: the drop of the log likelihood at a one-sided 95 % bound; variances below this many standard errors have a bound
DROP, FEW_ERRORS = 1.645**2 / 2, 2.0


@dataclass(frozen=True)
class VarianceFit:
    """The result of `fit_variances`.

    Attributes:
        variances: {name of the part: theta_p}; 0 for parts that the data do not need.
        errors: {name: standard error of theta_p}, from the expected information of the Gaussian; NaN where it has no
            meaning, because theta_p is less than `FEW_ERRORS` of them.
        degrees: nu, infinite where the tails are Gaussian.
        log_likelihood: at the maximum.
        weights: (E,) the weight of each residual, (nu + d) / (nu + e' C^-1 e); 1 in the Gaussian case.
        count: the number E of residuals.
        bound: from the name of one of these parts to the upper 95 % bound of theta_p; infinite where the data give none.
    """

    variances: dict[str, float]
    errors: dict[str, float]
    degrees: float
    log_likelihood: float
    weights: Array
    count: int
    bound: Callable[[str], float]

    def errors_of_model(self) -> dict[str, float]:
        """The standard errors of the model's numbers: standard deviations, except for epsilon, which is a variance."""
        return {
            name: self.errors[name] if name == "epsilon" or not value > 0 else self.errors[name] / (2 * value**0.5)
            for name, value in self.variances.items()
        }

    def bounds_of_model(self) -> dict[str, float]:
        """The upper bounds of the model's numbers."""
        near_zero = {name: self.bound(name) for name, error in self.errors.items() if np.isnan(error)}
        return {name: bound if name == "epsilon" else bound**0.5 for name, bound in near_zero.items()}


def fit_variances(
    residuals: Array,
    parts: Mapping[str, Array],
    *,
    degrees: float | None = None,
    least: Mapping[str, float] | None = None,
    start: VarianceFit | None = None,
) -> VarianceFit:
    """The variances theta_p with the highest likelihood of the residuals.

    Args:
        residuals: (E, d).
        parts: {name: C_p (E, d, d)}, each symmetric and not negative; their sum must be invertible.
        degrees: of freedom nu; None to estimate them, infinity for Gaussian residuals.
        least: {name: the least theta_p}, for parts without which the covariance might not be invertible.
        start: a fit of similar residuals, to start from.

    Raises:
        LogError: there are fewer residuals than unknowns, or the residuals are all zero.
    """
    count, d = residuals.shape
    if count * d <= len(parts) + 1:
        raise LogError(f"{count} residuals are too few to estimate {len(parts)} variances from")
    if not residuals.any():
        raise LogError("all residuals are exactly zero, so there is no noise to estimate")
    likelihood = _Likelihood(residuals, parts, least or {}, degrees)
    begins = likelihood.starts() if start is None else [likelihood.position(start.variances, start.degrees)]
    # the likelihood may have several maxima, for example where parts are similar
    lowest, q = min((likelihood.search(begin) for begin in begins), key=lambda found: found[0])
    theta, nu = likelihood.theta(q), likelihood.nu(q)
    return VarianceFit(
        variances=dict.fromkeys(parts, 0.0) | likelihood.named(theta),
        errors=dict.fromkeys(parts, float("nan")) | likelihood.errors(theta, nu),
        degrees=nu,
        log_likelihood=-lowest * count,
        weights=likelihood.weights(theta, nu),
        count=count,
        bound=lambda name: likelihood.bound(name, q),
    )


class _Likelihood:
    """The likelihood as a function of q: the logarithms of the variances, in units of their own, and that of nu.

    Args:
        residuals, parts, least, degrees: as for `fit_variances`.
    """

    def __init__(
        self, residuals: Array, parts: Mapping[str, Array], least: Mapping[str, float], degrees: float | None
    ) -> None:
        self.names = [name for name, C in parts.items() if C.any()]
        self.residuals, self.degrees = residuals, degrees
        self.C = np.stack([parts[name] for name in self.names])
        self.floors = np.array([least.get(name, 0.0) for name in self.names])
        # the unit of each part is its share in the variance of the coordinate where it is largest
        size = np.einsum("peii->pi", self.C) / len(residuals)
        spread = np.mean(residuals**2, axis=0)
        spread = np.maximum(np.maximum(spread, 1e-12 * spread.mean()), self.floors @ size)
        self.unit = spread[size.argmax(axis=1)] / size.max(axis=1)
        self.low = np.log(np.maximum(NEGLIGIBLE, self.floors / self.unit))

    def named(self, values: Array) -> dict[str, float]:
        """{name of the part: value}."""
        return dict(zip(self.names, values.tolist()))

    def starts(self) -> list[Array]:
        """Where the search begins."""
        parts = len(self.names)
        return [np.append(np.full(parts, np.log(share / parts)), np.log(nu)) for share, nu in STARTS]

    def position(self, variances: Mapping[str, float], nu: float) -> Array:
        """The q of given variances and nu."""
        theta = np.array([variances[name] for name in self.names])
        return np.append(np.log(np.maximum(theta / self.unit, 10 * NEGLIGIBLE)), np.log(min(nu, MAX_NU)))

    def theta(self, q: Array) -> Array:
        """The variances. One at its lower limit becomes zero, or the least if the covariance is singular without it."""
        theta = self.unit * np.exp(q[:-1])
        for p in np.flatnonzero(q[:-1] <= self.low + np.log(10)):
            rest = np.tensordot(np.delete(theta, p), np.delete(self.C, p, axis=0), 1)
            own = self.floors[p] * np.einsum("eii->ei", self.C[p]).max(axis=1)
            theta[p] = 0.0 if np.all(np.linalg.eigvalsh(rest)[:, 0] > own) else self.unit[p] * np.exp(self.low[p])
        return theta

    def nu(self, q: Array) -> float:
        """The degrees of freedom."""
        nu = float(np.exp(q[-1])) if self.degrees is None else self.degrees
        return nu if nu < 0.9 * MAX_NU else np.inf

    def information(self, theta: Array) -> Array:
        """C_e^-1 (E, d, d)."""
        return _inverse(np.tensordot(theta, self.C, 1))[0]

    def weights(self, theta: Array, nu: float) -> Array:
        """The weight (E,) of each residual."""
        squares, _ = _moments(self.residuals, self.information(theta))
        return np.ones(len(squares)) if np.isinf(nu) else (nu + self.C.shape[-1]) / (nu + squares)

    def search(self, begin: Array, fixed: int | None = None) -> tuple[float, Array]:
        """The lowest negative log likelihood per residual, and its q; the part ``fixed`` stays where it begins.

        In logarithms the gradient of every variance near zero vanishes, also where the likelihood rises with this variance.
        The descent would end there, and where it ends would depend on where it begins (excesses of 54 in place of 0.1). So
        such variances take a step of Fisher's scoring, and the descent goes on.
        """
        limits = [(low, np.log(MOST_EXPLAINED)) for low in self.low] + [(np.log(MIN_NU), np.log(MAX_NU))]
        if fixed is not None:
            limits[fixed] = (begin[fixed], begin[fixed])
        # L-BFGS-B ends up to 0.2 below this likelihood, and six times as late where BLAS threads wait for busy cores
        from scipy.optimize import minimize

        def descend(q: Array) -> tuple[float, Array]:
            found = minimize(self._negative, q, jac=True, method="TNC", bounds=limits, options={"maxfun": 2000})
            return float(found.fun), np.asarray(found.x)

        lowest, q = descend(begin)
        for _ in range(ESCAPES):
            step, gain = self._scoring(q)
            gain[(q[:-1] > NEAR_ZERO) | (np.arange(len(gain)) == fixed)] = 0.0
            if gain.max() < CLEAR_GAIN:
                break
            freed = q.copy()
            freed[:-1] = np.where(gain >= CLEAR_GAIN, np.clip(np.log(step), q[:-1], 0.0), q[:-1])
            value, freed = descend(freed)
            if value >= lowest:
                break
            lowest, q = value, freed
        return lowest, q

    def _scoring(self, q: Array) -> tuple[Array, Array]:
        """The step (P,) of each variance alone by Fisher's scoring, in its unit, at least `NEGLIGIBLE`, and the gain (P,) of
        the log likelihood that it predicts, 0 for steps downwards."""
        theta = self.unit * np.exp(q[:-1])
        nu = float(np.exp(q[-1])) if self.degrees is None else self.degrees
        slopes = _log_likelihood(self.residuals, self.C, theta, nu)[1] * self.unit
        scaled = self.information(theta) @ (self.C * self.unit[:, None, None, None])
        information = np.maximum(0.5 * np.einsum("peij,peji->p", scaled, scaled), 1e-300)
        upwards = np.maximum(slopes, 0.0)
        return np.maximum(upwards / information, NEGLIGIBLE), upwards**2 / (2 * information)

    def errors(self, theta: Array, nu: float) -> dict[str, float]:
        """The errors of `VarianceFit` at the maximum."""
        errors = standard_errors(self.information(theta), self.C, theta, nu)
        errors[~(theta > np.maximum(FEW_ERRORS * errors, 1.001 * self.floors))] = np.nan
        return self.named(errors)

    def bound(self, name: str, q: Array) -> float:
        """The largest theta_p whose profile likelihood is lower than the maximum, at q, by at most `DROP`."""
        if name not in self.names:
            return float("inf")
        p = self.names.index(name)
        lowest, _ = self._negative(q)

        def excess(at: float) -> float:
            begin = q.copy()
            begin[p] = at
            return (self.search(begin, fixed=p)[0] - lowest) * len(self.residuals) - DROP

        high = np.log(MOST_EXPLAINED)
        if excess(high) < 0:
            return float("inf")
        from scipy.optimize import brentq

        return float(self.unit[p] * np.exp(brentq(excess, q[p], high, xtol=0.02)))

    def _negative(self, q: Array) -> tuple[float, Array]:
        theta, count = self.unit * np.exp(q[:-1]), len(self.residuals)
        nu = np.exp(q[-1]) if self.degrees is None else self.degrees
        value, by_theta, by_nu = _log_likelihood(self.residuals, self.C, theta, nu)
        by_nu = by_nu * nu if self.degrees is None else 0.0
        return -value / count, -np.append(by_theta * theta, by_nu) / count


def _moments(e: Array, information: Array) -> tuple[Array, Array]:
    """tr(W M) (E,) and W M W (E, d, d) with W = C_e^-1 and M = e e'."""
    pulled = np.einsum("eij,ej->ei", information, e)
    return np.einsum("ei,ei->e", e, pulled), pulled[:, :, None] * pulled[:, None, :]


def _inverse(C: Array) -> tuple[Array, Array]:
    """The inverses (E, d, d) and determinants (E,) of symmetric matrices, d at most 3, by cofactors.

    `numpy.linalg.inv` and `slogdet` together take five times as long for so many matrices that are so small.
    """
    if C.shape[1] == 1:
        return 1 / C, C[:, 0, 0]
    if C.shape[1] == 2:
        (a, b), (_, c) = C.transpose(1, 2, 0)
        cofactors = np.array([[c, -b], [-b, a]])
    else:
        (a, b, c), (_, d, e), (_, _, f) = C.transpose(1, 2, 0)
        u, v, w = d * f - e * e, c * e - b * f, b * e - c * d
        cofactors = np.array([[u, v, w], [v, a * f - c * c, b * c - a * e], [w, b * c - a * e, a * d - b * b]])
    determinants = np.sum(C[:, 0] * cofactors[0].T, axis=1)
    return (cofactors / determinants).transpose(2, 0, 1), determinants


def _log_likelihood(e: Array, C: Array, theta: Array, nu: float) -> tuple[float, Array, float]:
    """The log likelihood, its derivatives (P,) by theta, and the one by nu."""
    count, d = e.shape
    information, determinants = _inverse(np.tensordot(theta, C, 1))
    squares, outer = _moments(e, information)
    logdet = float(np.sum(np.log(np.maximum(determinants, 1e-300))))
    if np.isinf(nu):
        value = -0.5 * (logdet + float(squares.sum()) + count * d * np.log(2 * np.pi))
        weights, by_nu = np.ones(count), 0.0
    else:
        from scipy.special import digamma, gammaln

        constant = gammaln((nu + d) / 2) - gammaln(nu / 2) - d / 2 * np.log(nu * np.pi)
        tails = np.log1p(squares / nu)
        value = count * float(constant) - 0.5 * logdet - (nu + d) / 2 * float(tails.sum())
        weights = (nu + d) / (nu + squares)
        of_gamma = digamma((nu + d) / 2) - digamma(nu / 2) - d / nu
        by_nu = 0.5 * count * float(of_gamma) + 0.5 * float(np.sum(weights * squares / nu - tails))
    by_theta = 0.5 * np.einsum("eij,peij->p", weights[:, None, None] * outer - information, C)
    return value, by_theta, by_nu


def standard_errors(information: Array, C: Array, theta: Array, nu: float) -> Array:
    """The square roots of the diagonal of the inverse of the expected information (P,), NaN where theta is 0.

    For the Gaussian I_pq = 1/2 sum_e tr(Omega C_p Omega C_q); for t the same times (nu + d) / (nu + d + 2), less
    tr(Omega C_p) tr(Omega C_q) / (2 (nu + d + 2)).
    """
    d = information.shape[-1]
    live = theta > 0
    errors = np.full(len(theta), np.nan)
    scaled = information @ C[live]
    fisher = 0.5 * np.einsum("peij,qeji->pq", scaled, scaled)
    if not np.isinf(nu):
        traces = np.einsum("peii->pe", scaled)
        fisher = (nu + d) / (nu + d + 2) * fisher - traces @ traces.T / (2 * (nu + d + 2))
    # parts that are nearly alike make a singular matrix: their errors are large, not zero as in a pseudo-inverse
    unit = np.sqrt(np.maximum(np.diag(fisher), 1e-300))
    values, vectors = np.linalg.eigh(fisher / unit / unit[:, None])
    errors[live] = np.sqrt(np.sum(vectors**2 / np.maximum(values, 1e-12), axis=1)) / unit
    return errors
