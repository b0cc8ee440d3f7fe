"""The Rao-Blackwellised particle smoother: particle Gibbs on whole trajectories, with the landmarks integrated out.

`ParticleGibbs` is the sampler; its sweeps are in the engine (`engine/include/vmslam/gibbs`). After each sweep the chains move
all of trajectory and map at once along the widest directions of the Gaussian at the mode (`LowRank`). `GibbsResult` has the
moments, and measures whether the chains have mixed: split R-hat and the effective sample size, of all coordinates at once.

Sources: Vehtari, Gelman, Simpson, Carpenter and Bürkner, *Rank-normalization, folding, and localization: an improved
R-hat*, Bayesian Analysis 2021 (here without ranks: the coordinates are nearly Gaussian); Geyer, *Practical Markov chain
Monte Carlo*, Statistical Science 1992, for where the sum of autocovariances ends.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from graphslam import Cauchy, Graph, GraphError, MotionModel, SensorModel, solve
from graphslam.edges.relative import DoubtedPointEdges, RelationEdges, RelativePoseEdges
from graphslam.engine import engine
from graphslam.errors import LogError, OptionError, checks, quoted
from graphslam.linear.cholesky import FactorizationError
from graphslam.log import Log, check_is_log
from graphslam.se2 import Array, difference, wrap

from .filters import FastSLAM2
from .motions import Problem, robot_poses
from .options import GIGABYTE, FilterOptions, GibbsOptions, available_memory, forecast
from .particles import Samples, draw_key

#: the most directions, and the share of all dimensions
DIRECTIONS, SHARE = 150, 0.5
#: moves after each sweep
MOVES = 15
#: the most steps to the mode
FITS = 20
#: up to this size all eigenvectors are computed
DENSE = 300


def _no_inverse(problem: Problem) -> OptionError:
    return OptionError(
        "a motion or a sighting has a covariance without an inverse in floating point: look for a wrong range (the longest "
        f"is {problem.z[:, 0].max():.3g} m), or raise epsilon of the motion"
    )


@dataclass(frozen=True, eq=False)
class Target:
    """-log of the posterior of a trajectory and a map, without constants, with precisions of the sightings integrated out.

    Attributes:
        problem: the motions and sightings.
        graph: the density with the sightings linearised; the nodes are the poses, of which the first is known, and the
            landmarks. A sighting e with covariance C that has Student's t distribution with nu degrees of freedom costs
            (nu + n) log(1 + e' C^-1 e / nu): that is Cauchy's kernel of width sqrt(nu + n) on (1 + n / nu) C^-1.
        in_engine: the density for the chains.
    """

    problem: Problem
    graph: Graph
    in_engine: Any

    @classmethod
    def of(cls, problem: Problem, options: GibbsOptions) -> Target:
        """Return that of a problem."""
        p, n, T = problem, problem.columns, len(problem.motions)
        W = np.zeros((len(p.C), 3, 3))
        try:
            W[:, :n, :n] = np.linalg.inv(full(p.C)[:, :n, :n])
        except np.linalg.LinAlgError:
            raise _no_inverse(problem) from None
        rows, columns = np.tril_indices(3)
        degrees, exact = options.degrees_of_freedom or 0.0, options.density == "exact"
        in_engine = p.in_engine(p.motions, p.information, W[:, rows, columns], exact=exact, degrees=degrees)
        information, kernel = np.ascontiguousarray(W[:, :n, :n]), None
        if degrees > 0:
            information, kernel = (1 + n / degrees) * information, Cauchy((degrees + n) ** 0.5)
        steps, marks = np.arange(T + 1), np.arange(T + 1, T + 1 + len(p.ids))
        kind = RelationEdges if n == 3 else DoubtedPointEdges
        families = (
            RelativePoseEdges(steps[:-1], steps[1:], p.motions, full(p.information)),
            kind(p.steps, marks[p.marks], np.ascontiguousarray(p.y[:, :n]), information, kernel=kernel),
        )
        nodes = np.zeros((T + 1 + len(p.ids), 3))
        graph = Graph(
            nodes, families=families, steps=steps, trajectory=nodes[: T + 1], pose_ids=steps, landmark_ids=p.ids,
            landmark_dimension=n, fixed=steps[:1],
        )  # fmt: skip
        return cls(problem, graph, in_engine)


class LowRank:
    """The Gaussian at the mode of a target, and its widest directions.

    A state is a vector of 3 T + n J numbers: the poses after the first, and the n numbers of each landmark. Without psi n is
    2: nothing depends on the headings of landmarks, so that they must not be among the directions of the Gaussian.

    Args:
        target: of the moves. The Gaussian is that of its linearised density.
        poses, marks: (T + 1, 3) and (J, 3), where the search for the mode begins.

    Attributes:
        target: as given.
        mode: the poses (T + 1, 3) and landmarks (J, 3) there.
        directions: (r, 3 T + n J) of unit length; ``deviations``: (r,) the standard deviations along them.
    """

    def __init__(self, target: Target, poses: Array, marks: Array) -> None:
        self.target = target
        graph = target.graph.with_initial(np.concatenate([poses, marks]))
        try:
            solution = solve(graph, method="levenberg-marquardt", max_iterations=FITS, initialize="given")
            system, _ = graph.linearize(solution.state)
            factor = system.factorize()
        except (GraphError, FactorizationError):
            raise _no_inverse(target.problem) from None
        mode = np.column_stack([solution.state[:, :2], wrap(solution.state[:, 2])])
        self.mode = mode[: len(poses)], mode[len(poses) :]
        numbers, n = np.arange(mode.size).reshape(-1, 3), target.problem.columns
        # the places of the state among the numbers of all nodes
        free = np.concatenate([numbers[1 : len(poses)].ravel(), numbers[len(poses) :, :n].ravel()])
        size = len(free)
        r = min(DIRECTIONS, int(SHARE * size))
        if size <= DENSE:
            values, V = np.linalg.eigh(system.to_sparse()[free][:, free].toarray())
            V, self.deviations = V[:, :r], values[:r] ** -0.5
        else:
            from scipy.sparse.linalg import LinearOperator, eigsh

            whole = np.zeros(mode.size)

            def covariance_times(vector: Array) -> Array:
                whole[free] = vector.ravel()
                return factor.solve(whole.reshape(-1, 3)).ravel()[free]

            values, V = eigsh(LinearOperator((size, size), matvec=covariance_times), k=r, v0=np.ones(size))
            self.deviations = np.sqrt(values)
        self.directions = np.ascontiguousarray(V.T)


def full(upper: Array) -> Array:
    """Symmetric matrices (k, 3, 3) from their upper triangles (k, 6), column by column."""
    return upper[:, [[0, 1, 3], [1, 2, 4], [3, 4, 5]]]


#: a larger R-hat, or fewer effective samples, and the chains have not mixed
LARGEST_RHAT, LEAST_ESS = 1.05, 100.0
#: from this R-hat on, chains are still on their way from where they began, and neither more samples nor more particles help
APART = 2.0


@dataclass(frozen=True, eq=False, repr=False)
class Mixing:
    """R-hat and effective sample size of chains, by coordinate.

    Attributes:
        names: of the coordinates.
        rhat: potential scale reduction of the split chains; 1 means mixed; NaN for a coordinate that never changes.
        ess: effective number of independent samples for the mean.
    """

    names: list[str]
    rhat: Array
    ess: Array

    def __repr__(self) -> str:
        return f"<Mixing of {len(self.names)} coordinates: {'' if self.mixed else 'not '}mixed>"

    @property
    def mixed(self) -> bool:
        """Whether every coordinate has mixed."""
        return bool(np.nanmax(self.rhat, initial=1.0) <= LARGEST_RHAT and np.nanmin(self.ess) >= LEAST_ESS)

    @property
    def statement(self) -> str:
        """One sentence: the worst coordinates and, where the chains have not mixed, what to raise."""
        worst, least = int(np.nanargmax(self.rhat)), int(np.nanargmin(self.ess))
        figures = (
            f"R-hat at most {self.rhat[worst]:.3f} ({self.names[worst]}), effective sample size at least "
            f"{self.ess[least]:.0f} ({self.names[least]})"
        )
        if self.mixed:
            return f"mixed: {figures}"
        if APART < self.rhat[worst] < np.inf:
            advice = (
                "the chains are still far apart: raise warm_up, to thousands where the sensor is far more precise than the "
                "odometry"
            )
        else:
            raised = "iterations and warm_up" if self.rhat[worst] > LARGEST_RHAT else "iterations"
            advice = f"raise {raised}, and if that does not help, particles"
        return (
            f"not mixed: {figures}, but R-hat should be at most {LARGEST_RHAT} and the effective sample size at least "
            f"{LEAST_ESS:.0f}; {advice}"
        )


def judge(samples: Array, names: list[str]) -> Mixing:
    """Return R-hat and effective sample size of samples (chains, sweeps, coordinates), each chain split in two halves.

    Where chains are shorter than four sweeps, or nothing ever changes, R-hat is infinite and the effective sample size 0.
    """
    half = samples.shape[1] // 2
    if half < 2 or np.all(samples == samples[:1, :1]):
        return Mixing(names, np.full(samples.shape[2], np.inf), np.zeros(samples.shape[2]))
    halves = np.concatenate([samples[:, :half], samples[:, half : 2 * half]])
    mean = halves.mean(axis=1, keepdims=True)
    within = halves.var(axis=1, ddof=1).mean(axis=0)
    variance = within * (half - 1) / half + mean[:, 0].var(axis=0, ddof=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        rhat = np.sqrt(variance / within)
        # autocovariances by Fourier transform, a bounded number of coordinates at a time
        rho = np.empty((half, samples.shape[2]))
        for k in range(0, samples.shape[2], 256):
            d = halves[..., k : k + 256] - mean[..., k : k + 256]
            spectrum = np.abs(np.fft.rfft(d, 2 * half, axis=1)) ** 2
            covariance = np.fft.irfft(spectrum, axis=1)[:, :half].mean(axis=0) / half
            scale = variance[k : k + 256]
            rho[:, k : k + 256] = 1 - (within[k : k + 256] - covariance * half / (half - 1)) / scale
        rho[0] = 1
        pairs = rho[: half // 2 * 2].reshape(-1, 2, samples.shape[2]).sum(axis=1)
        # the sum ends where a pair is negative, and never rises again
        pairs[np.cumsum(pairs < 0, axis=0) > 0] = 0.0
        tau = np.maximum(2 * np.minimum.accumulate(pairs, axis=0).sum(axis=0) - 1, 1 / np.log10(len(halves) * half))
        ess = np.where(variance > 0, len(halves) * half / tau, np.nan)
    return Mixing(names, rhat, ess)


@dataclass(frozen=True, eq=False, repr=False)
class GibbsResult(Samples):
    """Samples of the posterior of a log with T motions and J landmarks, from C chains of S sweeps.

    Attributes:
        log: the name of the log; ``options``, ``motion``, ``sensor``: with what it was sampled.
        trajectories, maps, ids: as in `Samples`.
        accepted: the share of renewed blocks that the correction by the exact density accepted; 1 without it.
    """

    log: str
    options: GibbsOptions
    motion: MotionModel
    sensor: SensorModel
    accepted: float

    @property
    def deviations(self) -> Array:
        """All coordinates of all samples about their means, angles wrapped: (C, S, 3 T + J n), named by ``mixing.names``."""
        poses = difference(self.trajectories[:, :, 1:], self.poses[1:])
        maps = difference(self.maps, np.array(list(self.landmarks.values())))
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


class ParticleGibbs:
    """Particle Gibbs with ancestor sampling for SLAM, the landmarks integrated out: a smoother, not a filter.

    Every chain starts from a history drawn from its own run of `FastSLAM2`. A sweep renews every motion while all that
    follows moves along, then the poses in blocks of ``block`` steps between fixed ends, draws the map, and moves
    trajectory and map along their widest directions (`LowRank`). The engine does the sweeps
    (``engine/include/vmslam/gibbs``). During the warm-up the sightings are linearised three times: as measured, then twice
    at the mean of the chains so far; then nothing changes any more.

    The posterior is that of the graph with landmarks as nodes and motion edges: motions N(f(x, u), A M A' + epsilon I),
    sightings N(h(x, m), Q) with Q at the measured range, flat landmarks, a known first pose. With the density "linearised"
    the sightings are Gaussians in the plane, in the axes of the robot; the density "exact" corrects this by a Metropolis
    step after each renewal. With ``degrees_of_freedom`` sightings have Student's t distribution, as a mixture of Gaussians
    whose precisions are sampled, too: wrong sightings then bend the trajectory little.

    Args:
        log: controls and sightings with ids.
        seed: random seed.
        threads: their number, on which the result does not depend; default: one for each chain.
        options: the options; ``keywords`` replace single options and are the fields of `GibbsOptions`.
        motion, sensor: the models; default: those of the log, else the book's.
        start: the known first pose of the filters in which the chains begin, as in `ParticleFilter`.

    Raises:
        OptionError: an option has an impossible value or needs more memory than there is, or the log has no sightings or
            some without ids. `run` raises it where the noise is so unequal that the samples leave floating point.
        LogError: the log has no controls.
    """

    def __init__(
        self, log: Log, *, seed: int | np.random.Generator = 0, threads: int | None = None,
        options: GibbsOptions | None = None, motion: MotionModel | None = None, sensor: SensorModel | None = None,
        start: ArrayLike | None = None, **keywords: Any,
    ) -> None:  # fmt: skip
        check_is_log(log)
        log.warn_of_unused("particle Gibbs")
        checks.check_known("ParticleGibbs", keywords, [field.name for field in fields(GibbsOptions)])
        self.options = replace(options or GibbsOptions(), **keywords)
        if not log.identified:
            raise OptionError(
                f"{log.name} has sightings without ids, which particle Gibbs needs: take FastSLAM, which finds out, or first "
                "give the log ids by fastslam.associate"
            )
        # before the filters, which need memory themselves
        _check_memory(log, self.options)
        # the filters check log, models, seed and threads, and that the log can be used
        self._seeds = _seeds(seed, 2 * self.options.chains)
        log = log.replace(**dict.fromkeys(log.measured)) if log.measured else log
        self._filters = list[FastSLAM2]()
        for each in self._seeds[::2]:
            begun = FastSLAM2(
                log, seed=each, threads=threads, motion=motion, sensor=sensor, start=start, particles=STARTS
            )
            self._filters.append(begun)
            # where noise is estimated, and biases are taken out, this is done once
            log, motion, sensor = begun.log or log, begun.motion, begun.sensor
        if log.num_poses < 2:
            raise LogError(f"{log.name} has no motion to smooth")
        if len(log.steps) == 0:
            missing = f"{log.name} has no sightings of range and bearing"
            raise OptionError(f"{missing}: particle Gibbs would only repeat its noise model")
        self.log = log
        self.motion, self.sensor = begun.motion, begun.sensor
        self._problem = Problem.of(log, self.motion, self.sensor)
        self._threads = threads

    def __repr__(self) -> str:
        o, sweeps = self.options, self.options.warm_up + self.options.iterations
        return f"<ParticleGibbs on {self.log.name}: {o.chains} chains of {sweeps} sweeps, {o.particles} particles>"

    def run(self) -> GibbsResult:
        """Run all chains and return their samples."""
        o, problem = self.options, self._problem
        generators = [np.random.default_rng(s) for s in self._seeds[1::2]]
        with ThreadPoolExecutor(min(o.chains, self._threads or o.chains)) as pool:
            poses = list(pool.map(_start, self._filters, generators))
            marks = Target.of(problem, o).in_engine.draw_map(poses[0], draw_key(generators[0]))
            chains = [
                engine.GibbsChain(draw_key(rng), x, problem.motions_of(x[None]))
                for rng, x in zip(generators, poses, strict=True)
            ]
            quarter = o.warm_up // 4
            for sweeps in filter(None, (quarter, quarter, o.warm_up - 2 * quarter)):
                low_rank = LowRank(Target.of(problem, o), chains[0].poses, marks)
                runs = self._sampled(pool, chains, low_rank, sweeps, warm_up=True)
                later = [(x[sweeps // 2 :], m[sweeps // 2 :]) for x, m in runs]
                trajectories, maps = (np.concatenate(parts) for parts in zip(*later, strict=True))
                marks = maps[-1]
                problem = problem.linearised_at(trajectories, maps)
                for chain in chains:
                    chain.set_guess(problem.motions_of(trajectories))
            low_rank = LowRank(Target.of(problem, o), chains[-1].poses, marks)
            runs = self._sampled(pool, chains, low_rank, o.iterations, warm_up=False)
        return GibbsResult(
            log=self.log.name, options=o, motion=self.motion, sensor=self.sensor,
            trajectories=np.stack([robot_poses(self.sensor, x) for x, _ in runs]),
            maps=np.stack([m for _, m in runs])[..., : problem.columns], ids=problem.ids,
            accepted=float(np.mean([chain.accepted for chain in chains])),
        )  # fmt: skip

    def _sampled(
        self, pool: ThreadPoolExecutor, chains: list[Any], low_rank: LowRank, sweeps: int, *, warm_up: bool
    ) -> list[tuple[Array, Array]]:
        """Return of each chain trajectories (sweeps, T + 1, 3) and maps (sweeps, J, 3) after each sweep.

        A warm-up adapts the widths of the low-rank moves.

        Raises:
            OptionError: samples have left floating point.
        """
        o = self.options
        given = low_rank.target.in_engine, *low_rank.mode, low_rank.directions, low_rank.deviations
        rules = o.particles, min(o.block, 2**53), sweeps, MOVES, warm_up
        runs = list(pool.map(lambda chain: chain.run(*given, *rules), chains))
        if not all(np.isfinite(samples).all() for run in runs for samples in run):
            raise OptionError(
                f"{self.log.name}: the samples of particle Gibbs left floating point. The noise of some directions is far "
                "less than that of others: raise epsilon of the motion, or the least noise of the sensor"
            )
        return runs


#: particles of the filters from which the chains start
STARTS = 300


def _seeds(seed: Any, count: int) -> list[int]:
    """Return independent seeds; the first ones do not depend on their number."""
    if isinstance(seed, np.random.Generator):
        seed = int(seed.integers(2**63))
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:
        raise OptionError(f"seed must be a whole number, not below 0, not {quoted(seed)}")
    return [int(s.generate_state(1)[0]) for s in np.random.SeedSequence(int(seed)).spawn(count)]


def _check_memory(log: Log, options: GibbsOptions) -> None:
    """Raise `OptionError` where particles or samples need more memory than there is."""
    if (there := available_memory()) is None:
        return
    # of each particle: poses and ancestors of a block, and two copies of the landmarks that it sees
    need = options.particles * (32.0 * min(options.block, log.num_poses) + 144 * len(log.landmark_ids))
    if need > there:
        raise OptionError(
            f"{options.particles:,} particles of particle Gibbs need {need / GIGABYTE:.3g} GB of memory, but "
            f"{there / GIGABYTE:.3g} GB are available; take at most {int(options.particles * there / need):,}"
        )
    sweeps = max(options.iterations, options.warm_up)
    # the statistics need another copy of the samples; the filters of the start are all there at once
    start = forecast(log, FilterOptions(particles=STARTS), maps=True).least
    need = options.chains * (start + 48.0 * sweeps * (log.num_poses + len(log.landmark_ids)))
    if need > there:
        raise OptionError(
            f"{options.chains:,} chains of {sweeps:,} sweeps of particle Gibbs need {need / GIGABYTE:.3g} GB of memory, but "
            f"{there / GIGABYTE:.3g} GB are available; take fewer chains or shorter ones (iterations, warm_up)"
        )


def _start(particles: FastSLAM2, rng: np.random.Generator) -> Array:
    """Return a history of the sensor, drawn from a filter, (T + 1, 3)."""
    for _ in particles:
        pass
    weights = np.exp(particles._engine.log_weights)
    return particles._engine.trajectory(int(rng.choice(len(weights), p=weights / weights.sum())))
