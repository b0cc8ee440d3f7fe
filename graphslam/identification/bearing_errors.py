"""Errors of the bearings that are not the same in all sightings: a sensor that was turned, and a lens.

Where the sensor of a drive is turned on its robot, as a camera that something bumps into, all bearings are off by one angle s
from then on. One bias of the whole drive does not explain it: the headings turn with the sensor instead, and the robot seems
to drive askew. So each moment is tested for a step of the bearings. With e, W and J the
residuals, the information and the Jacobians of nodes and biases at the solution, Omega the information matrix of all, and D
the derivative of the residuals by s, 1 in the bearings of later sightings,

    u = D' W e,   P = D' W D - D' W J Omega^-1 J' W D,   s = -u / P,   z = |u| / sqrt(P).

Noise that was fitted to a drive with such a step is too large, and z too small. So z only suggests a step, which counts where
the restricted likelihood with the bearings corrected, each with the noise that fits best, is larger by enough.

The error of a lens or a wrong focal length grows with the bearing c: a c + b c (c / edge)². It is tested in the same way with
the two columns D = [c, c (c / edge)²], and z² = u' P^-1 u. As the correction shrinks or stretches what was measured, the
likelihood then contains log |d corrected / d measured|.

Source: Rao, *Large sample tests of statistical hypotheses concerning several parameters*, 1948.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from ..log import Log
from ..se2 import Array, wrap
from .restricted_likelihood import fit, gain_over, with_wide_prior
from .unknowns import Unknowns

#: how many moments are tried
MOMENTS = 60
#: a z above the first number suggests a step, and a step that explains as much as so many standard errors is one:
#: docs/decisions.md
SUGGESTED, SURELY = 3.5, 5.0
#: a step is determined where it has more than this part of the information that exact poses would give
DETERMINED = 1e-6
#: the standard deviation of the prior of the bias of the whole drive [rad]. With the usual one, a sensor that is mounted
#: askew by ten degrees seems to have been turned in the first seconds
ASKEW = np.pi
#: rounds of solving and improving the variances
ROUNDS = 8
#: the most turns of one drive
MOST = 3
#: bearings below this quantile are in the field of view, which ends before the second number [rad] for an error that grows
EDGE, BEHIND = 0.99, 1.92
#: the standard deviation of the priors of such an error near the axis and of what the edge adds, the gain of the log
#: likelihood with which it counts, and the largest standard errors: where the place of the sensor looks much like it, small
#: errors of other kinds do, too (docs/decisions.md)
USUAL, GROWS, LARGEST_ERROR = 0.03, 8.0, 0.01


@dataclass(frozen=True)
class Turn:
    """A moment at which the sensor was turned.

    Attributes:
        time: [s] since the first pose.
        angle: by how much bearings are larger afterwards [rad].
        error: its standard error.
    """

    time: float
    angle: float
    error: float

    def sentence(self, log: Log) -> str:
        """For the notes of an estimate; ``log`` is that of the drive."""
        assert log.times is not None
        step = int(np.searchsorted(log.times - log.times[0], self.time))
        return (
            f"from step {step} ({self.time:.0f} s after the start) on, bearings are off by {self.angle:+.3g} rad (standard "
            f"error {self.error:.1g}) against those before: the sensor was turned on the robot, or the robot drives "
            "askew since then. They are corrected for a turned sensor; if it was not turned, the headings are off by as much"
        )


def turned_back(log: Log, turns: Iterable[Turn]) -> Log:
    """The log with the bearings that the sensor would have had without these turns."""
    if log.times is None or not (turns := tuple(turns)):
        return log
    times = log.times - log.times[0]
    off = np.sum([turn.angle * (times > turn.time) for turn in turns], axis=0)
    sightings, partial = log.sightings.copy(), log.partial_sightings
    sightings[:, 1] = wrap(sightings[:, 1] - off[log.steps])
    if partial is not None:
        partial = replace(partial, bearings=wrap(partial.bearings - off[partial.steps]))
    return log.replace(sightings=sightings, partial_sightings=partial)


def turn_of(fitted: Unknowns, whole: Callable[[Unknowns], Unknowns]) -> Turn | None:
    """The moment at which the sensor was turned, if any.

    Args:
        fitted: the solution with few sightings, whose errors are nearly independent.
        whole: the same problem with all sightings, which show the moment best.
    """
    fitted = with_wide_prior(fitted, ["bearing_bias"], ASKEW)
    end = _times(fitted).max()
    limits = np.linspace(0.0, end, MOMENTS + 1)[1:-1]
    z, angles, _ = _steps(fitted, limits)
    k = int(np.argmax(z))
    if z[k] < SUGGESTED:
        return None
    turn = Turn(float(limits[k]), float(angles[k]), 0.0)

    def again(log: Log) -> Unknowns:
        return fit(Unknowns(log, log.landmarks, fitted.sensor, fitted), ROUNDS)[0]

    turned, same = again(turned_back(fitted.log, [turn])), again(fitted.log)
    if gain_over(turned, same) < SURELY**2 / 2:
        return None
    z, rest, errors = _steps(turned, limits[[k]])
    every = whole(turned)
    times = np.unique(_times(every))
    near = np.flatnonzero(np.abs(times - turn.time) <= end / MOMENTS)
    time = turn.time
    if len(near) and (near := near[near + 1 < len(times)]).size:
        between = (times[near] + times[near + 1]) / 2
        time = float(between[np.argmax(_steps(every, between)[0])])
    return Turn(time, turn.angle + float(rest[0]), float(errors[0]))


def _times(solved: Unknowns) -> Array:
    """The time (M,) of each sighting since the first pose [s]."""
    assert solved.log.times is not None
    return solved.log.times[solved.seen_from] - solved.log.times[0]


def _steps(solved: Unknowns, moments: Array) -> tuple[Array, Array, Array]:
    """z, s and its standard error of a step of the bearings at each of some moments (K,); zero where it is not determined."""
    u, information, exact = (
        each if each.ndim == 1 else np.diag(each)
        for each in _scores(solved, (_times(solved)[:, None] > moments).astype(float))
    )
    known = information > DETERMINED * exact
    P = np.where(known, information, 1.0)
    return (
        np.where(known, np.abs(u) / np.sqrt(P), 0.0),
        np.where(known, -u / P, 0.0),
        np.where(known, P**-0.5, 0.0),
    )


def _scores(solved: Unknowns, of_bearings: Array) -> tuple[Array, Array, Array]:
    """u (K,), P and D' W D (K, K) for derivatives (M, K) of the residuals of the bearings."""
    linear = solved.linearized()
    edges, (nodes, values) = linear.edges[1], linear.step()
    # after the next step: what a search has not reached yet looks like an error of the bearings
    residuals = edges.residuals + edges.moved(nodes[:, :, None], values[:, None])[:, :, 0]
    D = np.zeros((*residuals.shape, of_bearings.shape[1]))
    D[:, 1] = of_bearings
    weighted = edges.information @ D
    pulled = np.zeros((*linear.xi.shape, of_bearings.shape[1]))
    following = linear.solve(pulled, edges.pull(weighted, pulled))
    exact = np.tensordot(weighted, D, ((0, 1), (0, 1)))
    P = exact - np.tensordot(weighted, edges.moved(*following), ((0, 1), (0, 1)))
    return np.einsum("eik,ei->k", weighted, residuals), (P + P.T) / 2, exact


@dataclass(frozen=True)
class Lens:
    """An error of the bearings that grows with them: near the axis of the sensor a scale, with more or less at the edge.

    With c the measured bearing, at most `edge`, the bearing is too large by near c + bend c (c / edge)².

    Attributes:
        near: the part of bearings near the axis.
        bend: what is added to this part at the edge.
        edge: where the field of view ends, in effect [rad].
        errors: (2,) standard errors of the part near the axis, and of that at the edge.
    """

    near: float
    bend: float
    edge: float
    errors: tuple[float, float] = (0.0, 0.0)

    @property
    def sentence(self) -> str:
        """For the notes of an estimate."""
        near, edge = 100 * self.near, 100 * (self.near + self.bend)
        return (
            f"measured bearings are off by {near:+.2g} % of their size (standard error {100 * self.errors[0]:.1g} %) near "
            f"the axis of the sensor and by {edge:+.2g} % (standard error {100 * self.errors[1]:.1g} %) at "
            f"{self.edge:.2g} rad from it, as with a wrong focal length or the distortion of a lens. They are corrected in "
            "this log; files of the robot do not contain the correction, so calibrate the sensor"
        )

    def shapes(self, bearings: Array) -> Array:
        """The derivative (M, 2) of the error by `near` and `bend` at measured bearings (M,)."""
        c = np.clip(bearings, -self.edge, self.edge)
        return np.column_stack([c, c**3 / self.edge**2])

    def corrected(self, bearings: Array) -> Array:
        """The bearings (M,) without the error."""
        return np.asarray(bearings - self.shapes(bearings) @ [self.near, self.bend])

    def log_density(self, bearings: Array) -> float:
        """The sum of log |d corrected / d measured|: densities of measured bearings from those of corrected ones."""
        inside = bearings[np.abs(bearings) < self.edge]
        return float(np.sum(np.log(np.abs(1 - self.near - 3 * self.bend * (inside / self.edge) ** 2))))


def undistorted(log: Log, lens: Lens | None) -> Log:
    """The log with the bearings without this error."""
    if lens is None:
        return log
    sightings, partial = log.sightings.copy(), log.partial_sightings
    sightings[:, 1] = lens.corrected(sightings[:, 1])
    if partial is not None:
        partial = replace(partial, bearings=lens.corrected(partial.bearings))
    return log.replace(sightings=sightings, partial_sightings=partial)


def lens_of(fitted: Unknowns) -> Lens | None:
    """The error of the bearings that grows with them, if any; ``fitted`` is the solution with few sightings.

    None for sensors that see to `BEHIND`, because such an error about their axis has a jump at pi, and for bearings of 0
    alone.
    """
    bearings = fitted.sightings[:, 1]
    edge = float(np.quantile(np.abs(bearings), EDGE))
    if not 0.0 < edge <= BEHIND:
        return None
    lens = Lens(0.0, 0.0, edge)
    z2, near, bend, _ = _growth(fitted, lens, bearings)
    if z2 < SUGGESTED**2:
        return None
    lens = replace(lens, near=near, bend=bend)

    def again(log: Log) -> Unknowns:
        return fit(Unknowns(log, log.landmarks, fitted.sensor, fitted), ROUNDS)[0]

    straight, same = again(undistorted(fitted.log, lens)), again(fitted.log)
    if gain_over(straight, same) + lens.log_density(bearings) - (near**2 + bend**2) / (2 * USUAL**2) < GROWS:
        return None
    _, near, bend, errors = _growth(straight, lens, bearings)
    return replace(lens, near=near, bend=bend, errors=errors) if max(errors) < LARGEST_ERROR else None


def _growth(solved: Unknowns, lens: Lens, bearings: Array) -> tuple[float, float, float, tuple[float, float]]:
    """z², near, bend and `Lens.errors` of a solution whose recorded bearings (M,) are corrected for ``lens``."""
    u, P, _ = _scores(solved, lens.shapes(bearings))
    prior, now = np.eye(2) / USUAL**2, np.array([lens.near, lens.bend])
    covariance = np.linalg.inv(P + prior)
    near, bend = now - covariance @ (u + prior @ now)
    errors = np.sqrt([covariance[0, 0], covariance.sum()])
    return float(u @ covariance @ u), float(near), float(bend), (float(errors[0]), float(errors[1]))
