"""Variances of known shape from residuals: maximum likelihood for e ~ t_nu(0, sum_p theta_p C_p), theta_p >= 0.

Every residual e (d,) has a scale matrix that is a sum of known parts C_p (d, d), each times an unknown variance theta_p
that all residuals share. The noise of a motion is such a sum (`MotionModel.accumulate` is linear in nn², sigma_v², ...),
and so is that of a sighting. The distribution is Student's t with nu degrees of freedom, which are estimated, too: a
few wrong residuals make nu small and hardly change the variances; where the residuals are Gaussian nu becomes large.

Source: Lange, Little and Taylor, *Robust statistical modeling using the t distribution*, JASA 84(408), 1989.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
from scipy.special import digamma, gammaln

from ..errors import LogError
from ..se2 import Array

#: limits of nu; at the upper one the distribution is practically Gaussian
FEWEST, MOST = 1.0, 1e4

#: the starts of the search: the fraction of the residuals that the parts explain together, and nu
STARTS = ((1.0, 10.0), (0.1, 4.0))

#: a part that explains less than the first fraction of the typical variance is zero; the second one is the upper limit
NEGLIGIBLE, MOST_EXPLAINED = 1e-7, 100.0


@dataclass(frozen=True)
class VarianceFit:
    """The result of `fit_variances`.

    Attributes:
        variances: {name of the part: theta_p}; 0 for parts that the data do not need.
        errors: {name: standard error of theta_p}, from the expected information of the Gaussian; NaN where theta_p is 0.
        degrees: nu, infinite where the tails are Gaussian.
        log_likelihood: at the maximum.
        weights: (E,) the weight of each residual, (nu + d) / (nu + e' C^-1 e); 1 in the Gaussian case.
        count: the number E of residuals.
    """

    variances: dict[str, float]
    errors: dict[str, float]
    degrees: float
    log_likelihood: float
    weights: Array
    count: int

    def errors_of_model(self) -> dict[str, float]:
        """The standard errors of the model's numbers: standard deviations, except for epsilon, which is a variance."""
        return {
            name: self.errors[name] if name == "epsilon" or not value > 0 else self.errors[name] / (2 * value**0.5)
            for name, value in self.variances.items()
        }


def fit_variances(
    residuals: Array, parts: Mapping[str, Array], *, degrees: float | None = None, start: VarianceFit | None = None
) -> VarianceFit:
    """The variances theta_p with the highest likelihood of the residuals.

    Args:
        residuals: (E, d).
        parts: {name: C_p (E, d, d)}, each symmetric and not negative; their sum must be invertible.
        degrees: of freedom nu; None to estimate them, infinity for Gaussian residuals.
        start: a fit of similar residuals, to start from.

    Raises:
        LogError: there are fewer residuals than unknowns, or the residuals are all zero.
    """
    names, C = list(parts), np.stack(list(parts.values()))
    count, d = residuals.shape
    if count * d <= len(names) + 1:
        raise LogError(f"{count} residuals are too few to estimate {len(names)} variances from")
    typical = np.mean(residuals**2)
    if typical == 0:
        raise LogError("all residuals are exactly zero, so there is no noise to estimate")
    # the unit of each part is its share in the variance of the coordinate where it is largest
    size = np.einsum("peii->pi", C) / count
    used = size.max(axis=1) > 0
    C, size, live = C[used], size[used], [name for name, use in zip(names, used) if use]
    spread = np.maximum(np.mean(residuals**2, axis=0), 1e-12 * typical)
    unit = spread[size.argmax(axis=1)] / size.max(axis=1)

    def negative(q: Array) -> tuple[float, Array]:
        theta = unit * np.exp(q[:-1])
        nu = np.exp(q[-1]) if degrees is None else degrees
        value, by_theta, by_nu = _log_likelihood(residuals, C, theta, nu)
        by_nu = by_nu * nu if degrees is None else 0.0
        return -value / count, -np.append(by_theta * theta, by_nu) / count

    bounds = [(np.log(NEGLIGIBLE), np.log(MOST_EXPLAINED))] * len(unit) + [(np.log(FEWEST), np.log(MOST))]
    best = None
    # the likelihood may have several maxima, for example where parts are similar
    begins = [np.append(np.full(len(unit), np.log(share / len(unit))), np.log(nu)) for share, nu in STARTS]
    if start is not None:
        before = np.array([start.variances[name] for name in live]) / unit
        begins = [np.append(np.log(np.maximum(before, 10 * NEGLIGIBLE)), np.log(min(start.degrees, MOST)))]
    for begin in begins:
        search = minimize(negative, begin, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 500})
        if best is None or search.fun < best.fun:
            best = search
    assert best is not None
    theta = unit * np.exp(best.x[:-1])
    theta[best.x[:-1] <= np.log(10 * NEGLIGIBLE)] = 0.0
    nu = float(np.exp(best.x[-1])) if degrees is None else degrees
    nu = nu if nu < 0.9 * MOST else np.inf
    covariance = np.tensordot(theta, C, 1)
    information = np.linalg.inv(covariance)
    squares = np.einsum("ei,eij,ej->e", residuals, information, residuals)
    errors = standard_errors(information, C, theta, nu)
    return VarianceFit(
        variances=dict.fromkeys(names, 0.0) | dict(zip(live, theta.tolist())),
        errors=dict.fromkeys(names, float("nan")) | dict(zip(live, errors.tolist())),
        degrees=nu,
        log_likelihood=-float(best.fun) * count,
        weights=np.ones(count) if np.isinf(nu) else (nu + d) / (nu + squares),
        count=count,
    )


def _log_likelihood(e: Array, C: Array, theta: Array, nu: float) -> tuple[float, Array, float]:
    """The log likelihood, its derivatives (P,) by theta, and the one by nu."""
    count, d = e.shape
    covariance = np.tensordot(theta, C, 1)
    information = np.linalg.inv(covariance)
    pulled = np.einsum("eij,ej->ei", information, e)
    squares = np.einsum("ei,ei->e", e, pulled)
    logdet = float(np.sum(np.linalg.slogdet(covariance)[1]))
    if np.isinf(nu):
        value = -0.5 * (logdet + float(squares.sum()) + count * d * np.log(2 * np.pi))
        weights, by_nu = np.ones(count), 0.0
    else:
        constant = gammaln((nu + d) / 2) - gammaln(nu / 2) - d / 2 * np.log(nu * np.pi)
        tails = np.log1p(squares / nu)
        value = count * float(constant) - 0.5 * logdet - (nu + d) / 2 * float(tails.sum())
        weights = (nu + d) / (nu + squares)
        by_nu = slope_by_nu(squares, d, nu)
    by_theta = 0.5 * np.einsum("e,ei,peij,ej->p", weights, pulled, C, pulled, optimize=True)
    by_theta -= 0.5 * np.einsum("eij,peji->p", information, C)
    return value, by_theta, by_nu


def slope_by_nu(squares: Array, d: int, nu: float) -> float:
    """The derivative by nu of the sum of log t_nu, for the squared Mahalanobis norms (E,) of d-vectors."""
    weights = (nu + d) / (nu + squares)
    of_gamma = digamma((nu + d) / 2) - digamma(nu / 2) - d / nu
    return 0.5 * len(squares) * float(of_gamma) + 0.5 * float(np.sum(-np.log1p(squares / nu) + weights * squares / nu))


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
    errors[live] = np.sqrt(np.diag(np.linalg.pinv(fisher, hermitian=True)))
    return errors
