"""The velocity motion model and the range-bearing(-orientation) sensor, with their derivatives, vectorised.

The method names are those of the equations: f, F, A, M for the motion and h, h^-1, H, R, Q for the sensor. Every
method takes arrays of any matching leading shape: poses (..., 3), controls (..., 2), sightings (..., 2 or 3).

Sources: Thrun, Burgard and Fox, Probabilistic Robotics, 5.3 and 6.6; Ueda, *LNPR* (the lectures' book), chapters 5 to 9.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from math import inf, pi
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from .engine import engine
from .errors import OptionError, quoted
from .errors.checks import check_options, check_positive, check_real, checked_offset, option
from .se2 import Array, mounted, sinc, sinc_derivative, stacked, wrap

#: the variances of speed, turn rate and sideways speed of a control of one second that stands for an unknown motion, such as
#: that between two drives: a kilometre, and several turns, in any direction
ANYWHERE = (1e6, 1e3, 1e6)
#: a predicted range counts as at least and at most so many times the measured one: wrong sightings predict anything
PLAUSIBLE = (0.5, 2.0)


class NoiseModel:
    """What both noise models have in common: `changed`, which is how options on the command line or in files act.

    ``ALTERNATIVES`` are two groups of fields, two ways to describe the same noise.
    """

    ALTERNATIVES: ClassVar[tuple[tuple[str, ...], tuple[str, ...]]]

    def changed(self, **options: object) -> Self:
        """This model with some fields replaced; options that are None are not given.

        The two groups of ``ALTERNATIVES`` replace each other: where only fields of one group are given, the other group
        becomes zero. So ``sigma_v`` or ``sigma_omega`` alone replace the book's nn, no, on and oo, and ``range_std``
        alone replaces ``range_rate``. Where fields of both groups are given, both describe the noise together.

        Raises:
            OptionError: a noise parameter has an impossible value, or there is no such field.
        """
        given = {name: value for name, value in options.items() if value is not None}
        known = [f.name for f in fields(self)]  # type: ignore[arg-type]  # every subclass is a dataclass
        for name in given:
            if name not in known:
                raise OptionError(f"{type(self).__name__} has no {quoted(name)}; its fields are {', '.join(known)}")
        zero = {}
        for group, other in (self.ALTERNATIVES, self.ALTERNATIVES[::-1]):
            if not given.keys().isdisjoint(group) and given.keys().isdisjoint(other):
                zero = dict.fromkeys(other, 0.0)
        return replace(self, **zero, **given)  # type: ignore[type-var]


_REPLACES_MOTION = "If none of nn, no, on, oo is given, these become 0"


@dataclass(frozen=True, kw_only=True)
class MotionModel(NoiseModel):
    """A robot that moves on arcs: control u = (nu, omega) [m/s, rad/s] held for dt seconds.

    The noise of the control is Gaussian. ``nn``, ``no``, ``on`` and ``oo`` describe noise that grows with the motion, as
    standard deviations per square root of the metre or radian. ``sigma_v`` and ``sigma_omega`` are standard deviations
    that every recorded control has, whatever its size and duration; `constant` has only these. Errors of different
    controls are independent, so with ``sigma_v`` and ``sigma_omega`` k controls of dt seconds have a variance of
    k (sigma dt)²: these two values belong to the rate at which controls are recorded. (The other four do not depend on
    it.) Where a sighting cuts a control, its pieces share the variance: a piece of d seconds of a control of D seconds
    has the variance sigma² D / d, so that the displacements of all pieces together have (sigma D)², however many there are.
    ``slip`` moves the robot sideways, across the chord of a control, with the variance slip² |nu| dt: S = slip² |nu| dt n n'.
    ``epsilon`` is added to the diagonal of the pose covariance, because A M A' has only rank 2.

    Raises:
        OptionError: a noise parameter is negative, or epsilon is not positive.
    """

    ALTERNATIVES = (("nn", "no", "on", "oo"), ("sigma_v", "sigma_omega"))

    nn: float = option(0.19, "Noise of the speed per distance driven", "m/√m")
    no: float = option(0.001, "Noise of the speed per angle turned", "m/√rad")
    on: float = option(0.13, "Noise of the turn rate per distance driven", "rad/√m")
    oo: float = option(0.2, "Noise of the turn rate per angle turned", "rad/√rad")
    epsilon: float = option(1e-4, "Variance added to the pose after each motion", "m², rad²")
    sigma_v: float = option(
        0.0, "Standard deviation of the speed, the same for every recorded control. " + _REPLACES_MOTION, "m/s"
    )
    sigma_omega: float = option(
        0.0, "Standard deviation of the turn rate, the same for every recorded control. " + _REPLACES_MOTION, "rad/s"
    )
    slip: float = option(0.0, "Noise sideways per distance driven, of a robot that slips", "m/√m")

    def __post_init__(self) -> None:
        check_positive(epsilon=self.epsilon)
        # each of the others may be zero: no noise of this kind
        check_real(**vars(self))
        check_positive(**{name: value for name, value in vars(self).items() if value != 0})

    @classmethod
    def constant(cls, sigma_v: float, sigma_omega: float, *, epsilon: float = 1e-4) -> MotionModel:
        """The model with noise of one size, M = diag(sigma_v², sigma_omega²) [m/s, rad/s]: nn = no = on = oo = 0."""
        return cls(nn=0.0, no=0.0, on=0.0, oo=0.0, epsilon=epsilon, sigma_v=sigma_v, sigma_omega=sigma_omega)

    def f(self, pose: ArrayLike, control: ArrayLike, dt: ArrayLike) -> Array:
        """The pose after the motion, f(x, u): the arc of length nu dt turning by omega dt; (..., 3).

        With a = omega dt / 2 it is (x + nu dt sinc(a) cos(theta + a), y + nu dt sinc(a) sin(theta + a), theta + 2a):
        the textbook's (nu/omega)(sin(theta + omega dt) - sin theta) without its division, hence exact at omega = 0 and
        without cancellation near it. The heading is not wrapped, so that a trajectory can count its turns.
        """
        pose, control, dt = _broadcast(pose, control, dt)
        x, y, turn = _arc(pose[..., 2], control, dt)
        return np.stack([pose[..., 0] + x, pose[..., 1] + y, pose[..., 2] + turn], axis=-1)

    def F(self, pose: ArrayLike, control: ArrayLike, dt: ArrayLike) -> Array:
        """The derivative df/dx of the motion by the pose it starts from; (..., 3, 3)."""
        pose, control, dt = _broadcast(pose, control, dt)
        x, y, _ = _arc(pose[..., 2], control, dt)
        jacobian = np.broadcast_to(np.eye(3), (*x.shape, 3, 3)).copy()
        jacobian[..., 0, 2], jacobian[..., 1, 2] = -y, x
        return jacobian

    def A(self, pose: ArrayLike, control: ArrayLike, dt: ArrayLike) -> Array:
        """The derivative df/du of the motion by the control; (..., 3, 2)."""
        pose, control, dt = _broadcast(pose, control, dt)
        a = control[..., 1] * dt / 2
        c, s, ratio = np.cos(pose[..., 2] + a), np.sin(pose[..., 2] + a), sinc(a)
        by_nu = dt * ratio
        # d/d omega = dt/2 d/da of nu dt sinc(a) e^(i (theta + a))
        half = control[..., 0] * dt * dt / 2
        along, across = half * sinc_derivative(a), half * ratio
        jacobian = np.zeros((*c.shape, 3, 2))
        jacobian[..., 0, 0], jacobian[..., 0, 1] = by_nu * c, along * c - across * s
        jacobian[..., 1, 0], jacobian[..., 1, 1] = by_nu * s, along * s + across * c
        jacobian[..., 2, 1] = dt
        return jacobian

    def M(self, control: ArrayLike, dt: ArrayLike, recorded_dt: ArrayLike | None = None) -> Array:
        """The covariance of the control noise; (..., 2, 2).

        diag(nn² |nu|/dt + no² |omega|/dt + sigma_v² D/dt, on² |nu|/dt + oo² |omega|/dt + sigma_omega² D/dt), where D is
        ``recorded_dt``, the duration of the recorded control of which this one is a piece; default: dt, a whole control.
        """
        control, dt = np.asarray(control, dtype=float), np.asarray(dt, dtype=float)
        pieces = 1.0 if recorded_dt is None else np.asarray(recorded_dt, dtype=float) / dt
        nu, omega = np.abs(control[..., 0]), np.abs(control[..., 1])
        covariance = np.zeros((*np.broadcast_shapes(nu.shape, dt.shape), 2, 2))
        covariance[..., 0, 0] = (self.nn**2 * nu + self.no**2 * omega) / dt + self.sigma_v**2 * pieces
        covariance[..., 1, 1] = (self.on**2 * nu + self.oo**2 * omega) / dt + self.sigma_omega**2 * pieces
        return covariance

    def sideways(self, pose: ArrayLike, control: ArrayLike, dt: ArrayLike, variance: ArrayLike = 0.0) -> Array:
        """The covariance of the slip of a control, S = (slip² |nu| dt + V dt²) n n', n across its chord; (..., 3, 3).

        V is an additional ``variance`` of the speed sideways, (...) [m²/s²].
        """
        pose, control, dt = _broadcast(pose, control, dt)
        across = pose[..., 2] + control[..., 1] * dt / 2 + np.pi / 2
        n = np.stack([np.cos(across), np.sin(across), np.zeros_like(across)], axis=-1)
        return self._sideways(control, dt, variance)[..., None, None] * n[..., :, None] * n[..., None, :]

    def _sideways(self, control: Array, dt: Array, variance: ArrayLike) -> Array:
        """slip² |nu| dt + V dt², the variance of the way across the chord of a control."""
        return self.slip**2 * np.abs(control[..., 0]) * dt + np.asarray(variance) * dt**2

    def covariance(self, pose: ArrayLike, control: ArrayLike, dt: ArrayLike) -> Array:
        """The covariance of the pose after one motion from a known pose, A M A' + S + epsilon I; (..., 3, 3)."""
        A = self.A(pose, control, dt)
        noise = A @ self.M(control, dt) @ np.swapaxes(A, -1, -2)
        if self.slip:
            noise += self.sideways(pose, control, dt)
        return noise + self.epsilon * np.eye(3)

    def moved(self, control: Array, dt: float) -> tuple[Array, Array]:
        """`accumulate` for one control (2,), in the engine: where it leads (3,), and the covariance of that (3, 3)."""
        noise = (self.nn, self.no, self.on, self.oo, self.epsilon, self.sigma_v, self.sigma_omega, self.slip)
        return engine.moved(noise, control[0], control[1], dt)

    def accumulate(
        self, controls: ArrayLike, dt: ArrayLike, starts: np.ndarray, control_variances: ArrayLike | None = None,
        recorded_dt: ArrayLike | None = None,
    ) -> tuple[Array, Array]:  # fmt: skip
        """Motions that consist of several controls each: relative poses and their covariances.

        The controls ``starts[t]`` to ``starts[t+1]`` - 1 follow one another in motion t. The motion from (0, 0, 0) ends
        at f(... f(f(0, u_1), u_2) ..., u_k). Its covariance is propagated by P <- F P F' + A M A' + S from P = 0, and epsilon
        I is added once. (The product of all later F is one lever arm, so the propagation is a plain sum.)

        Args:
            controls: (S, 2) [m/s, rad/s].
            dt: (S,) [s].
            starts: (T+1,), increasing, from 0 to S.
            control_variances: (S, 3) additional variances of single controls: of the speed and of the turn rate, added to M,
                and of the speed sideways, for S [m²/s², rad²/s², m²/s²]; (S, 2) without the last; or None.
            recorded_dt: (S,) the duration of the recorded control that each control is a piece of [s], as for `M`; or None.

        Returns:
            The motions (T, 3), headings not wrapped, and their covariances (T, 3, 3), in the frame of each motion's start.
        """
        controls, dt = np.asarray(controls, dtype=float), np.asarray(dt, dtype=float)
        M, variances = self.M(controls, dt, recorded_dt), additional_variances(control_variances, len(controls))
        variances[:, 2] = self._sideways(controls, dt, variances[:, 2])
        variances[:, :2] += np.einsum("sii->si", M)
        motions, covariances = engine.accumulate(controls, dt, starts, variances)
        return motions, covariances + self.epsilon * np.eye(3)

    def dead_reckoning(self, start: ArrayLike, controls: ArrayLike, dt: ArrayLike) -> Array:
        """The poses x_t = f(x_{t-1}, u_t) from a start (3,), noise-free; controls (T, 2), dt (T,) -> (T+1, 3)."""
        start, controls = np.asarray(start, dtype=float), np.asarray(controls, dtype=float)
        dt = np.broadcast_to(np.asarray(dt, dtype=float), controls.shape[:1])
        poses = np.zeros((len(controls) + 1, 3))
        poses[1:, 2] = np.cumsum(controls[:, 1] * dt)
        poses[:, 2] += start[2]
        # f is affine in (x, y), so the sum of all steps can be taken at once
        x, y, _ = _arc(poses[:-1, 2], controls, dt)
        poses[1:, 0], poses[1:, 1] = np.cumsum(x), np.cumsum(y)
        poses[:, :2] += start[:2]
        return poses


def additional_variances(control_variances: ArrayLike | None, count: int) -> Array:
    """The variances (S, 3) of `MotionModel.accumulate`; 0 where none are given."""
    variances = np.zeros((count, 3))
    if control_variances is not None:
        given = np.asarray(control_variances, dtype=float)
        variances[:, : given.shape[1]] = given
    return variances


def _arc(heading: Array, control: Array, dt: Array) -> tuple[Array, Array, Array]:
    """The motion in x, in y and in the heading that a control causes at this heading; each (...)."""
    a = control[..., 1] * dt / 2
    chord, along = control[..., 0] * dt * sinc(a), heading + a
    return chord * np.cos(along), chord * np.sin(along), 2 * a


def _broadcast(pose: ArrayLike, control: ArrayLike, dt: ArrayLike) -> tuple[Array, Array, Array]:
    pose, control, dt = (np.asarray(v, dtype=float) for v in (pose, control, dt))
    shape = np.broadcast_shapes(pose.shape[:-1], control.shape[:-1], dt.shape)
    return np.broadcast_to(pose, (*shape, 3)), np.broadcast_to(control, (*shape, 2)), np.broadcast_to(dt, shape)


#: kinds of graph of a log, how its virtual-motion edges are weighed, and the axes of residuals and their information
EDGES, WEIGHTS = ("virtual", "virtual+motion", "landmark+motion"), ("pairs", "tempered", "marginal")
FRAMES = ("world", "body")
#: how a sighting of a landmark node is compared: as a position in the robot's axes, or as range and bearing
RESIDUALS = ("cartesian", "polar")
#: the range at which its noise is taken: as measured, or as predicted by the estimate
RANGE_NOISES = ("auto", "measured", "estimated")


@dataclass(frozen=True, kw_only=True)
class EdgeOptions:
    """How the edges of a graph come from a log; `Graph.from_log` has the options. Impossible values raise `OptionError`."""

    edges: str | None = option(None, "Edges of the graph.", choices=EDGES, default_text="what suits the log")
    frame: str = option("body", "Axes of the residuals.", choices=FRAMES)
    weight: str = option(
        "pairs", "Weight of virtual-motion edges: pairs as in the book; tempered and marginal count each sighting once.",
        choices=WEIGHTS,
    )  # fmt: skip
    motion_weight: float = option(1.0, "Factor lambda on the motion edges.", positive=True)
    residual: str = option(
        RESIDUALS[0], "Residual of landmark nodes: the sighting as a position in the robot's axes, or as range and bearing.",
        choices=RESIDUALS,
    )  # fmt: skip

    def __post_init__(self) -> None:
        check_options(self)

    @property
    def landmark_nodes(self) -> bool:
        """Whether landmarks are nodes."""
        return self.edges == "landmark+motion"

    @property
    def with_motion(self) -> bool:
        """Whether there are motion edges."""
        return self.edges is not None and self.edges.endswith("+motion")

    @property
    def without_effect(self) -> list[str]:
        """One sentence for each option that is not the default and has no effect on these edges."""
        lacking, reasons = f"with edges={self.edges!r}", {}
        if self.landmark_nodes:
            reasons["weight"] = "with landmark nodes each sighting counts once"
        else:
            reasons["residual"] = f"there are no landmark nodes {lacking}"
        if not self.with_motion:
            reasons["motion_weight"] = f"there are no motion edges {lacking}"
        return [
            f"{name}={getattr(self, name)!r} has no effect: {reason}"
            for name, reason in reasons.items()
            if getattr(self, name) != getattr(EdgeOptions, name)
        ]

    def weighed(self, factors: Iterable[float]) -> list[Self]:
        """These options with each of the factors lambda on the motion edges; themselves alone where there are none."""
        return [replace(self, motion_weight=each) for each in factors] if self.with_motion else [self]


@dataclass(frozen=True, kw_only=True)
class SensorModel(NoiseModel):
    """A sensor that measures range l [m], bearing phi [rad] and perhaps orientation psi [rad] of identified landmarks.

    psi is the direction from which the landmark is seen: psi = theta + phi - (the landmark's own heading). The noise is
    Gaussian. The variance of the range is (``range_rate`` * l)² + ``range_std``²; the standard deviations of the angles
    are ``bearing_std`` and ``orientation_std``. The sensor is at s(x) = p + R(theta) o, where o = ``offset`` = (ahead,
    left) [m] of the robot's pose; a single number is the distance ahead. It sees landmarks at ranges from ``min_range`` to
    ``max_range`` and bearings of at most half the ``field_of_view``; the simulator and FastSLAM with unknown association use
    these limits.

    Raises:
        OptionError: a noise parameter is not positive (one of the two of the range may be zero), the offset is not finite,
            or the limits are impossible.
    """

    #: the standard deviations: of the range, by its length and constant, of the bearing and of the orientation
    NOISE: ClassVar[tuple[str, ...]] = ("range_rate", "range_std", "bearing_std", "orientation_std")
    #: the fields that are no noise
    GEOMETRY: ClassVar[tuple[str, ...]] = ("offset", "min_range", "max_range", "field_of_view")

    ALTERNATIVES = (("range_rate",), ("range_std",))

    range_rate: float = option(0.14, "Noise of the range per metre of range", "m/m")
    bearing_std: float = option(0.05, "Noise of the bearing", "rad")
    orientation_std: float = option(0.05, "Noise of the orientation psi", "rad")
    range_std: float = option(
        0.0, "Standard deviation of the range, the same at every range. If range_rate is not given, it becomes 0", "m"
    )
    offset: tuple[float, float] = option((0.0, 0.0), "Position of the sensor on the robot: forward, left", "m")
    min_range: float = option(0.0, "Least range at which the sensor sees landmarks", "m")
    max_range: float = option(inf, "Greatest range at which the sensor sees landmarks", "m")
    field_of_view: float = option(2 * pi, "Whole angle in which the sensor sees landmarks, ahead in its middle", "rad")

    def __post_init__(self) -> None:
        check_real(**{name: value for name, value in vars(self).items() if name != "offset"})
        check_positive(bearing_std=self.bearing_std, orientation_std=self.orientation_std)
        # one of the two parts of the range noise may be zero, but not both
        if self.range_std == 0 or self.range_rate != 0:
            check_positive(range_rate=self.range_rate)
        if self.range_std != 0:
            check_positive(range_std=self.range_std)
        object.__setattr__(self, "offset", checked_offset("offset", self.offset))
        if not 0 <= self.min_range < self.max_range:
            message = f"min_range must lie between 0 and max_range ({self.max_range:g} m), not {quoted(self.min_range)}"
            raise OptionError(message)
        if not 0 < self.field_of_view <= 2 * pi:
            raise OptionError(f"field_of_view must be positive and at most 2 pi, not {quoted(self.field_of_view)}")

    @classmethod
    def constant(cls, range_std: float, bearing_std: float, *, offset: tuple[float, float] = (0.0, 0.0)) -> SensorModel:
        """The range-bearing sensor whose noise does not depend on the range [m, rad]: range_rate = 0."""
        return cls(range_rate=0.0, range_std=range_std, bearing_std=bearing_std, offset=offset)

    @classmethod
    def of_variances(cls, *variances: float | None) -> SensorModel:
        """The sensor with the variances of `for_engine`, in their order; the book's where one is None or left out."""
        deviations: dict[str, Any] = {name: float(v**0.5) for name, v in zip(cls.NOISE, variances) if v is not None}
        return cls(**deviations)

    @property
    def limits(self) -> tuple[float, float, float]:
        """The limits of sight: least range, greatest range, whole angle."""
        return self.min_range, self.max_range, self.field_of_view

    def with_limits(self, least: float, most: float, view: float) -> SensorModel:
        """The same sensor with these `limits` of sight."""
        return replace(self, min_range=least, max_range=most, field_of_view=view)

    @property
    def of_book(self) -> bool:
        """Whether the noise is that of the lectures, whatever the place and the limits of the sensor are."""
        book = SensorModel()
        return all(value == getattr(book, name) for name, value in vars(self).items() if name not in self.GEOMETRY)

    @property
    def centred(self) -> bool:
        """Whether the sensor is at the robot's pose."""
        return self.offset == (0.0, 0.0)

    def mount(self, pose: ArrayLike) -> Array:
        """The pose of the sensor on a robot at a pose, (p + R(theta) o, theta); (..., 3)."""
        return mounted(pose, self.offset)

    def sees(self, pose: ArrayLike, landmark: ArrayLike) -> np.ndarray:
        """Whether landmarks (..., 2 or 3) are within the sensor's limits on a robot at a pose (..., 3); (...) bool."""
        r, bearing = np.moveaxis(self.h(pose, np.asarray(landmark, dtype=float)[..., :2]), -1, 0)
        return (r >= self.min_range) & (r <= self.max_range) & (np.abs(bearing) <= self.field_of_view / 2)

    def h(self, pose: ArrayLike, landmark: ArrayLike) -> Array:
        """The sighting of a landmark (..., 2 or 3) from a pose (..., 3), noise-free: (l, phi) or (l, phi, psi)."""
        pose, landmark = self.mount(pose), np.asarray(landmark, dtype=float)
        d = landmark[..., :2] - pose[..., :2]
        direction = np.arctan2(d[..., 1], d[..., 0])
        sighting = [np.hypot(d[..., 0], d[..., 1]), wrap(direction - pose[..., 2])]
        if landmark.shape[-1] == 3:
            sighting.append(wrap(direction - landmark[..., 2]))
        return stacked(*np.broadcast_arrays(*sighting))

    def h_inverse(self, pose: ArrayLike, sighting: ArrayLike) -> Array:
        """The landmark that a sighting implies, h^-1(x, z) = (x + l cos, y + l sin, theta + phi - psi).

        x and y are the sensor's; cos and sin are of theta + phi. (..., 2) without psi, (..., 3) with it; the heading is
        wrapped.
        """
        pose, sighting = self.mount(pose), np.asarray(sighting, dtype=float)
        length, direction = sighting[..., 0], pose[..., 2] + sighting[..., 1]
        landmark = [pose[..., 0] + length * np.cos(direction), pose[..., 1] + length * np.sin(direction)]
        if sighting.shape[-1] == 3:
            landmark.append(wrap(direction - sighting[..., 2]))
        return stacked(*landmark)

    def H(self, pose: ArrayLike, landmark: ArrayLike) -> Array:
        """The derivative dh/dm of the sighting by the landmark; (..., 2, 2) or (..., 3, 3)."""
        pose, landmark = self.mount(pose), np.asarray(landmark, dtype=float)
        n = landmark.shape[-1]
        d = landmark[..., :2] - pose[..., :2]
        q = d[..., 0] ** 2 + d[..., 1] ** 2
        r = np.sqrt(q)
        jacobian = np.zeros((*r.shape, n, n))
        jacobian[..., 0, :2] = d / r[..., None]
        jacobian[..., 1, 0], jacobian[..., 1, 1] = -d[..., 1] / q, d[..., 0] / q
        if n == 3:
            jacobian[..., 2, :2] = jacobian[..., 1, :2]
            jacobian[..., 2, 2] = -1.0
        return jacobian

    def H_pose(self, pose: ArrayLike, landmark: ArrayLike) -> Array:
        """The derivative dh/dx of the sighting by the pose; (..., 2, 3) or (..., 3, 3)."""
        pose = np.asarray(pose, dtype=float)
        by_landmark = self.H(pose, landmark)
        # only the difference of the two positions counts
        jacobian = np.zeros((*by_landmark.shape[:-1], 3))
        jacobian[..., :2] = -by_landmark[..., :2]
        jacobian[..., 1, 2] = -1.0
        if not self.centred:
            # a turn of the robot also moves a sensor that is off its centre
            arm = self.mount(pose)[..., :2] - pose[..., :2]
            jacobian[..., 2] += jacobian[..., 1] * arm[..., 0, None] - jacobian[..., 0] * arm[..., 1, None]
        return jacobian

    def R(self, pose: ArrayLike, sighting: ArrayLike) -> Array:
        """dh^-1/dz = [[c, -l s, 0], [s, l c, 0], [0, 1, -1]], c, s of theta + phi (2 x 2 without psi)."""
        pose, sighting = np.asarray(pose, dtype=float), np.asarray(sighting, dtype=float)
        n = sighting.shape[-1]
        length, direction = sighting[..., 0], pose[..., 2] + sighting[..., 1]
        c, s = np.cos(direction), np.sin(direction)
        jacobian = np.zeros((*c.shape, n, n))
        jacobian[..., 0, 0], jacobian[..., 0, 1] = c, -length * s
        jacobian[..., 1, 0], jacobian[..., 1, 1] = s, length * c
        if n == 3:
            jacobian[..., 2, 1], jacobian[..., 2, 2] = 1.0, -1.0
        return jacobian

    def Q(self, sighting: ArrayLike) -> Array:
        """The covariance of a sighting, diag((l range_rate)² + range_std², bearing_std², orientation_std²); (..., n, n)."""
        sighting = np.asarray(sighting, dtype=float)
        n = sighting.shape[-1]
        covariance = np.zeros((*sighting.shape, n))
        covariance[..., 0, 0] = (sighting[..., 0] * self.range_rate) ** 2 + self.range_std**2
        covariance[..., 1, 1] = self.bearing_std**2
        if n == 3:
            covariance[..., 2, 2] = self.orientation_std**2
        return covariance

    def places(
        self, sightings: ArrayLike, poses: ArrayLike | None = None, noisy: ArrayLike | None = None
    ) -> tuple[Array, Array]:
        """The landmarks of sightings z (..., n) with their covariances: h^-1(x, z) (..., n) and R Q R' (..., n, n).

        Args:
            poses: x (..., 3); default: the origin, so that landmarks are in the robot's axes, and z (M, n).
            noisy: the sightings (..., n) at which R and Q are evaluated; default: z.
        """
        z = np.asarray(sightings, dtype=float)
        at = z if noisy is None else np.asarray(noisy, dtype=float)
        if poses is None:
            return engine.places(self.for_engine, z, at)
        return self.h_inverse(poses, z), self.landmark_covariance(poses, at)

    @property
    def for_engine(self) -> tuple[float, ...]:
        """The variances of the range (by l², and constant), of phi and psi, and the place of the sensor on the robot."""
        return self.range_rate**2, self.range_std**2, self.bearing_std**2, self.orientation_std**2, *self.offset

    def landmark_covariance(self, pose: ArrayLike, sighting: ArrayLike) -> Array:
        """The covariance of h^-1(x, z) for a known pose, R Q R'; (..., n, n)."""
        R = self.R(pose, sighting)
        return R @ self.Q(sighting) @ np.swapaxes(R, -1, -2)


def plausible_ranges(predicted: Array, measured: Array) -> Array:
    """The ranges (M,) at which the noise of sightings is evaluated: those predicted, within `PLAUSIBLE` of those measured."""
    return np.clip(predicted, *(np.abs(measured) * factor for factor in PLAUSIBLE))
