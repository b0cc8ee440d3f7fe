"""Robots that nobody has calibrated: the default result of drives whose noise, biases and misread ids are unknown.

    python benchmarks/unknown_robot.py [--seeds tuning|reporting|1000-1009] [--drives 20] [--jobs 2] [--misread 0.05]
                                       [--option noise=auto] [--no-ids] [--plain] [--also fastslam2] [--oracles FOLDER]
                                       [--record docs/measured] [--drive odometry|sightings|shaking|jittering|slow]
                                       [--bearings 1.04] [--ranges tags=0.03|offset=0.4|one=0.4|reflected=0.15] [--turns 0.1]
    python benchmarks/unknown_robot.py --sizes     # time of `estimate_robot` and `solve` by the length of a drive

Each seed is a `Drive.random`, or with ``--drive`` two minutes with almost perfect odometry or sightings, or a random drive
with an error that the sightings of a scan have in common, inexact times, or slow odometry. Its log goes through three ways:

default         what ``slam-compare run LOG --estimators graph`` does, with the options given by ``--option NAME=VALUE``
oracle          the same log with the right ids and without clutter, the true noise, and all biases estimated with priors
                as wide as the generator draws them. Where errors are correlated, which independent noise cannot say, the
                noise of the sensor is wider by a factor that follows from the true correlation (`width`)
dead reckoning  the odometry alone

A drive is silently bad where the ATE of the default is above `BAD` times that of the oracle and above `HARMLESS`, and no
warning is given, and unexpectedly bad where it is also above `BAD` times the expected ATE, which the run states. Figures for
`REPORTING` are published; what is tuned is tuned on `TUNING`. ``--plain`` also times the graph with the noise of the book, on
the processor. ``--oracles FOLDER`` keeps the figures of the oracle, which takes most of the time. With ``--bearings``,
``--ranges`` and ``--turns`` the default gets bearings times this factor, ranges that are off (`RANGES`), or left turns that
are recorded larger than right ones by this part, the oracle the right ones.
"""

from __future__ import annotations

import argparse
import json
import re
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from itertools import islice
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from recording import add_option, record

import comparisons
from comparisons.estimators import warm_up
from comparisons.results import EstimatorResult
from graphslam import Graph, GraphError, Log, SensorModel, SlamError, Solution, estimate_robot, solve
from graphslam.identification.corrections import honest_variances
from graphslam.identification.slips import Uneven, levelled
from graphslam.log import UNIDENTIFIED
from graphslam.metrics import ate
from graphslam.models import MotionModel
from graphslam.se2 import Array
from graphslam.simulation.drives import SPREADS, Drive, DriveTruth
from graphslam.simulation.worlds import SENSORS

#: never tune on these
REPORTING = range(200)
#: for everything else
TUNING = range(1000, 1200)
#: beyond so many times the oracle a result is bad, and below so many metres nobody minds
BAD, HARMLESS = 3.0, 0.01


def accurate_odometry(seed: int) -> Drive:
    """No biases and hardly any noise of the motion; errors of the sightings are correlated on two of three seeds."""
    exact = MotionModel(nn=1e-4, no=0.0, on=1e-4, oo=1e-4, epsilon=1e-12)
    return Drive(seed=seed, duration=120.0, motion=exact, parameters={}, correlated=0.3 * (seed % 3))


def accurate_sightings(seed: int) -> Drive:
    """Ranges to a millimetre, bearings to a milliradian."""
    exact = replace(SENSORS["camera"], range_rate=1e-3, range_std=1e-3, bearing_std=1e-3)
    return Drive(seed=seed, duration=120.0, sensor=exact)


def shaking(seed: int) -> Drive:
    """A drive whose scans have an error of 0.03 rad in common."""
    return replace(Drive.random(seed), scan_bearing_std=0.03)


def jittering(seed: int) -> Drive:
    """A drive whose scans are recorded with times that are off by 0.05 s."""
    return replace(Drive.random(seed), stamp_std=0.05)


def slow(seed: int) -> Drive:
    """A drive with odometry once and scans 20 times a second; the angle of its gyroscope has the same random walk."""
    drive = Drive.random(seed)
    motion = replace(drive.motion, sigma_omega=drive.motion.sigma_omega / drive.odometry_rate**0.5)
    return replace(drive, odometry_rate=1.0, sensor_rate=20.0, motion=motion)


#: sensors that see less far around [rad] are cameras
CAMERA = 2.3
#: what a seed stands for
DRIVES: dict[str, Callable[[int], Drive]] = {
    "random": Drive.random,
    "odometry": accurate_odometry,
    "sightings": accurate_sightings,
    "shaking": shaking,
    "jittering": jittering,
    "slow": slow,
}


def _tags(size: float, landmarks: np.ndarray, rng: np.random.Generator) -> Array:
    """Errors (L,) of the scales of landmarks. Their mean over those that are seen is zero: no log tells a scale in common."""
    scales = size * rng.standard_normal(landmarks.max() + 1)
    return scales - scales[np.unique(landmarks)].mean()


def off_ranges(log: Log, truth: DriveTruth, kind: str, size: float) -> Log:
    """The log with ranges that are off by ``size`` [part or m], by the true landmarks; clutter stays as it is."""
    real, rng = truth.landmarks != UNIDENTIFIED, np.random.default_rng([truth.landmarks.size, 3])
    seen, ranges = truth.landmarks[real], log.sightings[real, 0]
    off = np.zeros(seen.max() + 1)
    if kind == "tags":
        ranges = ranges * (1 + _tags(size, seen, rng)[seen])
    elif kind == "reflected":
        ranges = ranges + (rng.random(len(ranges)) < size) * rng.exponential(0.5, len(ranges))
    else:
        often = np.bincount(seen) > np.median(np.bincount(seen)) / 2
        count = 1 if kind == "one" else max(1, round(0.2 * len(off)))
        off[rng.choice(np.flatnonzero(often) if kind == "one" else len(off), count, replace=False)] = size
        ranges = ranges + off[seen]
    sightings = log.sightings.copy()
    sightings[real, 0] = ranges
    return log.replace(sightings=sightings)


#: ranges that are off: by scales of landmarks, by a length for a fifth of them or for one, or for this part of all ranges
RANGES = ("tags", "offset", "one", "reflected")


@dataclass(frozen=True)
class Outcome:
    """What a way made of a log.

    Attributes:
        poses: (T+1, 3).
        nees: the mean of e' P^-1 e / 3, or None.
        misread: the part of the sightings that it found misread or clutter, or None where it does not say.
        warnings: what it said, one sentence each.
        seconds: of the processor, without reading.
        others: {further estimator: its ATE [m]}, with the same noise and ids.
        expected: the ATE that the covariances predict [m], or None.
    """

    poses: Array
    nees: float | None
    misread: float | None
    warnings: tuple[str, ...]
    seconds: float
    others: dict[str, float | None] = field(default_factory=dict)
    expected: float | None = None


#: a way from a log to its outcome
Runner = Callable[[Log], Outcome]


def default_run(log: Log, also: tuple[str, ...] = (), *, without_ids: bool = False, **options: Any) -> Outcome:
    """`comparisons.run` with the estimator ``graph``; its notes tell the share of the ids that contradict their place."""
    assert log.true_poses is not None
    if without_ids:
        log = log.replace(landmarks=np.full_like(log.landmarks, UNIDENTIFIED))
    begin = time.process_time()
    found = comparisons.run(log, estimators=["graph"], **options)
    seconds = time.process_time() - begin
    result, said = found["graph"], [finding.message for finding in found.findings]
    if not result.converged:
        said.append(result.reason)
    shares = [re.search(r"\((\d+\.\d+)%\) contradict their id", note) for note in found.log.notes]
    share = next((float(each[1]) / 100 for each in shares if each), 0.0)
    others: dict[str, float | None] = {}
    for name in also:
        try:
            others[name] = ate(log.true_poses, comparisons.run(log, estimators=[name], **options)[name].poses)
        except SlamError:
            others[name] = None
    return Outcome(result.poses, found.nees["graph"], share, tuple(said), seconds, others, result.expected_ate_m)


def plain_seconds(log: Log) -> float:
    """The time of the graph with the noise of the book and nothing estimated."""
    begin = time.process_time()
    edges = "virtual+motion" if log.has_orientation else "landmark+motion"
    solve(Graph.from_log(log, motion=MotionModel(), sensor=SensorModel(), edges=edges, kernel="cauchy"))
    return time.process_time() - begin


def oracle(log: Log, truth: DriveTruth) -> Solution:
    """The solution of whoever knows noise and ids; see the top of this file.

    Raises:
        GraphError: the log does not tell the biases.
    """
    real = ~truth.clutter
    # it starts from the true poses, because a search for other starts takes most of the time and finds the same end
    known = {"initial_poses": log.true_poses, "control_variances": honest_variances(log)}
    right = log.with_sightings(real, landmarks=truth.landmarks[real]).replace(**known)
    estimate = dict(SPREADS)
    sensor = widened(truth.sensor, width(right, truth))
    while True:
        graph = Graph.from_log(right, motion=truth.motion, sensor=sensor, edges="landmark+motion", estimate=estimate)
        try:
            return solve(graph, initialize="given")
        except GraphError as error:
            # a short drive may not tell all of them, and the message names those that it does not tell
            untold = [name for name in estimate if name in str(error)]
            if not untold:
                raise
            del estimate[untold[0]]


def width(log: Log, truth: DriveTruth) -> float:
    """The factor on the standard deviations of independent errors that stand for the correlated ones of a log with right ids.

    n errors, a part s of whose variance is correlated as exp(-lapse / tau) over r tau seconds, have a mean with the variance
    ((1 - s) + s n g) / n, g = 2 (r - 1 + exp(-r)) / r²: for places of landmarks each counts as one error with k = (1 - s) +
    s n g times the variance, for the motion from one sighting to the next as one with 1 - s. The geometric mean of 1 and the
    mean k gives an ATE within 6 % (median) of the best of the widths 1, k^(1/4), k^(1/2) and sqrt(1 - s + 2 s N), N the
    number of scans, and a NEES near 1 (the 19 such drives among the first 39 of `TUNING`). Visits end where a landmark is
    not seen for tau.
    """
    if truth.correlated == 0:
        return 1.0
    assert log.times is not None
    s, tau = truth.correlated, truth.correlation_time
    factors = []
    for landmark in log.landmark_ids:
        times = log.times[log.steps[log.landmarks == landmark]]
        for visit in np.split(times, np.flatnonzero(np.diff(times) > tau) + 1):
            r = max(float(np.ptp(visit)) / tau, 1e-3)
            g = 2 * (r - 1 + np.exp(-r)) / r**2
            factors += [(1 - s) + s * len(visit) * g] * len(visit)
    return float(np.mean(factors) ** 0.25)


def widened(sensor: SensorModel, factor: float) -> SensorModel:
    """The sensor with a factor on its standard deviations."""
    names = ("range_rate", "range_std", "bearing_std", "orientation_std")
    return replace(sensor, **{name: getattr(sensor, name) * factor for name in names})


@dataclass(frozen=True)
class Row:
    """The figures of one drive; ATE [m], times of the processor [s]; None where there is no result."""

    seed: int
    name: str
    sightings: int
    dead_reckoning: float
    oracle: float | None = None
    oracle_nees: float | None = None
    default: float | None = None
    nees: float | None = None
    misread: float = 0.0
    found: float | None = None
    seconds: float = 0.0
    plain: float | None = None
    warnings: tuple[str, ...] = ()
    failure: str = ""
    others: dict[str, float | None] = field(default_factory=dict)
    expected: float | None = None

    @property
    def ratio(self) -> float | None:
        """The ATE of the default over that of the oracle."""
        return None if self.oracle is None or self.default is None else self.default / self.oracle

    @property
    def silently_bad(self) -> bool:
        """Whether the result is bad and nothing says so."""
        if self.ratio is None or self.default is None or self.warnings:
            return False
        return self.ratio > BAD and self.default > HARMLESS

    @property
    def unexpectedly_bad(self) -> bool:
        """Whether the run states a much smaller error, too."""
        return self.silently_bad and (self.expected is None or (self.default or 0.0) > BAD * self.expected)


def row(
    seed: int,
    misread: float | None = None,
    run: Runner = default_run,
    plain: bool = False,
    oracles: Path | None = None,
    bearings: float = 1.0,
    ranges: tuple[str, float] | None = None,
    turns: float = 0.0,
    kind: str = "random",
) -> Row:
    """All ways on one drive of `DRIVES`; ``misread`` replaces the part of the ids that are misread."""
    drive = DRIVES[kind](seed)
    log, truth = (drive if misread is None else replace(drive, misread=misread)).simulate()
    assert log.true_poses is not None
    figures: dict[str, Any] = {
        "seed": seed, "name": drive.place, "sightings": len(log.steps), "misread": truth.misread_share,
        "dead_reckoning": ate(log.true_poses, log.dead_reckoning()),
    }  # fmt: skip
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        kept = None if oracles is None else oracles / f"{'' if kind == 'random' else kind}{seed}-{misread}.json"
        if kept is not None and kept.exists():
            figures |= json.loads(kept.read_text(encoding="utf-8"))
        else:
            best = oracle_figures(log, truth)
            figures |= best
            if kept is not None:
                kept.parent.mkdir(parents=True, exist_ok=True)
                kept.write_text(json.dumps(best), encoding="utf-8")
        try:
            figures["plain"] = plain_seconds(log) if plain else None
            given = levelled(log if ranges is None else off_ranges(log, truth, *ranges), [Uneven(1, -turns, 0.0)])
            outcome = run(given.replace(sightings=given.sightings * [1.0, bearings, 1.0][: given.sightings.shape[1]]))
            figures |= {
                "default": ate(log.true_poses, outcome.poses), "nees": outcome.nees, "found": outcome.misread,
                "seconds": outcome.seconds, "warnings": outcome.warnings, "others": outcome.others,
                "expected": outcome.expected,
            }  # fmt: skip
        except SlamError as error:
            figures["failure"] = f"default: {error}"
    return Row(**figures)


def oracle_figures(log: Log, truth: DriveTruth) -> dict[str, Any]:
    """ATE and NEES of the oracle, or why there are none."""
    assert log.true_poses is not None
    try:
        best = oracle(log, truth)
    except SlamError as error:
        return {"failure": f"oracle: {error}"}
    return {"oracle": ate(log.true_poses, best.poses), "oracle_nees": _nees(best, log)}


def _nees(solution: Solution, log: Log) -> float | None:
    """As in the table of ``run``: errors relative to the first pose."""
    result = EstimatorResult(
        name="oracle", poses=solution.poses, estimated=solution.estimated, seconds=0.0, graph=solution.graph,
        state=solution.state, origin=solution,
    )  # fmt: skip
    return result.nees(log.robot_truth)


def line(r: Row) -> str:
    """The row as a line of the table."""
    cells = [f"{r.seed:5} {r.name:9} {r.sightings:6} {r.dead_reckoning:8.3f}"]
    cells += [f"{'-' if x is None else format(x, '.4f'):>8}" for x in (r.oracle, r.default)]
    cells += [f"{'-' if x is None else format(x, '.2f'):>7}" for x in (r.ratio, r.oracle_nees, r.nees)]
    cells += [f"{100 * r.misread:6.1f} {'-' if r.found is None else format(100 * r.found, '.1f'):>6}"]
    cells += [
        f"{'-' if r.plain is None else format(r.plain, '.2f'):>6} {r.seconds:6.2f}",
        "SILENT" if r.silently_bad else "warned" if r.warnings else "",
        *(f"{name} {'-' if error is None else format(error, '.4f')}" for name, error in r.others.items()),
    ]
    return " ".join([*cells, r.failure]).rstrip()


HEAD = " seed place     sights  d.reck.   oracle  default   ratio  o.NEES    NEES   mis%  found  plain      s"


def summary(rows: list[Row]) -> str:
    """What the rows say together."""
    both = [r for r in rows if r.ratio is not None]
    lines = [f"{len(rows)} drives, {len(both)} with oracle and default"]
    if both:
        ratios, nees = (
            np.array([r.ratio for r in both]),
            np.array([r.nees if r.nees is not None else np.nan for r in both]),
        )
        median, most = np.quantile(ratios, [0.5, 0.95])
        lines.append(
            f"ATE over the oracle's: median {median:.2f}, 95 % {most:.2f}, above {BAD:g}: {np.sum(ratios > BAD)}"
        )
        worse = sum(r.default > 1.1 * r.dead_reckoning for r in both if r.default is not None)
        lines.append(f"worse than dead reckoning by more than 10 %: {worse}")
        within = np.mean((nees >= 0.5) & (nees <= 2))
        lines.append(f"NEES / 3 between 0.5 and 2: {100 * within:.0f} %, median {np.nanmedian(nees):.2f}")
        own = np.array([np.nan if r.oracle_nees is None else r.oracle_nees for r in both])
        lines.append(f"of the oracle: {100 * np.mean((own >= 0.5) & (own <= 2)):.0f} %, median {np.nanmedian(own):.2f}")
        told = [r for r in both if r.found is not None and r.misread > 0]
        third = sum(abs(r.found - r.misread) <= r.misread / 3 for r in told if r.found is not None)
        lines.append(f"found share of misread ids within a third: {third} of {len(told)}")
        lines.append(
            f"warned: {sum(bool(r.warnings) for r in both)}, silently bad: {sum(r.silently_bad for r in both)}, "
            f"of these unexpectedly: {sum(r.unexpectedly_bad for r in both)}"
        )
        stated = np.array([r.default / r.expected for r in both if r.default and r.expected])
        lines.append(f"ATE over the expected one: median {np.median(stated):.2f}, 90 % between "
                     f"{np.quantile(stated, 0.05):.2f} and {np.quantile(stated, 0.95):.2f}")  # fmt: skip
        lines.append(f"median {np.median([r.seconds for r in both]):.2f} s")
        timed = [(r.seconds, r.plain) for r in both if r.plain is not None]
        if timed:
            slow = sum(seconds > 3 * plain + 1 for seconds, plain in timed)
            lines[-1] += f", plain {np.median(timed, axis=0)[1]:.2f} s; above three times plain and one second: {slow}"
        for name in both[0].others:
            ratios = np.array([(r.others[name] or np.nan) / r.default for r in both if r.default])
            lines.append(f"ATE of {name} over that of the graph: median {np.nanmedian(ratios):.2f}, 95 % "
                         f"{np.nanquantile(ratios, 0.95):.2f}, without a result {np.sum(np.isnan(ratios))}")  # fmt: skip
    return "\n".join(lines)


def seeds_of(word: str) -> range:
    """The seeds that a word of the command line names."""
    named = {"tuning": TUNING, "reporting": REPORTING}
    if word in named:
        return named[word]
    first, _, last = word.partition("-")
    return range(int(first), int(last or first) + 1)


def value_of(word: str) -> tuple[str, Any]:
    """The name and the value of NAME=VALUE: a number where it is one, else text."""
    name, _, value = word.partition("=")
    try:
        return name, json.loads(value)
    except json.JSONDecodeError:
        return name, value


def sizes() -> Iterator[dict[str, Any]]:
    """Rows: processor times for drives of 5, 20, 90 and 180 minutes."""
    for seed, minutes in enumerate((5, 20, 90, 180), 3100):
        log, _ = Drive(seed=seed, duration=60.0 * minutes).simulate()
        begin = time.process_time()
        found = estimate_robot(log)
        estimated = time.process_time()
        solve(Graph.from_log(found.log))
        solved = time.process_time()
        print(f"{len(log.sightings):6} sightings: {estimated - begin:.1f} s, {solved - estimated:.1f} s", flush=True)
        counts = {"minutes": minutes, "sightings": len(log.sightings), "controls": len(log.controls)}
        yield {"name": f"{minutes} minutes"} | counts | {"estimate_s": estimated - begin, "solve_s": solved - estimated}


def main() -> None:
    """Run the drives, print a line for each and a summary."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=seeds_of, default=TUNING, help="tuning, reporting, one seed, or FIRST-LAST")
    parser.add_argument("--drives", type=int, help="only so many of them, from the first on")
    parser.add_argument("--jobs", type=int, default=0, help="processes; 0: this one")
    parser.add_argument("--misread", type=float, help="the part of the ids that are misread, on all drives")
    parser.add_argument(
        "--option", action="append", default=[], metavar="NAME=VALUE", help="an option of slam-compare run"
    )
    parser.add_argument(
        "--also", default="", help="further estimators with the same noise, for example fastslam,fastslam2"
    )
    parser.add_argument("--drive", choices=DRIVES, default="random", help="what the seeds stand for")
    parser.add_argument("--bearings", type=float, default=1.0, help="what all bearings are multiplied with")
    parser.add_argument(
        "--ranges", type=value_of, metavar="KIND=SIZE", help=f"ranges that are off: {', '.join(RANGES)}"
    )
    parser.add_argument("--turns", type=float, default=0.0, help="the part by which left turns are recorded larger")
    parser.add_argument("--no-ids", action="store_true", help="take the ids from all sightings; the oracle keeps them")
    parser.add_argument("--plain", action="store_true", help="time the graph with the noise of the book, too")
    parser.add_argument("--oracles", type=Path, help="a folder that keeps the figures of the oracle")
    add_option(parser)
    parser.add_argument("--sizes", action="store_true", help="the time by the length of a drive, and nothing else")
    arguments = parser.parse_args()
    if arguments.sizes:
        record(arguments.record, "unknown_robot_sizes", list(sizes()))
        return
    options = dict(value_of(word) for word in arguments.option)
    options["also"] = tuple(filter(None, arguments.also.split(",")))
    task = partial(
        row, misread=arguments.misread, run=partial(default_run, without_ids=arguments.no_ids, **options),
        plain=arguments.plain, oracles=arguments.oracles, kind=arguments.drive, bearings=arguments.bearings,
        ranges=arguments.ranges, turns=arguments.turns,
    )  # fmt: skip
    rows = []
    print(HEAD)
    drives = DRIVES[arguments.drive]
    camera = (s for s in arguments.seeds if arguments.bearings == 1.0 or drives(s).sensor.field_of_view < CAMERA)
    seeds = list(islice(camera, arguments.drives))
    done: Iterable[Row]
    with ExitStack() as stack:
        if arguments.jobs > 0:
            # these import this file, which the processes of `comparisons.estimators.attempt` do not
            pool = stack.enter_context(get_context("spawn").Pool(arguments.jobs, warm_up, ("graph",)))
            done = pool.imap(task, seeds)
        else:
            warm_up("graph")
            done = map(task, seeds)
        for r in done:
            rows.append(r)
            print(line(r), flush=True)
    print(summary(rows))
    name = "unknown_robot" if arguments.drive == "random" else f"unknown_robot_{arguments.drive}"
    record(arguments.record, name, [asdict(r) | {"place": r.name, "name": f"seed {r.seed}"} for r in rows])


if __name__ == "__main__":
    main()
