"""What is known of a robot, compared by sightings that are left out: how well does each candidate predict them?

A part of a drive is left out with all its sightings, so that its poses follow from the odometry and its landmarks from other
visits: loop closures count. With e the difference between a sighting that is left out and its prediction, and F the
covariance of the prediction, its log density is that of Student's t with nu degrees of freedom, d numbers and S = C + F,

    log p(e) = log Gamma((nu + d)/2) - log Gamma(nu/2) - d/2 log(nu pi) - 1/2 log|S| - (nu + d)/2 log(1 + e' S^-1 e / nu).

All candidates predict the same sightings with the same ids, as recorded but for ids that were corrected, so that a candidate
with wide noise gains nothing from it. Sightings of one part share the error of its odometry, so that their sum says less than
that of as many independent ones.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import lgamma, log, pi

import numpy as np

from ..errors import GraphError
from ..log import Log
from ..se2 import Array
from .sighting_errors import Predictions
from .unknowns import DEGREES_SIGHTINGS, Unknowns

#: the duration of a part that is left out [s], every which part is left out at once, and the steps to the new solution,
#: before and after what edges hide is known
DURATION, FOLDS, STEPS = 10.0, 3, (3, 2)
#: a drive with fewer parts tells nothing
FEWEST_PARTS = 6


@dataclass(frozen=True)
class LeftOut:
    """How well candidates predict sightings that were left out.

    Attributes:
        count: of the sightings.
        densities: {candidate: the mean logarithm of the density of such a sighting}.
    """

    count: int
    densities: Mapping[str, float]

    def gain(self, name: str, over: str) -> float:
        """The sum of the log densities with one candidate minus that with another."""
        both = self.count and name in self.densities and over in self.densities
        return self.count * (self.densities[name] - self.densities[over]) if both else 0.0

    @property
    def best(self) -> str:
        """The candidate that predicts best; the first where nothing was predicted."""
        return max(self.densities, key=lambda name: self.densities[name])

    @property
    def sentence(self) -> str | None:
        """For the notes of a table; None where nothing was predicted."""
        if not self.count:
            return None
        ranked = sorted(self.densities.items(), key=lambda item: -item[1])
        shown = ", ".join(f"{value:.1f} with {name}" for name, value in ranked)
        return f"the mean log density of {self.count} sightings that were left out is {shown} (higher is better)"


def left_out(drive: Log, candidates: Mapping[str, Unknowns], rng: np.random.Generator) -> LeftOut:
    """Compare candidates, solutions of ``drive`` or of other logs of the same drive with the same ids.

    Args:
        drive: with few sightings of each landmark, so far apart that their errors are hardly correlated.
        rng: of the random signs with which covariances of predictions are estimated.
    """
    assert drive.times is not None
    if drive.times[-1] - drive.times[0] < FEWEST_PARTS * DURATION:
        return LeftOut(0, dict.fromkeys(candidates, 0.0))
    seed = int(rng.integers(2**32))
    # the same random signs for all
    each = {name: _log_densities(drive, one, np.random.default_rng(seed)) for name, one in candidates.items()}
    each = {name: values for name, values in each.items() if np.isfinite(values).any()}
    told = np.isfinite(sum(each.values(), np.zeros(len(drive.steps))))
    count = int(np.count_nonzero(told))
    return LeftOut(count, {name: float(np.mean(values[told])) if count else 0.0 for name, values in each.items()})


def _log_densities(drive: Log, candidate: Unknowns, rng: np.random.Generator) -> Array:
    """The log density (M,) of each sighting where it is left out; NaN where its landmark is not known without it."""
    assert drive.times is not None
    at = drive.times[drive.steps] - drive.times[0]
    fold = np.floor(at / DURATION).astype(np.int64) % FOLDS
    names, landmarks = np.unique(drive.landmarks, return_inverse=True)
    found = np.full(len(landmarks), np.nan)
    for k in range(FOLDS):
        # landmarks of their own, seen once, so that they are no nodes
        own = len(names) + np.arange(len(landmarks))
        try:
            rest = Unknowns(drive, np.where(fold == k, own, landmarks.ravel()), candidate.sensor, candidate)
            rest.iterate(STEPS[0])
            rest.hide(rest.linearized())
            rest.iterate(STEPS[1])
            rows = np.flatnonzero((fold == k) & np.isin(landmarks.ravel(), rest.ids))
            edges, errors = Predictions(rest, rng).compare(
                drive, rows, np.searchsorted(rest.ids, landmarks.ravel()[rows])
            )
            covariances = rest.covariances(edges) + errors @ np.swapaxes(errors, 1, 2) / errors.shape[2]
            found[rows] = student_t(edges.residuals, covariances)
        except (GraphError, np.linalg.LinAlgError):
            # this part tells nothing with this candidate
            continue
    return found


def student_t(residuals: Array, scales: Array, degrees: float = DEGREES_SIGHTINGS) -> Array:
    """The log densities (E,) of residuals (E, d) with the squared scales S (E, d, d); see the module."""
    d = residuals.shape[1]
    squares = np.einsum("ei,ei->e", residuals, np.linalg.solve(scales, residuals[:, :, None])[:, :, 0])
    constant = lgamma((degrees + d) / 2) - lgamma(degrees / 2) - d / 2 * log(degrees * pi)
    return constant - 0.5 * np.linalg.slogdet(scales)[1] - (degrees + d) / 2 * np.log1p(squares / degrees)
