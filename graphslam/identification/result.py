"""`RobotEstimate`: what was found about a robot that nobody has calibrated, in numbers and in sentences.

`left_out` compares candidates for the noise and biases of a robot by how well they predict sightings that are left out. A
part of a drive is left out with all its sightings, so that its poses follow from the odometry and its landmarks from other
visits: loop closures count. With e the difference between a sighting that is left out and its prediction, and F the
covariance of the prediction, its log density is that of Student's t with nu degrees of freedom, d numbers and S = C + F,

    log p(e) = log Gamma((nu + d)/2) - log Gamma(nu/2) - d/2 log(nu pi) - 1/2 log|S| - (nu + d)/2 log(1 + e' S^-1 e / nu).

All candidates predict the same sightings with the same ids, as recorded but for ids that were corrected, so that a candidate
with wide noise gains nothing from it. Sightings of one part share the error of its odometry, so that their sum says less than
that of as many independent ones.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import lgamma, log, pi

import numpy as np

from ..errors import GraphError
from ..log import Log
from ..models import MotionModel, SensorModel
from ..se2 import Array
from .corrections import corrected_log, honest_variances, without_biases
from .declared import KINDS, PLACE, ParameterEstimate
from .odometry import NOISE, common_errors, sighting_times
from .restricted_likelihood import solved_with
from .sensor_errors import Lens, Turn, turned_back, undistorted
from .sighting_errors import LAGS, Ids, Predictions, RangeErrors, evened
from .slips import Slip, Uneven, levelled, with_slip
from .unknowns import DEGREES_SIGHTINGS, HELD, OF_GAUSSIAN_MOTIONS, PRIORS, Unknowns

#: the duration of a part that is left out [s], every which part is left out at once, and the steps to the new solution,
#: before and after what edges hide is known
DURATION, FOLDS, STEPS = 10.0, 3, (3, 2)
#: drives with fewer parts are not scored
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
    scored = np.isfinite(sum(each.values(), np.zeros(len(drive.steps))))
    count = int(np.count_nonzero(scored))
    return LeftOut(count, {name: float(np.mean(values[scored])) if count else 0.0 for name, values in each.items()})


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
            rest = solved_with(candidate, drive, np.where(fold == k, own, landmarks.ravel()), STEPS)
            rows = np.flatnonzero((fold == k) & np.isin(landmarks.ravel(), rest.ids))
            edges, errors = Predictions(rest, rng).compare(
                drive, rows, np.searchsorted(rest.ids, landmarks.ravel()[rows])
            )
            covariances = rest.covariances(edges) + errors @ np.swapaxes(errors, 1, 2) / errors.shape[2]
            found[rows] = student_t(edges.residuals, covariances)
        except (GraphError, np.linalg.LinAlgError):
            # the part is not scored with this candidate
            continue
    return found


def student_t(residuals: Array, scales: Array, degrees: float = DEGREES_SIGHTINGS) -> Array:
    """The log densities (E,) of residuals (E, d) with the squared scales S (E, d, d); see the module."""
    d = residuals.shape[1]
    squares = np.einsum("ei,ei->e", residuals, np.linalg.solve(scales, residuals[:, :, None])[:, :, 0])
    constant = lgamma((degrees + d) / 2) - lgamma(degrees / 2) - d / 2 * log(degrees * pi)
    return constant - 0.5 * np.linalg.slogdet(scales)[1] - (degrees + d) / 2 * np.log1p(squares / degrees)


#: what predicts sightings that are left out, as `LeftOut` names it
ESTIMATE, DEAD_RECKONING, BOOK_NOISE, GIVEN_NOISE = (
    "the estimate from this log", "dead reckoning", "the book's noise", "the noise that was given"
)  # fmt: skip
#: a bias is identified where its standard deviation is below this share of that of the prior
MIN_INFORMATION = 0.7
#: an estimate is doubtful with fewer sightings than this, with more than this share of the ids wrong, and with a bias this
#: far from its ideal value [standard deviations of its prior], for which these are likely causes
FEW, MANY_MISREAD, IMPLAUSIBLE = 150, 0.2, 4.0
#: a remark says that the size of the map is that of the ranges where the wheels differ from them by more than this part
OTHER_SIZE = 0.05
#: fewer numbers that show the noise of the motion are a doubt (docs/decisions.md)
HARDLY_SHOWN = 12.0
#: more scans in one row of the odometry that lasts longer than the second number [s] are a doubt: with 4, 5 and 20 scans the
#: median NEES / 3 is 1.5, 1.5 and 2.4, and 9 to 18 at most; with 2 it is 1.0 (docs/decisions.md)
SCANS_IN_ROW, SLOW = 3.0, 0.2
#: sightings that are earlier than the odometry by more than this [s], and by so many standard deviations, have a remark:
#: sensors are late
EARLY, SURELY = 0.03, 4.0
CAUSES = {
    "wheel_scale": "are odometry and ranges in metres? A log tells only the quotient of their scales.",
    "turn_scale": "is the odometry in radians per second? Noise in recorded turns makes the scale too large.",
    "turn_rate_bias": "is the gyroscope calibrated?",
    "curvature_bias": "does one wheel have another radius?",
    "range_bias": "do ranges count from another point of the sensor, or are landmarks above or below it?",
    "bearing_bias": "is the sensor mounted straight?",
    "sensor_ahead": "is the place of the sensor right (sensor offset)?",
    "sensor_left": "is the place of the sensor right (sensor offset)?",
    "sensor_delay": "do odometry and sensor have the same clock?",
}


@dataclass(frozen=True, eq=False, kw_only=True)
class Systematic:
    """Errors of a robot beside noise and biases.

    Attributes:
        turns: moments at which the sensor was turned.
        lens: the error of the bearings that grows with them, if any.
        ranges: the errors of the ranges that differ between landmarks, if any.
        uneven: scales of the odometry that differ between two directions.
    """

    turns: tuple[Turn, ...] = ()
    lens: Lens | None = None
    ranges: RangeErrors | None = None
    uneven: tuple[Uneven, ...] = ()

    def undone(self, log: Log, *, turned: bool = True) -> Log:
        """The log without them, but with those of the ranges; without ``turned`` the sensor was not turned."""
        # the axis of the lens is that of the sensor, so that its error is undone first
        return turned_back(undistorted(levelled(log, self.uneven), self.lens), self.turns if turned else ())


@dataclass(frozen=True, eq=False, kw_only=True)
class RobotEstimate(Systematic):
    """What `estimate_robot` finds; its log is without the errors of `Systematic`.

    Attributes:
        log: the log with the ids corrected, clutter left out, scales and biases taken out, and these noise models as its own.
        motion, sensor: the noise models. That of the sensor counts correlated sightings as `inflation` says.
        parameters: scales, biases, delay and place of the sensor with their covariance, without those that are held.
        errors: {name of a noise value: its standard error as a part of the value}.
        ids: those of the given log, checked. Sightings without an id are corrected like the others, but tell nothing.
        correlations: (B,) of the errors of one landmark over the lags between `LAGS`.
        inflation: the factor on the variances of the sensor with which its errors count as independent; 1: they are.
        nearly_exact: whether nothing in the log speaks against exact odometry, whose noise is then a part of its estimate.
        left_out: how well this estimate, dead reckoning and the noise of the book (or noise that was given) predict
            sightings that are left out.
        basis: whose noise the result has: that of the estimate, or of one of the other two where this is clearly better.
        on_motion: how many independent numbers show the noise of the motion, if that is typical.
        untested: the biases that were not estimated, because measurements of this kind do not tell them.
        of_scans: the error that all sightings of a scan have in common along the way [m], which the noise of the sensor
            contains and that of the odometry does not; 0 where the log shows none.
        slips: stretches on which the odometry is wrong; the log has more noise of the controls there.
        in_map: whether the map of the robot tells the biases, too.
        against_map: why it does not although there is one; empty otherwise.
    """

    log: Log
    motion: MotionModel
    sensor: SensorModel
    parameters: ParameterEstimate
    errors: dict[str, float] = field(default_factory=dict)
    ids: Ids
    correlations: Array = field(default_factory=lambda: np.zeros(len(LAGS) - 1))
    inflation: float = 1.0
    nearly_exact: bool = False
    left_out: LeftOut
    basis: str = ESTIMATE
    on_motion: float = np.inf
    untested: tuple[str, ...] = ()
    of_scans: float = 0.0
    slips: tuple[Slip, ...] = ()
    in_map: bool = False
    against_map: str = ""

    def __repr__(self) -> str:
        return f"<RobotEstimate: {'; '.join(self.sentences)}>"

    def corrected(self, log: Log) -> Log:
        """A log of the robot without the biases that were found, with these noise models; repaired motions as recorded.

        Slips and turns of the sensor belong to the drive: to its times.
        """
        own = self.log.times
        same = log.times is not None and own is not None and np.array_equal(log.times, own)
        biases = {n: value for n, value in zip(self.parameters.names, self.parameters.values) if n not in PLACE}
        log = evened(self.undone(log, turned=same), self.ranges)
        log = without_biases(log, motion=self.motion, sensor=self.sensor, **biases)
        for slip in self.slips if same else ():
            log = with_slip(log, slip)
        variances = honest_variances(log)
        return log.replace(
            motion=self.motion, sensor=self.sensor, uncertain=self.log.uncertain, control_variances=variances
        )

    @property
    def sentences(self) -> tuple[str, ...]:
        """What was found, for the notes of a table."""
        if self.basis in (BOOK_NOISE, GIVEN_NOISE):
            taken = f"{self.basis} is taken, because it predicts sightings better than an estimate from this log"
            of_ids = self.ids.sentence, self.ids.sentence_on_moved
            return tuple(each for each in (taken, self.left_out.sentence, *of_ids) if each is not None)
        values = vars(self.motion) | {n: v for n, v in vars(self.sensor).items() if n not in SensorModel.GEOMETRY}
        noise = ", ".join(
            f"{name} {values[name]:.2g} +- {100 * error:.0f} %" for name, error in self.errors.items() if error < 1
        )
        lines = [f"noise estimated from this log: {noise or 'it tells no value, so that typical ones are taken'}"]
        if self.inflation > 1 and noise:
            lines[0] += (
                f" (standard deviations; those of the sensor {self.inflation**0.5:.1f} times those of single sightings)"
            )
        if self.of_scans:
            lines.append(
                f"the sightings of each scan have an error in common of about {self.of_scans:.2g} m along the way, as where "
                "times are inexact: the noise of the sensor contains it"
            )
        p = self.parameters
        informed = [name for name in p.names if p.deviations[name] < MIN_INFORMATION * p.priors[name][1]]
        if informed:
            what = "biases estimated from this log in its map" if self.in_map else "biases estimated from this log"
            lines.append(f"{what}: {p.sentence_of(informed)}")
        if uninformed := [name for name in p.names if name not in informed]:
            lines.append(f"the log says little about {', '.join(uninformed)}: {p.sentence_of(uninformed)}")
        return (*lines, *self.remarks)

    @property
    def doubts(self) -> tuple[str, ...]:
        """Why the result may be wrong although noise and biases were found, one sentence each."""
        p, lines = self.parameters, [self.against_map] * bool(self.against_map)
        for k, name in enumerate(p.names):
            mean, _ = p.priors[name]
            if abs(p.values[k] - mean) > IMPLAUSIBLE * PRIORS[name]:
                lines.append(
                    f"{name}, estimated as {p.values[k]:.3g}, is rarely so far from {mean:g}; {CAUSES[name]} If the value is "
                    "wrong, so are the trajectory and its standard deviations"
                )
        # of single sightings
        of_sensor = {name: value / self.inflation**0.5 for name, value in vars(self.sensor).items() if name in NOISE}
        values = vars(self.motion) | of_sensor
        speed = 0.0 if self.log.controls is None else float(np.sqrt(np.mean(self.log.controls[:, 0] ** 2)))
        larger = dict.fromkeys(("nn", "slip"), max(speed, 1.0) ** 0.5)
        lines += [
            f"{name}, estimated as {values[name]:.2g}, is more than usual robots have (at most {most:.2g}): perhaps "
            + of.cause
            for name, of in NOISE.items()
            if self.errors.get(name, 1) < 1 and values[name] > (most := of.unusual * larger.get(name, 1.0))
        ]
        lines += [slip.sentence(self.log) for slip in self.slips]
        lines += [turn.sentence(self.log) for turn in self.turns]
        # one that was found twice counts with both parts
        of_column = {each.column: each for each in self.uneven}
        lines += [
            replace(each, difference=sum(part.difference for part in self.uneven if part.column == column)).sentence
            for column, each in of_column.items()
        ]
        if self.lens is not None:
            lines.append(self.lens.sentence)
        if self.ranges is not None:
            lines += self.ranges.sentences
        if (reflections := self.ids.reflections) is not None:
            lines.append(reflections)
        if self.basis == DEAD_RECKONING:
            lines.append(
                "the odometry is taken as it is, with hardly any noise, because the sightings show none: what the sensor "
                "is too poor to show is missing in the standard deviations of the poses; noise that is known goes into "
                "motion and sensor models, or noise=FILE"
            )
        if (scans := self._scans_in_row) > SCANS_IN_ROW:
            lines.append(
                f"the odometry has one row for about {scans:.0f} scans, and does not say how speeds change within a row: "
                "scales, place and delay of the sensor may be off by several standard deviations, and so may the poses. "
                "Record the odometry as often as the sensor sees, and give the sensor offset and the delay where they are "
                "known"
            )
        if self.on_motion < HARDLY_SHOWN:
            lines.append(
                "the drive is too short, or the sensor too poor, to tell the noise of the odometry: the standard deviations "
                "of the poses may be half as large as they should be; noise that is known goes into motion and "
                "sensor models, or noise=FILE"
            )
        if self.ids.share > MANY_MISREAD:
            lines.append(
                f"of the ids {self.ids.share:.0%} contradict the other sightings; is the column of the ids right, and did "
                "the odometry neither slip nor jump?"
            )
        if (count := np.count_nonzero(self.ids.identified)) < FEW:
            lines.append(
                f"the log has only {count} sightings with ids, which tell the noise roughly: the trajectory may be several "
                "times less accurate than with the true noise, which motion and sensor models, or noise=FILE, give"
            )
        return tuple(lines)

    @property
    def _scans_in_row(self) -> float:
        """How many scans there are while one row of the odometry lasts, where rows last longer than `SLOW`, else 0."""
        drive = self.log
        if drive.dt is None or len(scans := np.unique(sighting_times(drive))) < 2:
            return 0.0
        lasting = float(np.median(drive.dt if drive.recorded_dt is None else drive.recorded_dt))
        return lasting / float(np.median(np.diff(scans))) if lasting > SLOW else 0.0

    @property
    def remarks(self) -> tuple[str, ...]:
        """What was found beside noise and biases, one sentence each."""
        tested = {kind: [name for name in names if name not in self.untested] for kind, names in KINDS.items()}
        lines = [
            f"the log does not show a bias of the {kind} beside its noise: {', '.join(names)} keep their ideal values"
            for kind, names in tested.items()
            if names and not set(names) & set(self.parameters.names)
        ]
        if self.untested:
            which = ", ".join(self.untested)
            lines.append(f"not estimated from these ranges and bearings alone: {which} keep their ideal values")
        scale = self.parameters["wheel_scale"] if "wheel_scale" in self.parameters.names else 1.0
        if abs(scale - 1) > OTHER_SIZE and not self.in_map:
            lines.append(
                f"the scales of wheels and ranges differ by {abs(scale - 1):.1%}, and the log does not tell which of them is "
                "wrong: the trajectory and the landmarks have the size that the ranges say. One distance that is measured by "
                "hand tells"
            )
        delay = self.parameters["sensor_delay"] if "sensor_delay" in self.parameters.names else 0.0
        if delay < -EARLY and -delay > SURELY * self.parameters.deviations["sensor_delay"]:
            lines.append(
                f"the times of the sightings are {-delay:.2g} s before those of the odometry, and the poses have the times "
                "of the odometry: does each row of it hold from its time to that of the next row, or are its times those of "
                f"the ends? In the second case, or where its clock is late, state clocks='odometry={delay:.2g}'"
            )
        if self.left_out.sentence is not None:
            lines.append(self.left_out.sentence)
        if self.basis == DEAD_RECKONING:
            lines.append(
                "dead reckoning predicts these sightings as well or better: the odometry is taken as it is, with hardly any "
                "noise"
            )
        elif self.nearly_exact:
            lines.append(
                "the log does not show that the odometry is noisy: the noise of the motion was reduced to a third of its "
                "estimate"
            )
        if nameless := np.count_nonzero(~self.ids.identified):
            count = len(self.ids.identified)
            lines.append(f"{nameless} of {count} sightings have no id and were not used for the estimate")
        if (contradicting := self.ids.sentence) is not None:
            lines.append(contradicting)
        if self.ids.sentence_on_moved is not None:
            lines.append(self.ids.sentence_on_moved)
        if self.inflation > 1:
            span = LAGS[int(np.count_nonzero(self.correlations))]
            lines.append(
                f"errors of successive sightings of a landmark are correlated over up to {span:g} s; with errors that "
                f"landmarks have in common, {self.inflation:.1f} sightings count as one"
            )
        return tuple(lines)


def apart_from_scans(
    fitted: Unknowns, log: Log, motion: MotionModel, sensor: SensorModel
) -> tuple[MotionModel, SensorModel, float]:
    """The noise models with errors of whole scans as noise of the sensor instead of the odometry, and their size [m].

    Where poses follow such errors, as of inexact times, they look like noise of the odometry. With n sightings a scan of the
    variance s² + n c² each, their mean has the variance s²/n + c² of one with the common error c. Errors of the bearing alone
    stay as they are: single bearings would lose what they say of landmarks (docs/decisions.md).
    """
    motions = fitted.motions()
    covariances = fitted.covariances(motions) / OF_GAUSSIAN_MOTIONS
    found = common_errors(motions.first, motions.second, motions.residuals, covariances)
    if found is None or found.covariance[0, 0] == 0:
        return motion, sensor, 0.0
    ahead, _, turned = np.diag(found.covariance)
    n, away = len(log.steps) / len(np.unique(log.steps)), float(np.median(log.sightings[:, 0]))
    axes = {0: ("nn", "no", "sigma_v"), 2: ("on", "oo", "sigma_omega")}
    less = {name: getattr(motion, name) * found.own[k] ** 0.5 for k, names in axes.items() for name in names}
    _, along, across, _ = SensorModel.NOISE
    more = {along: n * ahead, across: n * (ahead / away**2 + turned)}
    larger = {name: np.sqrt(getattr(sensor, name) ** 2 + variance).item() for name, variance in more.items()}
    return replace(motion, **less), replace(sensor, **larger), float(np.sqrt(ahead))


def without_found(
    last: Unknowns, log: Log, held: Mapping[str, float], motion: MotionModel, sensor: SensorModel
) -> tuple[Log, ParameterEstimate]:
    """A log without the biases of a solution and with these noise models, and the biases that were found.

    Args:
        held: {name of a bias that keeps its ideal value, but may have another one: its standard deviation}.
    """
    parameters = replace(last.parameters, recorded=log)
    free = np.flatnonzero(parameters.deviations > HELD)
    every = (parameters.names, parameters.means, parameters.deviations)
    names, means, deviations = (np.array(each)[free].tolist() for each in every)
    uncertain = {**held, **(log.uncertain or {}), **dict(zip(names, deviations))}
    corrected = corrected_log(parameters).replace(motion=motion, sensor=sensor, uncertain=uncertain)
    variances = honest_variances(corrected)
    corrected = corrected.replace(initial_poses=corrected.dead_reckoning(), control_variances=variances)
    return corrected, ParameterEstimate(
        tuple(names), parameters.values[free], last.parameter_covariance()[np.ix_(free, free)],
        {name: (m, s) for name, m, s in zip(names, means, deviations)},
    )  # fmt: skip
