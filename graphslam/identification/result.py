"""`RobotEstimate`: what was found about a robot that nobody has calibrated, in numbers and in sentences."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..log import Log
from ..models import MotionModel, SensorModel
from ..parameters.declared import ParameterEstimate
from ..se2 import Array
from .left_out import LeftOut
from .sighting_errors import LAGS, Ids

#: the biases of odometry and sensor
KINDS = {
    "odometry": ("wheel_scale", "turn_scale", "turn_rate_bias", "curvature_bias"),
    "sensor": ("range_bias", "bearing_bias", "sensor_ahead", "sensor_left", "sensor_delay"),
}
#: what predicts sightings that are left out, as `LeftOut` names it
ESTIMATE, DEAD_RECKONING, BOOK_NOISE, GIVEN_NOISE = (
    "the estimate from this log", "dead reckoning", "the book's noise", "the noise that was given"
)  # fmt: skip
#: a log tells a bias where its standard deviation is below so many times that of the prior
TOLD = 0.7
#: an estimate is doubtful with fewer sightings than this, with more than this part of the ids wrong, and with a bias that is
#: so many standard deviations of its prior from its ideal value, for which these are likely causes
FEW, MANY_MISREAD, IMPLAUSIBLE = 150, 0.2, 4.0
CAUSES = {
    "wheel_scale": "are odometry and ranges in metres? A log tells only the quotient of their scales.",
    "turn_scale": "is the odometry in radians per second? Noise in recorded turns makes the scale too large.",
    "turn_rate_bias": "is the gyroscope calibrated?",
    "curvature_bias": "does one wheel have another radius?",
    "range_bias": "do ranges count from another point of the sensor?",
    "bearing_bias": "is the sensor mounted straight?",
    "sensor_ahead": "is the place of the sensor right (sensor offset)?",
    "sensor_left": "is the place of the sensor right (sensor offset)?",
    "sensor_delay": "do odometry and sensor have the same clock?",
}
#: noise above this is that of hardly any robot, for which these are likely causes; {name: (value, what it may be)}
UNUSUAL = {
    "nn": (0.3, "the speed is in another unit, or ids are wrong"),
    "on": (0.2, "the turn rate has another sign or unit, or bearings count clockwise"),
    "oo": (0.15, "the turn rate has another sign or unit, or bearings count clockwise"),
    "slip": (0.3, "the robot does not move along its heading"),
    "range_rate": (0.3, "ranges and odometry have other units, or ids are wrong"),
    "bearing_std": (0.3, "bearings count clockwise or from another axis, or ids are wrong"),
}


@dataclass(frozen=True, eq=False, kw_only=True)
class RobotEstimate:
    """What `estimate_robot` finds.

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
    """

    log: Log
    motion: MotionModel
    sensor: SensorModel
    parameters: ParameterEstimate
    errors: dict[str, float]
    ids: Ids
    correlations: Array
    inflation: float
    nearly_exact: bool
    left_out: LeftOut
    basis: str = ESTIMATE

    def __repr__(self) -> str:
        return f"<RobotEstimate: {'; '.join(self.sentences)}>"

    @property
    def sentences(self) -> tuple[str, ...]:
        """What was found, for the notes of a table."""
        if self.basis in (BOOK_NOISE, GIVEN_NOISE):
            taken = f"{self.basis} is taken, because it predicts sightings better than an estimate from this log"
            return tuple(each for each in (taken, self.left_out.sentence, self.ids.sentence) if each is not None)
        values = vars(self.motion) | {n: v for n, v in vars(self.sensor).items() if n not in SensorModel.GEOMETRY}
        noise = ", ".join(
            f"{name} {values[name]:.2g} +- {100 * error:.0f} %" for name, error in self.errors.items() if error < 1
        )
        lines = [f"noise estimated from this log: {noise or 'it tells no value, so that typical ones are taken'}"]
        if self.inflation > 1 and noise:
            lines[0] += (
                f" (standard deviations; those of the sensor {self.inflation**0.5:.1f} times those of single sightings)"
            )
        p = self.parameters
        told = [name for name in p.names if p.deviations[name] < TOLD * p.priors[name][1]]
        if told:
            lines.append(f"biases estimated from this log: {p.sentence_of(told)}")
        if untold := [name for name in p.names if name not in told]:
            lines.append(f"the log hardly tells {', '.join(untold)}: {p.sentence_of(untold)}")
        return (*lines, *self.remarks)

    @property
    def doubts(self) -> tuple[str, ...]:
        """Why the result may be wrong although noise and biases were found, one sentence each."""
        p, lines = self.parameters, []
        for k, name in enumerate(p.names):
            mean, deviation = p.priors[name]
            if abs(p.values[k] - mean) > IMPLAUSIBLE * deviation:
                lines.append(
                    f"{name}, estimated as {p.values[k]:.3g}, is rarely so far from {mean:g}; {CAUSES[name]} If the value is "
                    "wrong, so are the trajectory and its standard deviations"
                )
        # of single sightings
        of_sensor = {name: value / self.inflation**0.5 for name, value in vars(self.sensor).items() if name in UNUSUAL}
        values = vars(self.motion) | of_sensor
        lines += [
            f"{name}, estimated as {values[name]:.2g}, is more than usual robots have (at most {most:g}): perhaps {why}"
            for name, (most, why) in UNUSUAL.items()
            if name in self.errors and self.errors[name] < 1 and values[name] > most
        ]
        if self.ids.share > MANY_MISREAD:
            lines.append(
                f"{self.ids.share:.0%} of the ids contradict the other sightings; is the column of the ids right?"
            )
        if (count := np.count_nonzero(self.ids.identified)) < FEW:
            lines.append(
                f"the log has only {count} sightings with ids, which tell the noise roughly: the trajectory may be several "
                "times less accurate than with the true noise, which --noise FILE or the noise options give"
            )
        return tuple(lines)

    @property
    def remarks(self) -> tuple[str, ...]:
        """What was found beside noise and biases, one sentence each."""
        lines = [
            f"the log does not show a bias of the {kind} beside its noise: {', '.join(names)} keep their ideal values"
            for kind, names in KINDS.items()
            if not set(names) & set(self.parameters.names)
        ]
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
        nameless = np.count_nonzero(~self.ids.identified)
        if nameless:
            lines.append(
                f"{nameless} of {len(self.ids.identified)} sightings have no id and were not used for the estimate"
            )
        if (contradicting := self.ids.sentence) is not None:
            lines.append(contradicting)
        if self.inflation > 1:
            span = LAGS[int(np.count_nonzero(self.correlations))]
            lines.append(
                f"errors of successive sightings of a landmark are correlated over up to {span:g} s; with errors that "
                f"landmarks have in common, {self.inflation:.1f} sightings count as one"
            )
        return tuple(lines)
