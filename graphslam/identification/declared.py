"""The parameters that a graph can estimate: what they mean, their values and priors, and their estimate.

A recorded control is (nu_r, omega_r), a measured sighting (l_r, phi_r[, psi]). With the parameters by their names

    nu_r = wheel_scale nu,     omega_r = turn_scale omega + turn_rate_bias + curvature_bias nu,
    l_r = range_scale l + range_bias,     phi_r = phi + bearing_bias,

the sensor sits at (sensor_ahead, sensor_left) of the robot's pose, and sightings carry times that are late by sensor_delay.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from math import floor, inf, log10
from typing import Any

import numpy as np

from ..errors import GraphError, OptionError, quoted
from ..errors.checks import suggestion
from ..log import Log
from ..models import EdgeOptions, MotionModel, SensorModel
from ..se2 import Array


@dataclass(frozen=True)
class Parameter:
    """A number by which all measurements of a log may be wrong.

    Attributes:
        ideal: its value where nothing is wrong; for the place of the sensor that of the sensor model.
        unit, help: its unit, and one sentence.
        of_motion: whether it corrects the controls, otherwise the sightings.
        limit: a standard deviation above this says that the log does not tell the parameter.
    """

    ideal: float
    unit: str
    help: str
    of_motion: bool
    limit: float = inf


#: the parameters by name
PARAMETERS = {
    "wheel_scale": Parameter(1.0, "", "Recorded speed = scale * speed", True, 0.5),
    "turn_scale": Parameter(1.0, "", "Recorded turn rate = scale * turn rate + biases", True, 0.5),
    "turn_rate_bias": Parameter(0.0, "rad/s", "Bias of the recorded turn rate, as of a gyroscope", True, 1.0),
    "curvature_bias": Parameter(0.0, "rad/m", "Bias of the recorded turn rate per speed, as of a steering", True, 1.0),
    "range_scale": Parameter(1.0, "", "Measured range = scale * range + range_bias", False, 0.5),
    "range_bias": Parameter(0.0, "m", "Bias of the measured range", False),
    "bearing_bias": Parameter(0.0, "rad", "Bias of the measured bearing", False, 0.5),
    "sensor_ahead": Parameter(0.0, "m", "Position of the sensor on the robot, forward", False, 0.5),
    "sensor_left": Parameter(0.0, "m", "Position of the sensor on the robot, to the left", False, 0.5),
    "sensor_delay": Parameter(0.0, "s", "How late the times of sightings are against those of controls", False),
}

#: those of the sensor
OF_SIGHTINGS = tuple(name for name, parameter in PARAMETERS.items() if not parameter.of_motion)
#: the biases of odometry and sensor
KINDS = {
    "odometry": ("wheel_scale", "turn_scale", "turn_rate_bias", "curvature_bias"),
    "sensor": ("range_bias", "bearing_bias", "sensor_ahead", "sensor_left", "sensor_delay"),
}
#: the place of the sensor, which is part of the sensor model
PLACE = ("sensor_ahead", "sensor_left")
#: all others, which `without_biases` takes out of a log, with their ideal values
CORRECTIONS = {name: parameter.ideal for name, parameter in PARAMETERS.items() if name not in PLACE}


def of_sensor_alone(values: Mapping[str, float]) -> dict[str, float]:
    """The values {name: value} that correct a log without controls, too."""
    # a delay means nothing without controls
    return {name: value for name, value in values.items() if not PARAMETERS[name].of_motion and name != "sensor_delay"}


def one_after_the_other(first: dict[str, float], second: dict[str, float]) -> dict[str, Any]:
    """Two corrections as one; the second one is of a log that the first one has corrected."""
    a, b = CORRECTIONS | first, CORRECTIONS | second
    both = {name: a[name] * b[name] for name in CORRECTIONS if name.endswith("_scale")}
    both |= {name: a[name] + b[name] for name in ("bearing_bias", "sensor_delay")}
    both["range_bias"] = a["range_bias"] + a["range_scale"] * b["range_bias"]
    both["turn_rate_bias"] = a["turn_rate_bias"] + a["turn_scale"] * b["turn_rate_bias"]
    both["curvature_bias"] = a["curvature_bias"] * b["wheel_scale"] + a["turn_scale"] * b["curvature_bias"]
    return both


@dataclass(frozen=True, eq=False)
class Parameters:
    """The parameters of one graph.

    Attributes:
        names: (K,) of `PARAMETERS`.
        values: (K,) where the graph evaluates its edges.
        means, deviations: (K,) of their priors; a deviation is infinite where there is no prior.
        recorded: the log as it was recorded.
        motion, sensor: the noise models, and the nominal place of the sensor.
        options: those of the edges of the graph.
    """

    names: tuple[str, ...]
    values: Array
    means: Array
    deviations: Array
    recorded: Log
    motion: MotionModel
    sensor: SensorModel
    options: EdgeOptions = field(default_factory=EdgeOptions)

    def __len__(self) -> int:
        return len(self.names)

    def at(self, values: Array) -> Parameters:
        """The same parameters with other values (K,)."""
        return replace(self, values=np.array(values, dtype=float))

    def by_name(self) -> dict[str, float]:
        """The values of all parameters of `PARAMETERS`, the ideal ones of those that are not estimated."""
        return ideal_values(self.sensor) | dict(zip(self.names, self.values.tolist()))

    @property
    def weights(self) -> Array:
        """The information (K,) of the priors, 0 without one."""
        return self.deviations**-2.0

    @property
    def prior_cost(self) -> float:
        """The sum of (p - mean)² / deviation² over the parameters with a prior."""
        return float(np.sum(self.weights * (self.values - self.means) ** 2))


@dataclass(frozen=True, eq=False, repr=False)
class ParameterEstimate:
    """Estimated parameters with their joint covariance.

    Attributes:
        names: (K,) of `PARAMETERS`.
        values: (K,).
        covariance: (K, K), that of the linearised problem, as for poses.
        priors: {name: (mean, standard deviation)} of the parameters that have a prior.
        doubt: one sentence that says why values and covariance are not reliable; empty where nothing speaks against them.
    """

    names: tuple[str, ...]
    values: Array
    covariance: Array
    priors: Mapping[str, tuple[float, float]]
    doubt: str = ""

    def __getitem__(self, name: str) -> float:
        return float(self.values[self.names.index(name)])

    @property
    def deviations(self) -> dict[str, float]:
        """The standard deviation of each."""
        return dict(zip(self.names, np.sqrt(np.diag(self.covariance)).tolist()))

    def __repr__(self) -> str:
        return f"<ParameterEstimate: {self.sentence}>"

    @property
    def sentence(self) -> str:
        """All values with their standard deviations, 'wheel_scale 1.035 +- 0.004, range_bias 0.12 +- 0.02 m'."""
        return self.sentence_of(self.names)

    def sentence_of(self, names: Iterable[str]) -> str:
        """The same for some of the values."""
        parts, values = [], dict(zip(self.names, self.values.tolist()))
        for name in names:
            unit = f" {PARAMETERS[name].unit}" if PARAMETERS[name].unit else ""
            parts.append(f"{name} {_as_known(values[name], self.deviations[name])}{unit}")
        return ", ".join(parts)


def _as_known(value: float, deviation: float) -> str:
    """Both with as many decimals as show two digits of the standard deviation: '0.870 +- 0.017'."""
    if not 1e-6 < deviation < 10:
        return f"{value:.4g} +- {deviation:.2g}"
    decimals = 1 - floor(log10(deviation))
    # adding zero makes -0.0 zero
    return f"{round(value, decimals) + 0.0:.{decimals}f} +- {deviation:.{decimals}f}"


def ideal_values(sensor: SensorModel) -> dict[str, float]:
    """The values of all parameters where nothing is wrong."""
    ideal = {name: parameter.ideal for name, parameter in PARAMETERS.items()}
    return ideal | dict(zip(PLACE, sensor.offset))


def declared(
    estimate: str | Iterable[str] | Mapping[str, float | None] | None, log: Log, motion: MotionModel, sensor: SensorModel,
    options: EdgeOptions,
) -> Parameters | None:  # fmt: skip
    """The parameters that a graph with these edges estimates, at their ideal values; None for none.

    Raises:
        OptionError: there is no such parameter, or its prior is impossible.
        GraphError: the edges have no such parameter.
    """
    found = parsed(() if estimate is None else estimate)
    if not found:
        return None
    if options.residual == "polar" and options.landmark_nodes:
        raise GraphError("parameters are estimated with residual='cartesian' only, and not with 'polar'")
    lost = [name for name in found if PARAMETERS[name].of_motion and not options.with_motion]
    if lost:
        raise GraphError(f"edges={quoted(options.edges)} has no motion edges, which alone depend on {', '.join(lost)}")
    if "sensor_delay" in found and log.controls is None:
        raise GraphError(f"{log.name} has no controls, which sensor_delay needs")
    means = np.array([ideal_values(sensor)[name] for name in found])
    return Parameters(tuple(found), means, means, np.array(list(found.values())), log, motion, sensor, options)


def parsed(estimate: str | Iterable[str] | Mapping[str, float | None]) -> dict[str, float]:
    """The parameters to estimate, {name: standard deviation of its prior}, infinite for none.

    Args:
        estimate: names, "a" or "a:0.1" with the standard deviation of a prior about the ideal value; or {name: deviation}.
            Hyphens count as underscores.

    Raises:
        OptionError: there is no such parameter, or a deviation is not positive.
    """
    if isinstance(estimate, np.ndarray):
        estimate = estimate.ravel().tolist()
    if isinstance(estimate, str):
        estimate = [word for word in estimate.split(",") if word.strip()]
    if not isinstance(estimate, Iterable):
        message = f"estimate must be names of parameters, not {quoted(estimate)}; they are {', '.join(PARAMETERS)}"
        raise OptionError(message)
    if isinstance(estimate, Mapping):
        pairs = [(str(name), inf if value is None else value) for name, value in estimate.items()]
    else:
        words = [str(word).partition(":") for word in estimate]
        pairs = [(name, after if colon else inf) for name, colon, after in words]
    found: dict[str, float] = {}
    for written, value in pairs:
        name = written.strip().replace("-", "_")
        if name not in PARAMETERS:
            raise OptionError(
                f"estimate: there is no parameter {quoted(written)}{suggestion(name, PARAMETERS)}; the parameters are "
                f"{', '.join(PARAMETERS)}"
            )
        try:
            deviation = float(value)
        except (TypeError, ValueError):
            deviation = -1.0
        if not deviation > 0:
            message = f"estimate: the prior of {name} must be a positive standard deviation, not {quoted(value)}"
            raise OptionError(message)
        found[name] = deviation
    return found
