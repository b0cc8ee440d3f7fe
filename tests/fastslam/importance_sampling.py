"""The posterior of a short log by importance sampling: what particle Gibbs and the filters have to reproduce."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graphslam import Log, MotionModel, SensorModel
from graphslam.se2 import between, wrap

Array = np.ndarray
#: degrees of freedom of the Student distributions from which poses and landmarks are drawn
TAIL = 5.0


@dataclass(frozen=True)
class Moments:
    """Means and standard deviations of coordinates, with their standard errors, and the effective sample size.

    Attributes:
        mean, std: of the poses after the first (3 T numbers), then of the positions of the landmarks (2 J).
        mean_errors: of the means; ``std_errors``: of the standard deviations, as parts of these.
    """

    mean: Array
    std: Array
    mean_errors: Array
    std_errors: Array
    size: float


def importance(
    log: Log,
    sensor: SensorModel,
    motion: MotionModel,
    about: Array,
    *,
    size: int = 40_000,
    draws: int = 8,
    degrees: float | None = None,
    exact: bool = True,
    seed: int = 0,
) -> Moments:
    """Moments of the posterior by self-normalised importance sampling.

    Trajectories are drawn from a Student distribution about the samples ``about`` (S, T + 1, 3), wider than they are. Given
    one, each landmark is drawn ``draws`` times from its sightings, wider than they say; the weight of the trajectory has
    the mean of the ratios of each landmark, which is an unbiased estimate of the integral over it. The weights are those of
    the posterior, so that the result does not depend on ``about``.

    Args:
        degrees: of freedom of Student's t distribution of the sightings; None for a Gaussian.
        exact: whether sightings have the density of range and bearing, or that of their places in the axes of the robot,
            linearised where they were measured.
    """
    rng, n, T = np.random.default_rng(seed), log.sightings.shape[1], log.num_poses - 1
    flat, middle = _flat(about)
    L = 1.2 * np.linalg.cholesky(np.cov(flat.T))
    e, log_weights = _student(rng, (size, 3 * T))
    x = np.concatenate([np.zeros((size, 1, 3)), middle + (e @ L.T).reshape(size, T, 3)], axis=1)
    for t, (d, C) in enumerate(zip(*log.motions(motion), strict=True)):
        r = between(x[:, t], x[:, t + 1]) - d
        r[:, 2] = wrap(r[:, 2])
        log_weights -= 0.5 * np.sum(r * np.linalg.solve(C, r.T).T, axis=1)
    values = [(x[:, 1:] - middle).reshape(size, 1, -1)]
    values[0][..., 2::3] = wrap(values[0][..., 2::3])
    shares, centres = [np.ones((size, 1))], [middle.ravel()]
    for j in log.landmark_ids:
        seen = np.flatnonzero(log.landmarks == j)
        poses = [x[:, log.steps[k]] for k in seen]
        places = np.stack([sensor.h_inverse(pose, log.sightings[k]) for pose, k in zip(poses, seen, strict=True)])
        if n == 3:
            places[..., 2] = places[0, :, 2] + wrap(places[..., 2] - places[0, :, 2])
        covariances = [sensor.landmark_covariance(pose, log.sightings[k]) for pose, k in zip(poses, seen, strict=True)]
        W = np.linalg.inv(np.stack(covariances))
        C = np.linalg.inv(W.sum(axis=0))
        mean = (C @ (W @ places[..., None]).sum(axis=0))[..., 0]
        L = 1.3 * np.linalg.cholesky(C)
        e, ratios = _student(rng, (size, draws, n))
        m = mean[:, None] + (L[:, None] @ e[..., None])[..., 0]
        ratios += np.log(np.diagonal(L, axis1=1, axis2=2)).sum(axis=1)[:, None]
        for pose, k in zip(poses, seen, strict=True):
            squares = _squares(pose[:, None], m, log.sightings[k], sensor, exact)
            ratios -= 0.5 * (squares if degrees is None else (degrees + n) * np.log1p(squares / degrees))
        highest = ratios.max(axis=1, keepdims=True)
        share = np.exp(ratios - highest)
        log_weights += highest[:, 0] + np.log(share.mean(axis=1))
        shares.append(share / share.sum(axis=1, keepdims=True))
        centres.append(np.median(mean[:, :2], axis=0))
        values.append(m[..., :2] - centres[-1])
    weights = np.exp(log_weights - log_weights.max())
    weights /= weights.sum()
    means, stds, mean_errors, std_errors = [], [], [], []
    for value, share, centre in zip(values, shares, centres, strict=True):
        each = np.einsum("sd,sdc->sc", share, value)
        mean = weights @ each
        squares = np.einsum("sd,sdc->sc", share, (value - mean) ** 2)
        variance = weights @ squares
        means.append(centre + mean)
        stds.append(np.sqrt(variance))
        mean_errors.append(np.sqrt(weights**2 @ (each - mean) ** 2))
        std_errors.append(np.sqrt(weights**2 @ (squares - variance) ** 2) / (2 * variance))
    return Moments(
        *(np.concatenate(parts) for parts in (means, stds, mean_errors, std_errors)), size=float(1 / np.sum(weights**2))
    )


def _flat(about: Array) -> tuple[Array, Array]:
    """Deviations (S, 3 T) of the poses after the first from their means, and the means (T, 3)."""
    later = about[:, 1:]
    middle = later[0] + 0.0
    d = later - middle
    d[..., 2] = wrap(d[..., 2])
    middle += d.mean(axis=0)
    return (d - d.mean(axis=0)).reshape(len(about), -1), middle


def _student(rng: np.random.Generator, shape: tuple[int, ...]) -> tuple[Array, Array]:
    """Standard Student vectors along the last axis, and -log of their density."""
    e = rng.standard_normal(shape) * np.sqrt(TAIL / rng.chisquare(TAIL, (*shape[:-1], 1)))
    return e, (TAIL + shape[-1]) / 2 * np.log1p(np.sum(e * e, axis=-1) / TAIL)


def _squares(pose: Array, m: Array, z: Array, sensor: SensorModel, exact: bool) -> Array:
    """r' Q^-1 r of a sighting z from poses (..., 3) of landmarks (..., n)."""
    if exact:
        r = sensor.h(pose, m) - z
        r[..., 1:] = wrap(r[..., 1:])
        return np.asarray(np.sum(r * r / np.diag(sensor.Q(z)), axis=-1))
    c, s, d = np.cos(pose[..., 2]), np.sin(pose[..., 2]), m[..., :2] - pose[..., :2]
    place = [
        c * d[..., 0] + s * d[..., 1],
        c * d[..., 1] - s * d[..., 0],
        *(m[..., k] - pose[..., k] for k in range(2, len(z))),
    ]
    r = np.stack(place, axis=-1) - sensor.h_inverse(np.zeros(3), z)
    r[..., 2:] = wrap(r[..., 2:])
    W = np.linalg.inv(sensor.landmark_covariance(np.zeros(3), z))
    return np.asarray(np.einsum("...i,ij,...j->...", r, W, r))
