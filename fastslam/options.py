"""The options and arguments of particle filters, checked, and the memory that a filter may take with them.

Options are declared once, with type, default, choices and help. Constructors take them as keywords, and command lines and
configuration files derive theirs from the fields.

Memory is forecast from the arrays: 32 bytes for each stored pose of the genealogy, 8 bytes for each number of a landmark, and
about 100 bytes per particle for poses, weights and buffers. How many poses are stored depends on the resampling, so the
forecast has a lower and an upper end.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from graphslam.errors import OptionError, checks, quoted
from graphslam.errors.checks import option
from graphslam.log import Log
from graphslam.log.measurements import AbsolutePositions, checked_sightings
from graphslam.log.rows import NO_ID, UNIDENTIFIED
from graphslam.models import RANGE_NOISES
from graphslam.se2 import Array, wrap

#: how sightings are assigned to landmarks; auto stands for one of the others, which the log decides
ASSOCIATIONS = ("auto", "known", "maximum-likelihood")
#: what auto stands for where sightings have no ids: the most accurate on real logs, see docs/beyond/association.md
WITHOUT_IDS = "maximum-likelihood"
#: the stored poses of all particles are numbered with 32 bits
MOST_PARTICLES = 50_000_000
#: the names of the resampling schemes, see `fastslam.particles`
RESAMPLING = ("systematic", "stratified", "residual", "multinomial")

#: how FastSLAM 2.0 weighs its particles: with the density of its proposal, or as if h and f were linear
PROPOSAL_WEIGHTS = ("exact", "linearised")
#: how the Gaussian of a landmark follows from its sightings: from each by the Kalman gain, or from all together
LANDMARK_UPDATES = ("kalman", "joint")
#: the fewest trajectories that backward simulation draws, so that they have covariances
FEWEST_SMOOTHED = 10
#: the options that FastSLAM has with known ids only, with their defaults
WITH_IDS: dict[str, Any] = {"landmark_update": "kalman", "range_noise": "auto", "smoothing": 0}
#: the options that localisation in a given map uses: not those of association, of landmark updates and of the proposal
LOCALISATION = ("particles", "resampling", "ess_threshold", "stage")
#: how far the lectures' program has come: particles that only move, that are weighed, that are resampled
STAGES = ("motion", "weights", "resampling")


@dataclass(frozen=True, kw_only=True)
class FilterOptions:
    """The options of `MonteCarloLocalization`, `FastSLAM1` and `FastSLAM2`; each field's metadata has its help.

    With an ess_threshold of 1 the filter resamples after every weighted step, as in the lectures. The result does not
    depend on the number of threads. Monte Carlo localisation uses neither ``smoothing`` nor the options from
    ``association`` to ``range_noise``: it finds the landmarks of its map by their ids.

    Raises:
        OptionError: an option has an impossible value.
    """

    particles: int = option(1000, "Number of particles N.", minimum=1, maximum=MOST_PARTICLES)
    seed: int | np.random.Generator = option(0, "Random seed; the same seed gives the same result.", minimum=0)  # noqa: RUF009
    resampling: str = option("systematic", "Resampling scheme.", choices=RESAMPLING)
    ess_threshold: float = option(
        0.5, "Resample when the effective sample size is at most this share of N.", minimum=0, maximum=1
    )
    threads: int | None = option(None, "Number of threads; by default all cores.", minimum=1)
    association: str = option(
        "auto", "Landmarks of sightings. Known takes their ids, maximum-likelihood the most likely landmark. "
        f"Auto is known, but {WITHOUT_IDS} where a log has no ids.", choices=ASSOCIATIONS,
    )  # fmt: skip
    new_landmark_threshold: float = option(
        1e-6, "Probability that a sighting of a known landmark is taken for a new one.", positive=True, below=1
    )
    merge_interval: int = option(
        10, "Merge landmarks that are one after every so many scans, 0: never; for unknown ids.", minimum=0
    )
    class_confusion: float = option(
        0.05, "Probability that the class of a sighting is wrong, where a log has classes; for unknown ids.",
        positive=True, below=1,
    )  # fmt: skip
    proposal_weight: str = option(
        "exact", "Weight of FastSLAM 2.0: exact corrects its linearised proposal, linearised is that of the lectures.",
        choices=PROPOSAL_WEIGHTS,
    )  # fmt: skip
    landmark_update: str = option(
        "kalman", "Landmarks of FastSLAM: kalman linearises each sighting, joint integrates all sightings of a landmark "
        "together, with known ids only.", choices=LANDMARK_UPDATES,
    )  # fmt: skip
    range_noise: str = option(
        "auto", "The noise of the range is taken at the measured range, or at the estimated one, as in the slides; "
        "FastSLAM does so with known ids only. auto: at the estimated one in graphs of a robot whose noise is estimated.",
        choices=RANGE_NOISES,
    )  # fmt: skip
    stage: str = option(
        "resampling", "Steps of a filter: motion neither weighs nor resamples, weights does not resample.", choices=STAGES,
    )  # fmt: skip
    smoothing: int = option(
        0, "FastSLAM: trajectories drawn by backward simulation after the run, whose mean is reported; 0 for none, "
        "else at least 10; known ids only.",
    )  # fmt: skip

    def __post_init__(self) -> None:
        checks.check_options(self)
        if self.smoothing != 0 and self.smoothing < FEWEST_SMOOTHED:
            least = f"at least {FEWEST_SMOOTHED} trajectories"
            raise OptionError(f"smoothing must be 0 (off) or {least}, not {self.smoothing}")
        if self.smoothing and self.stage == "motion":
            raise OptionError("smoothing needs weighted particles: the stage weights or resampling, not motion")

    @property
    def uses_ids(self) -> bool:
        """Whether FastSLAM uses the landmark ids of the sightings, where they have any."""
        return self.association in ("auto", "known")

    def for_ids(self, identified: bool) -> FilterOptions:
        """These options with the association that auto stands for where sightings have ids or, else, have none."""
        chosen = "known" if identified else WITHOUT_IDS
        return replace(self, association=chosen) if self.association == "auto" else self


@dataclass(frozen=True, kw_only=True)
class FrontEndOptions:
    """How `fastslam.associate` finds the ids with which association and solving begin.

    Raises:
        OptionError: an option has an impossible value.
    """

    front_end: str = option(
        "auto", "What finds ids for the graph where sightings have none: fastslam2; batch, which solves graphs along "
        "the drive; auto: both and, where they end differently, a second run of fastslam2 (on long logs up to three runs, "
        "without batch), of which the end with the highest evidence is taken; or best: batch and three runs in any case. All "
        "are then refined in the graph.", choices=("auto", "fastslam2", "batch", "best"),
    )  # fmt: skip
    front_particles: int = option(30, "Particles of the front end fastslam2.", minimum=1)

    def __post_init__(self) -> None:
        checks.check_options(self)


#: the density of the sightings that particle Gibbs samples
DENSITIES = ("linearised", "exact")


@dataclass(frozen=True, kw_only=True)
class GibbsOptions:
    """The options of `ParticleGibbs`; each field's metadata has its help.

    Raises:
        OptionError: an option has an impossible value.
    """

    particles: int = option(50, "Particle Gibbs: number of particles of each conditional SMC.", minimum=2)
    iterations: int = option(200, "Particle Gibbs: samples of each chain.", minimum=1)
    warm_up: int = option(100, "Particle Gibbs: sweeps of each chain before its samples.", minimum=0)
    chains: int = option(4, "Particle Gibbs: number of independent chains.", minimum=1)
    block: int = option(20, "Particle Gibbs: poses that are renewed at once.", minimum=1)
    density: str = option(
        "linearised", "Particle Gibbs: density of the sightings; exact corrects their linearisation by Metropolis steps.",
        choices=DENSITIES,
    )  # fmt: skip
    degrees_of_freedom: float | None = option(
        None, "Particle Gibbs: degrees of freedom of Student's t distribution of the sightings, such as 4 for real "
        "data with wrong sightings; by default they are Gaussian.", positive=True,
    )  # fmt: skip

    def __post_init__(self) -> None:
        checks.check_options(self)


#: bytes of poses, weights and buffers; of one pose of a history; of the history's index of one landmark
BUFFERS, POSE, INDEX = 100, 32, 8
#: numbers of a landmark without and with heading; where the association is unknown, and how many are then kept of each
NUMBERS, ANONYMOUS, KEPT = {2: 5, 3: 9}, 11, 1.5
#: stored poses per particle where the filter resamples often, and where it does so rarely
OFTEN, RARELY = 22, 120
#: the most sightings of a landmark that are integrated together, and so the most poses that are kept of it; the engine has
#: room for no more
JOINT = 16
GIGABYTE = 1e9


@dataclass(frozen=True)
class Forecast:
    """The memory [bytes] that a run will need, at least and at most in the usual case."""

    least: float
    most: float

    def __str__(self) -> str:
        least, most = (f"{value / GIGABYTE:.3g}" for value in (self.least, self.most))
        return f"{most} GB" if least == most else f"{least} to {most} GB"


def forecast(log: Log, options: FilterOptions, *, maps: bool) -> Forecast:
    """The memory of a filter on a log; ``maps`` says whether each particle has a map of its own."""
    landmarks, numbers = float(len(log.landmark_ids)), NUMBERS[log.sightings.shape[1]]
    if not options.for_ids(log.identified).uses_ids:
        # how many there are, only the true map tells of sightings without ids
        landmarks = KEPT * max(landmarks, len(log.true_landmarks or ()))
        numbers = ANONYMOUS + (0 if log.classes is None else len(np.unique(log.classes)))
    elif options.landmark_update == "joint":
        numbers += 3 * JOINT + 1
    spare = int(np.max(np.bincount(log.steps), initial=0)) + 1
    fixed = BUFFERS + ((landmarks + spare) * 8 * numbers + len(log.landmark_ids) * INDEX if maps else 0)
    # arrays that grow are copied into others of twice the size
    often, rarely = (min(count, 2 * log.num_poses) for count in (OFTEN, RARELY))
    if options.ess_threshold == 0:
        often, rarely = log.num_poses, 2 * log.num_poses
    record = 0.0
    if maps and options.smoothing:
        events = len(np.unique(np.column_stack([log.steps, log.landmarks]), axis=0))
        record = smoothing_memory(options.particles, log.num_poses, len(log.landmark_ids), events, options.smoothing)
    return Forecast(*(record + options.particles * (fixed + POSE * poses) for poses in (often, rarely)))


def smoothing_memory(particles: int, poses: int, landmarks: int, events: int, count: int) -> float:
    """The memory [bytes] of backward simulation of ``count`` trajectories; an event is a step that sees a landmark."""
    # the record of the poses, and the sums of the weights and the ancestors of the sampler
    record = 4.0 * poses * landmarks + 72.0 * events + 48.0 * poses
    # the covariances need another copy of the samples
    return particles * record + 48.0 * count * (poses + landmarks)


def check_one_drive(name: str, log: Log, *, is_class: bool = False) -> None:
    """Raise `OptionError` where a log consists of several, for an estimator that follows one robot from its start.

    Args:
        is_class: whether the name is that of a class, which is used without a comparison.
    """
    if not log.sessions:
        return
    others = "graph, gtsam and isam2 solve them together"
    if is_class:
        others = "FastSLAM2 finds the robot where the next one begins, and solve takes them together"
    raise OptionError(f"{name} follows one robot from its start, and these are {len(log.sessions)} logs; {others}")


def check_memory(log: Log, options: FilterOptions, *, maps: bool) -> None:
    """Raise `OptionError` where a filter on a log needs more memory than there is."""
    need, there = forecast(log, options, maps=maps), available_memory()
    if there is not None and need.least > there:
        most = int(options.particles * there / need.most)
        raise OptionError(
            f"{options.particles:,} particles on {log.name} need {need} of memory, and {there / GIGABYTE:.2g} GB are "
            f"available; take at most {most:,} particles{' or a smaller smoothing' if options.smoothing else ''}"
        )


def available_memory() -> float | None:
    """The memory [bytes] that a process may take without swapping; None where the system does not report it."""
    free = [line.split()[1] for line in _lines("/proc/meminfo") if line.startswith("MemAvailable:")]
    limits = [1024.0 * int(kilobytes) for kilobytes in free]
    # a container's limit
    most, used = (_lines(f"/sys/fs/cgroup/memory.{name}")[:1] for name in ("max", "current"))
    if most and used and most[0].isdigit():
        limits.append(float(most[0]) - float(used[0]))
    if not limits and "SC_PHYS_PAGES" in getattr(os, "sysconf_names", ()):
        limits.append(float(os.sysconf("SC_PHYS_PAGES")) * os.sysconf("SC_PAGE_SIZE"))
    return min(limits, default=None)


def _lines(path: str) -> list[str]:
    try:
        return Path(path).read_text(encoding="ascii").splitlines()
    except (OSError, ValueError):
        return []


#: a larger turn in one step [rad] is an error in the input, and the engine's sine is not made for it
LARGEST_TURN = 1e5
#: a longer way in one step [m], 25 times round the Earth, is an error in the input
LARGEST_WAY = 1e9


def index(name: str, value: Any, count: int) -> int:
    """Return a whole number between 0 and count - 1, of Python or NumPy; True and False are refused."""
    if not isinstance(value, (int, np.integer)) or isinstance(value, bool):
        raise OptionError(f"{name} must be a whole number, not {quoted(value)}")
    if not 0 <= value < count:
        raise OptionError(f"there is no {name} {value}: they are numbered 0 to {count - 1}")
    return int(value)


def measurements(ids: Any, sightings: ArrayLike, by_ids: bool) -> tuple[np.ndarray, Array]:
    """Ids (k,) and sightings (k, 2 or 3) as `checked_sightings` returns them, angles wrapped.

    Where the association is ``by_ids``, each sighting needs the id of its landmark.
    """
    if ids is None and by_ids:
        raise OptionError(
            "ids may be None only if they are ignored (association maximum-likelihood); give the id of each sighting"
        )
    advice = (
        "the filter takes identified landmarks only: leave out what nobody has identified, or use FastSLAM with the "
        "association maximum-likelihood"
    )
    numbers, z = checked_sightings(ids, sightings, (UNIDENTIFIED, NO_ID) if by_ids else (), advice)
    z[:, 1:] = wrap(z[:, 1:])
    return numbers, z


def check_motion(step: int, way: float, turn: float) -> None:
    """Raise `OptionError` where the way [m] or the turn [rad] of a step, with its noise, is an error in the input."""
    if not (way <= LARGEST_WAY and turn <= LARGEST_TURN):
        raise OptionError(
            f"step {step}: the control and its noise move the robot by up to {way:g} m and turn it by up to {turn:g} rad; "
            f"more than {LARGEST_WAY:g} m or {LARGEST_TURN:g} rad is refused"
        )


def checked_control(control: Any, dt: Any) -> tuple[Array, float]:
    """Return a control (nu, omega) and its time [s], or raise `OptionError`."""
    u = checks.finite_numbers("control", control, (2,))
    checks.check_turn_rate(float(u[1]))
    checks.check_number(dt=dt)
    if dt < 0:
        raise OptionError(f"dt must be 0 s or longer, not {quoted(dt)}")
    return u, float(dt)


def checked_motion(motion: Any, covariance: Any) -> tuple[Array, Array]:
    """Return a motion (1, 3) and its covariance (1, 3, 3), or raise `OptionError`."""
    z, P = checks.checked_pose("motion", motion), checks.finite_numbers("covariance", covariance, (3, 3))
    if not np.allclose(P, P.T) or np.linalg.eigvalsh(P)[0] < -1e-12 * np.abs(P).max():
        raise OptionError(f"covariance must be symmetric positive semidefinite, not {quoted(covariance)}")
    return z[None], P[None]


def one_position(position: Any, covariance: Any, lever: Any) -> AbsolutePositions:
    """A position (x, y) or (x, y, theta) as the only row of positions, or `OptionError`."""
    place, arm = checks.finite_numbers("position", position, (2,), (3,)), checks.finite_numbers("lever", lever, (2,))
    return AbsolutePositions(
        steps=np.zeros(1, dtype=np.int64), places=place[None], covariances=checks.checked_covariance(covariance, len(place)),
        levers=arm,
    )  # fmt: skip
