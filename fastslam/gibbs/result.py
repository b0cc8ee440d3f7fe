"""`GibbsResult`: samples of particle Gibbs, their moments, and whether the chains have mixed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from graphslam.models import MotionModel, SensorModel
from graphslam.se2 import Array, wrap

from ..options import GibbsOptions
from ..samples import Samples
from .r_hat import Mixing, judge


@dataclass(frozen=True, eq=False, repr=False)
class GibbsResult(Samples):
    """Samples of the posterior of a log with T motions and J landmarks, from C chains of S sweeps.

    Attributes:
        log: the name of the log; ``options``, ``motion``, ``sensor``: with what it was sampled.
        trajectories, maps, ids: as in `Samples`.
        accepted: the share of renewed stretches that the correction by the exact density accepted; 1 without it.
    """

    log: str
    options: GibbsOptions
    motion: MotionModel
    sensor: SensorModel
    accepted: float

    @property
    def deviations(self) -> Array:
        """All coordinates of all samples about their means, angles wrapped: (C, S, 3 T + J n), named by ``mixing.names``."""
        poses = self.trajectories[:, :, 1:] - self.poses[1:]
        maps = self.maps - np.array(list(self.landmarks.values()))
        for deviations in (poses, maps):
            if deviations.shape[-1] == 3:
                deviations[..., 2] = wrap(deviations[..., 2])
        shape = (*poses.shape[:2], -1)
        return np.concatenate([poses.reshape(shape), maps.reshape(shape)], axis=2)

    @cached_property
    def mixing(self) -> Mixing:
        """R-hat and effective sample size of every coordinate of poses and landmarks, and the verdict on mixing."""
        names = [f"{c} of step {t}" for t in range(1, len(self.poses)) for c in ("x", "y", "heading")]
        names += [f"{c} of landmark {j}" for j in self.ids for c in ("x", "y", "heading")[: self.maps.shape[-1]]]
        return judge(self.deviations, names)

    def __repr__(self) -> str:
        chains, sweeps, poses = self.trajectories.shape[:3]
        return (
            f"GibbsResult({self.log}: {chains} chains of {sweeps} samples, {poses} poses, {len(self.ids)} landmarks; "
            f"{self.mixing.statement})"
        )
