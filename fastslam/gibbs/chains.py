"""Particle Gibbs: samples of whole trajectories and maps, from the posterior itself."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from graphslam.errors import LogError, OptionError
from graphslam.log import Log
from graphslam.models import MotionModel, SensorModel
from graphslam.se2 import Array

from ..fastslam2 import FastSLAM2
from ..memory import GIGABYTE, available_memory
from ..motions import robot_poses
from ..options import GibbsOptions
from . import exact, paths, pivots
from .result import GibbsResult
from .sightings import Problem


class ParticleGibbs:
    """Particle Gibbs with ancestor sampling for SLAM, the landmarks integrated out: a smoother, not a filter.

    Every chain starts from a history drawn from its own run of `FastSLAM2`. A sweep renews every motion while all that
    follows moves along (`pivots`), then the poses in stretches of ``block`` steps between fixed ends (`paths`), and draws
    the map. During the warm-up the sightings are linearised three times: as measured, then twice at the mean of the chains so
    far; then nothing changes any more.

    The posterior is that of the graph with landmarks as nodes and motion edges: motions N(f(x, u), A M A' + epsilon I),
    sightings N(h(x, m), Q) with Q at the measured range, flat landmarks, a known first pose. With the density "linearised"
    the sightings are Gaussians in the plane, in the axes of the robot; the density "exact" corrects this by a Metropolis
    step after each renewal.

    Args:
        log: controls and sightings with ids.
        seed: random seed. The result does not depend on the number of ``threads``.
        options: the options; ``keywords`` replace single options and are the fields of `GibbsOptions`.
        motion, sensor: the models; default: those of the log, else the book's.

    Raises:
        OptionError: an option has an impossible value, or the log has no sightings or some without ids.
        LogError: the log has no controls.
    """

    def __init__(
        self,
        log: Log,
        *,
        seed: int | np.random.Generator = 0,
        threads: int | None = None,
        options: GibbsOptions | None = None,
        motion: MotionModel | None = None,
        sensor: SensorModel | None = None,
        start: ArrayLike | None = None,
        **keywords: Any,
    ) -> None:
        if not isinstance(log, Log):
            raise OptionError(f"log must be a Log, not {log!r}")
        self.options = replace(options or GibbsOptions(), **keywords)
        if not log.identified:
            raise OptionError(
                f"{log.name} has sightings without ids, which particle Gibbs needs: take FastSLAM, which finds out, or first "
                "give the log ids by graphslam.associate"
            )
        # the filters check log, models, seed and threads, and that the log can be used
        self._seeds = _seeds(seed, 2 * self.options.chains)
        self._filters = [
            FastSLAM2(log, seed=s, threads=threads, motion=motion, sensor=sensor, start=start, particles=STARTS)
            for s in self._seeds[::2]
        ]
        if log.num_poses < 2:
            raise LogError(f"{log.name} has no motion to smooth")
        if len(log.steps) == 0:
            raise OptionError(f"{log.name} has no sightings: particle Gibbs would only repeat its noise model")
        _check_memory(log, self.options)
        self.log = log
        self.motion, self.sensor = self._filters[0].motion, self._filters[0].sensor
        self._problem = Problem.of(log, self.motion, self.sensor)
        self._threads = threads

    def run(self) -> GibbsResult:
        """Run all chains and return their samples."""
        o, problem = self.options, self._problem
        generators = [np.random.default_rng(s) for s in self._seeds[1::2]]
        with ThreadPoolExecutor(min(o.chains, self._threads or o.chains)) as pool:
            starts = list(pool.map(_start, self._filters, generators))
            guesses = [problem.motions_of(x[None]) for x in starts]
            for sweeps in (o.warm_up // 4, o.warm_up // 4, o.warm_up - 2 * (o.warm_up // 4)):
                if sweeps == 0:
                    continue
                runs = list(pool.map(lambda r, x, g: _run(r, x, g, problem, o, sweeps), generators, starts, guesses))  # noqa: B023
                starts = [trajectories[-1].copy() for trajectories, _, _ in runs]
                later = [(x[sweeps // 2 :], m[sweeps // 2 :]) for x, m, _ in runs]
                trajectories, maps = (np.concatenate(parts) for parts in zip(*later, strict=True))
                guesses = [problem.motions_of(trajectories)] * o.chains
                problem = problem.linearised_at(trajectories, maps)
            runs = list(pool.map(lambda r, x, g: _run(r, x, g, problem, o, o.iterations), generators, starts, guesses))
        return GibbsResult(
            log=self.log.name,
            options=o,
            motion=self.motion,
            sensor=self.sensor,
            trajectories=np.stack([robot_poses(self.sensor, x) for x, _, _ in runs]),
            maps=np.stack([m for _, m, _ in runs])[..., : problem.columns],
            ids=problem.ids,
            accepted=float(np.mean([share for _, _, share in runs])),
        )


#: particles of the filters from which the chains start
STARTS = 300


def _seeds(seed: Any, count: int) -> list[int]:
    """Return independent seeds; the first ones do not depend on their number."""
    if isinstance(seed, np.random.Generator):
        seed = int(seed.integers(2**63))
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:
        raise OptionError(f"seed must be a whole number, not below 0, not {seed!r}")
    return [int(s.generate_state(1)[0]) for s in np.random.SeedSequence(int(seed)).spawn(count)]


def _check_memory(log: Log, options: GibbsOptions) -> None:
    """Raise `OptionError` where the samples need more memory than there is."""
    sweep = 24 * options.chains * (log.num_poses + len(log.landmark_ids))
    # the statistics need another copy
    need, there = 2 * sweep * max(options.iterations, options.warm_up), available_memory()
    if there is not None and need > there:
        raise OptionError(
            f"the samples of particle Gibbs need {need / GIGABYTE:.3g} GB of memory, but {there / GIGABYTE:.3g} GB are "
            f"available; at most {int(there / (2 * sweep))} iterations have room"
        )


def _start(particles: FastSLAM2, rng: np.random.Generator) -> Array:
    """Return a history of the sensor, drawn from a filter, (T + 1, 3)."""
    for _ in particles:
        pass
    weights = np.exp(particles._log_weights)
    return particles._genealogy.trajectory(int(rng.choice(len(weights), p=weights / weights.sum())))


def _run(
    rng: np.random.Generator, x: Array, guess: Array, problem: Problem, options: GibbsOptions, sweeps: int
) -> tuple[Array, Array, float]:
    """Return trajectories (sweeps, T + 1, 3), maps (sweeps, J, 3), and the share of corrections that were accepted."""
    J = len(problem.ids)
    trajectories, maps = np.empty((sweeps, *x.shape)), np.empty((sweeps, J, 3))
    z, q = (problem.z, problem.q) if options.density == "exact" else (problem.z[:0], problem.q[:0])
    share = run_chain(
        rng, x.copy(), guess, problem.motions, problem.information, problem.first, problem.marks, problem.y,
        problem.C, J, options.particles, 1.0 if problem.columns == 3 else 0.0, options.block, z, q, trajectories, maps,
    )  # fmt: skip
    return trajectories, maps, share


def run_chain(
    rng: np.random.Generator, x: Array, guess: Array, motions: Array, W: Array, first: np.ndarray, marks: np.ndarray,
    y: Array, C: Array, J: int, N: int, third: float, block: int, z: Array, q: Array, trajectories: Array, maps: Array,
) -> float:  # fmt: skip
    """Fill trajectories and maps with the states after each sweep; return the share of accepted corrections."""
    T, corrected = len(x) - 1, len(z) > 0
    m, ratio = exact.draw_map(rng, x, first, marks, y, C, J, third), np.zeros(1)
    if corrected:
        ratio[0] = exact.log_ratio(x, m, first, marks, y, C, z, q, third)
    tried = accepted = 0
    for sweep in range(len(trajectories)):
        pivots.sweep(rng, x, guess, motions, W, first, marks, y, C, J, N, third, z, q, m, ratio)
        s, e = 1, min(1 + int(rng.random() * block), T)
        while s <= T:
            old = x[s : e + 1].copy()
            paths.renew(rng, x, s, e, guess, motions, W, first, marks, y, C, J, N, third, not corrected)
            tried += 1
            if not corrected or exact.accept(rng, x, m, ratio, first, marks, y, C, z, q, third):
                accepted += 1
            else:
                x[s : e + 1] = old
            s, e = e + 1, min(e + block, T)
        trajectories[sweep] = x
        maps[sweep] = m if corrected else exact.draw_map(rng, x, first, marks, y, C, J, third)
    return accepted / tried
