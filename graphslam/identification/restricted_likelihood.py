"""Variances by restricted maximum likelihood: one step of the average-information method.

With y the measurements, P = W - W B Omega^-1 B' W and r_p = C_p W e, the derivative of the restricted log likelihood by a
variance theta_p and the average of its observed and expected information are

    g_p = 1/2 (e' W C_p W e - tr(P C_p)),     A_pq = 1/2 r_p' P r_q.

A_pq takes one solution of the normal equations for each variance. The trace needs the blocks of Omega^-1 between the nodes of
each edge, which are those of the selected inverse: tr(P C_p) = tr(W C_p) - sum of tr(W F W C_p), F the covariance of the
residuals due to that of the solution. Weights of Student's t act as W = u C^-1, and so C_p becomes C_p / u. The variables are
the logarithms of the variances, with a normal prior: a variance that the log does not tell stays at its typical value.

Source: Gilmour, Thompson and Cullis, *Average information REML*, Biometrics 51(4), 1995.

`better_start` finds a sensor that is metres from where it is believed to be, as the laser of a car whose poses are those of
the rear axle. The prior of the sensor's place (`PRIORS`) is a few centimetres wide, because lasting errors of a sensor look
like a wrong place. Where the sensor is metres away, this prior ends at a wrong minimum: the sensor near its believed place,
its own motion about the robot as slip, and a turned sensor. With a wide prior the same problem moves to the right one. Both
are compared by the likelihood, which contains the densities of the priors, so that the wide one wins only where the sightings
need it.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from ..errors import GraphError
from ..log import Log
from ..se2 import Array
from .corrections import corrected_sensor
from .declared import KINDS, PLACE
from .odometry import Edges
from .unknowns import DEGREES_MOTIONS, DEGREES_SIGHTINGS, LONGEST, PRIORS, SPREAD, Unknowns

#: the average information on a variance over that of its estimate, where errors are Gaussian. With q = e' C^-1 e of Student's
#: t that is fitted to them, an edge has d / 2 and A² / V, A = E[(nu + d) nu q / (nu + q)²] / 2,
#: V = var((nu + d) q / (nu + q)) / 4
OVERSTATED_BY_SIGHTINGS, OVERSTATED_BY_MOTIONS = {1: 1.182, 2: 1.207, 3: 1.222}, 1.097
#: a gain of the log likelihood below which the rounds of `fit` end
GAIN = 0.3
#: rounds of solving and improving the variances of `refitted`
REFITTED = 8


def fit(unknowns: Unknowns, rounds: int) -> tuple[Unknowns, dict[str, float]]:
    """Solve and improve the variances in turn.

    Returns:
        The unknowns themselves, which are changed, and {name: standard error of a standard deviation, as a part of it}.
    """
    errors = np.zeros(0)
    for k in range(rounds):
        # a step of the nodes in between: without it, the variances do not converge
        unknowns.iterate(1 if k else 4)
        gain, errors = improve_variances(unknowns)
        if gain < GAIN:
            break
    unknowns.take_noise()
    unknowns.iterate(1)
    names = [*unknowns.motion_parts, *unknowns.sensor_parts]
    return unknowns, {name: float(error) / 2 for name, error in zip(names, errors)}


def improve_variances(unknowns: Unknowns) -> tuple[float, Array]:
    """Take one step of the variances.

    The unknowns should be near their optimum for the present variances; they take the Gauss-Newton step of this problem, too.

    Returns:
        Twice the predicted gain of the log likelihood, and the standard errors of the logarithms of the variances.

    Raises:
        GraphError: the problem determines no solution, or the values became infinite.
    """
    linear = unknowns.linearized()
    names = [*unknowns.motion_parts, *unknowns.sensor_parts]
    # of each kind of edges: the places of its variances among all, C_p / u (E, d, d, k), W e, r_p and W r_p (E, d, k)
    terms: list[tuple[Edges, slice, Array, Array, Array, Array]] = []
    right, right_values = np.zeros((*linear.xi.shape, len(names))), np.zeros((len(linear.prior), len(names)))
    for edges in linear.edges:
        first = sum(len(term[0].parts) for term in terms)
        own = slice(first, first + len(edges.parts))
        variances = np.exp([unknowns.logarithms[name] for name in edges.parts])
        parts = np.stack(list(edges.parts.values()), axis=-1) * variances / edges.weights[:, None, None, None]
        pulled = (edges.information @ edges.residuals[:, :, None])[:, :, 0]
        r = np.einsum("eijk,ej->eik", parts, pulled)
        weighted = edges.information @ r
        right_values[:, own] = edges.pull(weighted, right[:, :, own])
        terms.append((edges, own, parts, pulled, r, weighted))
    solved, solved_values = linear.solve(right, right_values)
    gradient, information = np.zeros(len(names)), np.zeros((len(names), len(names)))
    for (edges, own, parts, pulled, r, weighted), fitted in zip(terms, unknowns.hide(linear)):
        excess = edges.information - edges.information @ fitted @ edges.information
        # both matrices are symmetric, so that the trace of their product is the sum over that of their elements
        gradient[own] = 0.5 * (np.einsum("ei,eik->k", pulled, r) - np.einsum("eij,eijk->k", excess, parts))
        information[own] -= 0.5 * np.einsum("eik,eil->kl", weighted, edges.moved(solved, solved_values))
        information[own, own] += 0.5 * np.einsum("eik,eil->kl", weighted, r)
    prior = SPREAD**-2
    now = np.array([unknowns.logarithms[name] for name in names])
    gradient -= prior * (now - np.array([unknowns.centres[name] for name in names]))
    part = [OVERSTATED_BY_MOTIONS] * len(unknowns.motion_parts)
    part += [OVERSTATED_BY_SIGHTINGS[unknowns.numbers]] * len(unknowns.sensor_parts)
    information = (information + information.T) / 2
    honest = information / np.sqrt(np.outer(part, part)) + prior * np.eye(len(names))
    information += prior * np.eye(len(names))
    free = np.array([name not in unknowns.held_variances for name in names])
    step = np.zeros(len(names))
    step[free] = np.linalg.solve(information[np.ix_(free, free)], gradient[free])
    gain = float(gradient @ step)
    # a variance that turns back was moved too far: such as two that explain the same errors, each in turn
    longest = np.minimum(unknowns.longest * np.where(step * unknowns.last_change < 0, 0.5, 1.5), LONGEST)
    change = np.clip(step, -longest, longest)
    unknowns.take_step(linear)
    unknowns.logarithms = dict(zip(names, (now + change).tolist()))
    unknowns.longest, unknowns.last_change = longest, change
    return gain, np.sqrt(np.diag(np.linalg.inv(honest)))


#: a calibrated robot has no biases of the one kind or of the other: they are held at their ideal values where the logarithmic
#: evidence for that is above this number
CONVINCING = 1.0
#: and may then have this part of their prior's standard deviation: a thousandth of the scale of the wheels
CALIBRATED = 1 / 30


def hold_needless(fitted: Unknowns, rounds: int) -> dict[str, float]:
    """Hold the biases of the kinds that the log does not show: {name: its remaining standard deviation}.

    With the evidence K, of the sensor for each bias alone, the ideal values have the probability P = K / (1 + K). With the
    probability 1 - P the mean square of a bias about them is that of the estimate. Otherwise the robot is calibrated, but
    not perfectly: its bias has the standard deviation `CALIBRATED` of the prior before the log, and a smaller one after a
    log that tells it better.
    """
    held: dict[str, float] = {}
    p, variances = fitted.parameters, np.diagonal(fitted.linearized().covariance)
    evidences = {names: fitted.evidence_against(names) for names in KINDS.values()}
    needless = {names: evidence for names, evidence in evidences.items() if evidence > CONVINCING}
    if len(needless) > 1 and fitted.evidence_against(sum(needless, ())) <= CONVINCING:
        # either kind may have none, but not both: a circle of the wrong radius is one of wheels or of the place of the sensor
        return held
    for names, evidence in needless.items():
        # right ranges say little about the place of the sensor or its clock; scales and biases of wheels have one cause
        alone = names == KINDS["sensor"]
        each = [fitted.evidence_against([name]) if alone else evidence for name in names]
        doubt = 1.0 / (1.0 + np.exp(np.minimum(each, 700.0)))
        k = [p.names.index(name) for name in names]
        squares = variances[k] + (p.values[k] - p.means[k]) ** 2
        of_log = np.maximum(1 / variances[k] - p.deviations[k] ** -2, 0.0)
        calibrated = 1 / (of_log + (CALIBRATED * np.array([PRIORS[name] for name in names])) ** -2)
        held |= dict(zip(names, np.sqrt(doubt * squares + (1 - doubt) * calibrated).tolist()))
    if held:
        fitted.hold(held)
        fit(fitted, rounds)
    return held


def log_likelihood(unknowns: Unknowns) -> float:
    """The logarithm of the restricted likelihood at the present values, by Laplace's approximation; constants are left out.

    It is the sum of the log densities of Student's t over the edges, and of the priors of the parameters, plus one half of
    the log determinant of the covariance of nodes and parameters.
    """
    linear = unknowns.linearized()
    total = -0.5 * float(linear.factor.log_determinant + np.linalg.slogdet(linear.schur)[1])
    of_each = (3, DEGREES_MOTIONS), (unknowns.numbers, DEGREES_SIGHTINGS)
    for edges, (numbers, degrees) in zip(linear.edges, of_each):
        determinants = np.linalg.slogdet(unknowns.covariances(edges))[1]
        tails = (degrees + numbers) * np.log1p(edges.squares / degrees)
        total -= 0.5 * float(np.sum(determinants + tails))
    away = unknowns.parameters.values - unknowns.parameters.means
    return total + 0.5 * float(np.sum(np.log(linear.prior)) - linear.prior @ away**2)


def numbers_on_motion(unknowns: Unknowns) -> float:
    """How many independent numbers show the noise of the motion where that is typical: tr(P C), C the covariances of it."""
    typical = copy(unknowns)
    typical.hidden = [0.0, unknowns.hidden[1]]
    typical.logarithms = unknowns.logarithms | {name: unknowns.centres[name] for name in unknowns.motion_parts}
    linear = typical.linearized()
    motions = linear.edges[0]
    excess = motions.information - motions.information @ linear.fitted(motions) @ motions.information
    return float(np.sum(excess * typical.covariances(motions) / motions.weights[:, None, None]))


def gain_over(fitted: Unknowns, other: Unknowns) -> float:
    """The log likelihood of a problem over that of the same with other priors, or with exact odometry."""
    fitted, other = copy(fitted), copy(other)
    # with the same weights for edges without residuals
    fitted.hidden, other.hidden = [0.0, fitted.hidden[1]], [0.0, other.hidden[1]]
    for each in (fitted, other):
        each.iterate(2)
    return log_likelihood(fitted) - log_likelihood(other)


def scores(solved: Unknowns, kind: int, D: Array) -> tuple[Array, Array, Array]:
    """u = D' W e (K,), P = D' W D - D' W J Omega^-1 J' W D and D' W D (K, K) of a solution.

    Args:
        solved: the solution.
        kind: of `Linear.edges`.
        D: (E, d, K) derivatives of their residuals.
    """
    linear = solved.linearized()
    edges, (nodes, values) = linear.edges[kind], linear.step()
    # after the next step: what a search has not reached yet looks like an error of the measurements
    residuals = edges.residuals + edges.moved(nodes[:, :, None], values[:, None])[:, :, 0]
    weighted = edges.information @ D
    pulled = np.zeros((*linear.xi.shape, D.shape[2]))
    following = linear.solve(pulled, edges.pull(weighted, pulled))
    exact = np.tensordot(weighted, D, ((0, 1), (0, 1)))
    P = exact - np.tensordot(weighted, edges.moved(*following), ((0, 1), (0, 1)))
    return np.einsum("eik,ei->k", weighted, residuals), (P + P.T) / 2, exact


#: an error is determined where it has more than this part of the information that exact nodes would give
DETERMINED = 1e-6


def each_alone(u: Array, P: Array, exact: Array) -> tuple[Array, Array, Array]:
    """z = |u| / sqrt(P), s = -u / P and its standard error (K,) by `scores` of each column; zero where not determined."""
    information = np.diag(P)
    information = np.where(information > DETERMINED * np.diag(exact), information, np.inf)
    return np.abs(u) / np.sqrt(information), -u / information, information**-0.5


def solved_with(noise: Unknowns, log: Log, groups: np.ndarray, steps: tuple[int, int] = (1, 1)) -> Unknowns:
    """The solution of another log of the same drive, or with other landmarks (M,), with this noise.

    Args:
        steps: how many before it is known what edges hide (`Unknowns.hide`), and after that.
    """
    solved = Unknowns(log, groups, noise.sensor, noise)
    solved.iterate(steps[0])
    solved.hide(solved.linearized())
    solved.iterate(steps[1])
    return solved


def refitted(fitted: Unknowns, log: Log) -> Unknowns:
    """`fit` of a solution with another log of the same sightings."""
    return fit(Unknowns(log, log.landmarks, fitted.sensor, fitted), REFITTED)[0]


#: the standard deviation of the wide prior [m], and the gain of the log likelihood per sighting with which it is taken: at
#: least 0.22 with a sensor 0.58 m away or more; lasting errors that look like a wrong place gain up to 0.15 on whole logs,
#: and 0.30 on one half of a log (docs/decisions.md)
ANYWHERE, GAINED = 2.0, 0.2
#: the usual prior allows a place that is nearer to the believed one [m]
AWAY = 0.25
#: rounds of solving and improving the variances with the usual prior, which start near their end, and with the wide one
ROUNDS = (4, 8)


def better_start(log: Log, start: Unknowns) -> Unknowns | None:
    """Where to begin again, if a log of few, nearly independent sightings shows a sensor far from its believed place.

    With the wide prior the search is longer, and may only have found a better minimum. If the place is near, the usual prior
    reaches that, too, and is the one to begin with.

    Args:
        start: a problem of the same drive, solved with the usual prior.
    """
    try:
        usual = fit(Unknowns(log, log.landmarks, start.sensor, start), ROUNDS[0])[0]
        free = fit(with_wide_prior(usual, PLACE, ANYWHERE), ROUNDS[1])[0]
        if gain_over(free, usual) <= GAINED * len(usual.seen):
            return None
        moved = np.subtract(corrected_sensor(free.parameters).offset, start.sensor.offset)
        return free if np.hypot(*moved) > AWAY else fit(usual, ROUNDS[1])[0]
    except (GraphError, np.linalg.LinAlgError):
        # sightings that do not tell the place are no reason to doubt it
        return None


def with_wide_prior(unknowns: Unknowns, names: Sequence[str], deviation: float) -> Unknowns:
    """The same problem with another standard deviation of the priors of some parameters."""
    free, p = copy(unknowns), unknowns.parameters
    free.parameters = replace(p, deviations=np.where(np.isin(p.names, names), deviation, p.deviations))
    return free
