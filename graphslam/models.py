"""The velocity motion model and the range-bearing(-orientation) sensor, with their derivatives, vectorised.

The method names are those of the equations: f, F, A, M for the motion and h, h^-1, H, R, Q for the sensor. Every
method takes arrays of any matching leading shape: poses (..., 3), controls (..., 2), sightings (..., 2 or 3).

Sources: Thrun, Burgard and Fox, Probabilistic Robotics, sections 5.3 and 6.6; Ueda, *LNPR* (the lectures' book),
chapters 5 to 9.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from .checks import check_positive
from .errors import OptionError
from .se2 import Array, transform, wrap


def sinc(a: ArrayLike) -> Array:
    """sin(a) / a, equal to 1 at a = 0."""
    return np.sinc(np.asarray(a, dtype=float) / np.pi)


def sinc_derivative(a: ArrayLike) -> Array:
    """d/da (sin(a) / a) = (cos(a) - sin(a)/a) / a, by its Taylor series where that difference would cancel."""
    a = np.asarray(a, dtype=float)
    q = a * a
    # sum over k of (-1)^k 2k / (2k+1)! a^(2k-1): six terms are exact to rounding for |a| < 0.3
    series = a * (-1 / 3 + q * (1 / 30 + q * (-1 / 840 + q * (1 / 45360 + q * (-1 / 3991680 + q / 518918400)))))
    away = np.where(np.abs(a) < 0.3, 1.0, a)
    return np.where(np.abs(a) < 0.3, series, (np.cos(away) - np.sin(away) / away) / away)


@dataclass(frozen=True)
class MotionModel:
    """A robot that moves on arcs: control u = (nu, omega) [m/s, rad/s] held for dt seconds.

    The noise of the control is Gaussian; ``nn`` says how much noise in nu comes per metre of forward motion, ``no`` in
    nu per radian turned, ``on`` in omega per metre and ``oo`` in omega per radian (standard deviations per square
    root of the metre or radian). ``sigma_v`` [m/s] and ``sigma_omega`` [rad/s] are standard deviations that every
    control has, moving or not, whatever its size and duration; `constant` has only these. The errors of controls are
    independent of each other, so with ``sigma_v`` and ``sigma_omega`` k controls of dt seconds make a variance of k
    (sigma dt)²: they belong to the rate at which controls are recorded. (The other four do not depend on it.)
    ``epsilon`` [m², rad²] is added to the diagonal of the pose covariance, because A M A' has only rank 2.

    Raises:
        OptionError: a noise parameter is negative, or epsilon is not positive.
    """

    nn: float = 0.19
    no: float = 0.001
    on: float = 0.13
    oo: float = 0.2
    epsilon: float = 1e-4
    sigma_v: float = 0.0
    sigma_omega: float = 0.0

    def __post_init__(self) -> None:
        # zero is an honest value for each of the six (no such noise), not for epsilon
        check_positive(epsilon=self.epsilon)
        for option in ("nn", "no", "on", "oo", "sigma_v", "sigma_omega"):
            if getattr(self, option) != 0:
                check_positive(**{option: getattr(self, option)})

    @classmethod
    def constant(cls, sigma_v: float, sigma_omega: float, *, epsilon: float = 1e-4) -> MotionModel:
        """The model with noise of one size, M = diag(sigma_v², sigma_omega²) [m/s, rad/s]: nn = no = on = oo = 0."""
        return cls(0.0, 0.0, 0.0, 0.0, epsilon, sigma_v, sigma_omega)

    def changed(self, **numbers: float) -> MotionModel:
        """The model with other numbers; ``sigma_v`` and ``sigma_omega`` alone replace the book's four, and vice versa."""
        book, timed = ("nn", "no", "on", "oo"), ("sigma_v", "sigma_omega")
        if any(name in numbers for name in timed) and not any(name in numbers for name in book):
            numbers |= dict.fromkeys(book, 0.0)
        elif any(name in numbers for name in book) and not any(name in numbers for name in timed):
            numbers |= dict.fromkeys(timed, 0.0)
        return replace(self, **numbers)

    def f(self, pose: ArrayLike, control: ArrayLike, dt: ArrayLike) -> Array:
        """The pose after the motion, f(x, u): the arc of length nu dt turning by omega dt; (..., 3).

        With a = omega dt / 2 it is (x + nu dt sinc(a) cos(theta + a), y + nu dt sinc(a) sin(theta + a), theta + 2a):
        the textbook's (nu/omega)(sin(theta + omega dt) - sin theta) without its division, hence exact at omega = 0 and
        without cancellation near it. The heading is not wrapped, so that a trajectory can count its turns.
        """
        pose, control, dt = _broadcast(pose, control, dt)
        forward, a = control[..., 0] * dt, control[..., 1] * dt / 2
        chord, heading = forward * sinc(a), pose[..., 2] + a
        return np.stack(
            [pose[..., 0] + chord * np.cos(heading), pose[..., 1] + chord * np.sin(heading), pose[..., 2] + 2 * a],
            axis=-1,
        )

    def F(self, pose: ArrayLike, control: ArrayLike, dt: ArrayLike) -> Array:
        """The derivative df/dx of the motion by the pose it starts from; (..., 3, 3)."""
        pose, control, dt = _broadcast(pose, control, dt)
        a = control[..., 1] * dt / 2
        chord, heading = control[..., 0] * dt * sinc(a), pose[..., 2] + a
        jacobian = np.broadcast_to(np.eye(3), (*heading.shape, 3, 3)).copy()
        jacobian[..., 0, 2] = -chord * np.sin(heading)
        jacobian[..., 1, 2] = chord * np.cos(heading)
        return jacobian

    def A(self, pose: ArrayLike, control: ArrayLike, dt: ArrayLike) -> Array:
        """The derivative df/du of the motion by the control; (..., 3, 2)."""
        pose, control, dt = _broadcast(pose, control, dt)
        a = control[..., 1] * dt / 2
        c, s = np.cos(pose[..., 2] + a), np.sin(pose[..., 2] + a)
        by_nu = dt * sinc(a)
        # d/d omega = dt/2 d/da of nu dt sinc(a) e^(i (theta + a))
        half = control[..., 0] * dt * dt / 2
        along, across = half * sinc_derivative(a), half * sinc(a)
        jacobian = np.zeros((*c.shape, 3, 2))
        jacobian[..., 0, 0], jacobian[..., 0, 1] = by_nu * c, along * c - across * s
        jacobian[..., 1, 0], jacobian[..., 1, 1] = by_nu * s, along * s + across * c
        jacobian[..., 2, 1] = dt
        return jacobian

    def M(self, control: ArrayLike, dt: ArrayLike) -> Array:
        """The covariance of the control noise; (..., 2, 2).

        diag(nn² |nu|/dt + no² |omega|/dt + sigma_v², on² |nu|/dt + oo² |omega|/dt + sigma_omega²).
        """
        control, dt = np.asarray(control, dtype=float), np.asarray(dt, dtype=float)
        nu, omega = np.abs(control[..., 0]), np.abs(control[..., 1])
        covariance = np.zeros((*np.broadcast_shapes(nu.shape, dt.shape), 2, 2))
        covariance[..., 0, 0] = (self.nn**2 * nu + self.no**2 * omega) / dt + self.sigma_v**2
        covariance[..., 1, 1] = (self.on**2 * nu + self.oo**2 * omega) / dt + self.sigma_omega**2
        return covariance

    def covariance(self, pose: ArrayLike, control: ArrayLike, dt: ArrayLike) -> Array:
        """The covariance of the pose after one motion from a known pose, A M A' + epsilon I; (..., 3, 3)."""
        A = self.A(pose, control, dt)
        return A @ self.M(control, dt) @ np.swapaxes(A, -1, -2) + self.epsilon * np.eye(3)

    def accumulate(
        self, controls: ArrayLike, dt: ArrayLike, starts: np.ndarray, control_variances: ArrayLike | None = None
    ) -> tuple[Array, Array]:
        """Motions that are made of several controls each: where they lead from (0, 0, 0), and how surely.

        The controls ``starts[t]`` to ``starts[t+1]`` - 1 follow one another in motion t. It leads to f(... f(f(0,
        u_1), u_2) ..., u_k), and its covariance is propagated, P <- F P F' + A M A' from P = 0, to which epsilon I is
        added once. (The product of all later F is one lever arm, so the propagation is a plain sum.)

        Args:
            controls: (S, 2) [m/s, rad/s].
            dt: (S,) [s].
            starts: (T+1,), increasing, from 0 to S.
            control_variances: (S, 2) more noise of single controls [m²/s², rad²/s²], added to M; None for none.

        Returns:
            The motions (T, 3), turns not wrapped, and their covariances (T, 3, 3), in the frame that each starts from.
        """
        controls, dt = np.asarray(controls, dtype=float), np.asarray(dt, dtype=float)
        first, count = starts[:-1], np.diff(starts)
        before = np.zeros((len(controls), 3))
        before[:, 2] = _sum_before(controls[:, 1] * dt, first, count)
        # with the heading it has within its motion, each control starts from the origin: f is affine in (x, y)
        steps = self.f(before, controls, dt) - before
        motions = np.add.reduceat(steps, first, axis=0) if len(first) else np.zeros((0, 3))
        A, M = self.A(before, controls, dt), self.M(controls, dt)
        if control_variances is not None:
            M[:, [0, 1], [0, 1]] += control_variances
        left = np.repeat(motions[:, :2], count, axis=0) - steps[:, :2]
        left -= np.column_stack([_sum_before(steps[:, k], first, count) for k in (0, 1)])
        # rounding must not make the last control of a motion, which nothing follows, see a lever
        left[starts[1:] - 1] = 0.0
        A[:, 0, :] -= left[:, 1, None] * A[:, 2, :]
        A[:, 1, :] += left[:, 0, None] * A[:, 2, :]
        each = A @ M @ np.swapaxes(A, -1, -2)
        covariances = np.add.reduceat(each, first, axis=0) if len(first) else np.zeros((0, 3, 3))
        return motions, covariances + self.epsilon * np.eye(3)

    def dead_reckoning(self, start: ArrayLike, controls: ArrayLike, dt: ArrayLike) -> Array:
        """The poses x_t = f(x_{t-1}, u_t) from a start (3,), noise-free; controls (T, 2), dt (T,) -> (T+1, 3)."""
        start, controls = np.asarray(start, dtype=float), np.asarray(controls, dtype=float)
        dt = np.broadcast_to(np.asarray(dt, dtype=float), controls.shape[:1])
        heading = start[2] + np.concatenate([[0.0], np.cumsum(controls[:, 1] * dt)])
        # each step rotated by the heading before it: f is affine in (x, y), so the sum can be taken at once
        at_origin = np.zeros((len(controls), 3))
        at_origin[:, 2] = heading[:-1]
        steps = self.f(at_origin, controls, dt)[:, :2]
        position = start[:2] + np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
        return np.column_stack([position, heading])


def _sum_before(values: Array, first: np.ndarray, count: np.ndarray) -> Array:
    """Of each value the sum of those before it in its group; groups begin at ``first`` and have ``count`` members."""
    total = np.concatenate([[0.0], np.cumsum(values)[:-1]]) if len(values) else values
    return total - np.repeat(total[first], count)


def _broadcast(pose: ArrayLike, control: ArrayLike, dt: ArrayLike) -> tuple[Array, Array, Array]:
    pose, control, dt = (np.asarray(v, dtype=float) for v in (pose, control, dt))
    shape = np.broadcast_shapes(pose.shape[:-1], control.shape[:-1], dt.shape)
    return np.broadcast_to(pose, (*shape, 3)), np.broadcast_to(control, (*shape, 2)), np.broadcast_to(dt, shape)


@dataclass(frozen=True)
class SensorModel:
    """A sensor that sees identified landmarks by range l [m], bearing phi [rad] and perhaps orientation psi [rad].

    psi tells which face of the landmark is seen: psi = theta + phi - (the landmark's own heading). Its noise is
    Gaussian; the variance of the range is (``range_rate`` * l)² + ``range_std``², and the standard deviations of the
    angles are ``bearing_std`` and ``orientation_std``. The sensor looks from s(x) = p + R(theta) o, where o =
    ``offset`` = (ahead, to the left) [m] of the robot's pose; one number is the first of the two.

    Raises:
        OptionError: a noise parameter is not positive (one of the two of the range may be zero), or the offset is not
            finite.
    """

    range_rate: float = 0.14
    bearing_std: float = 0.05
    orientation_std: float = 0.05
    range_std: float = 0.0
    offset: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        check_positive(bearing_std=self.bearing_std, orientation_std=self.orientation_std)
        # either part of the range's noise may be absent, not both
        if self.range_std == 0:
            check_positive(range_rate=self.range_rate)
        else:
            check_positive(range_std=self.range_std)
            if self.range_rate != 0:
                check_positive(range_rate=self.range_rate)
        try:
            offset = np.asarray(self.offset, dtype=float)
        except (TypeError, ValueError):
            offset = np.empty(0)
        if offset.ndim == 0:
            offset = np.array([float(offset), 0.0])
        if offset.shape != (2,) or not np.all(np.isfinite(offset)):
            raise OptionError(f"offset must be (ahead, to the left) in m, or one number ahead, not {self.offset!r}")
        object.__setattr__(self, "offset", (float(offset[0]), float(offset[1])))

    def changed(self, **numbers: float) -> SensorModel:
        """The model with other numbers; ``range_std`` alone replaces ``range_rate``, and vice versa."""
        if "range_std" in numbers:
            numbers.setdefault("range_rate", 0.0)
        elif "range_rate" in numbers:
            numbers["range_std"] = 0.0
        return replace(self, **numbers)

    @property
    def centred(self) -> bool:
        """Whether the sensor sits at the robot's pose."""
        return self.offset == (0.0, 0.0)

    def mount(self, pose: ArrayLike) -> Array:
        """The pose of the sensor on a robot at a pose, (p + R(theta) o, theta); (..., 3)."""
        pose = np.asarray(pose, dtype=float)
        if self.centred:
            return pose
        return np.concatenate([transform(pose, self.offset), pose[..., 2:]], axis=-1)

    def h(self, pose: ArrayLike, landmark: ArrayLike) -> Array:
        """The sighting of a landmark (..., 2 or 3) from a pose (..., 3), noise-free: (l, phi) or (l, phi, psi)."""
        pose, landmark = self.mount(pose), np.asarray(landmark, dtype=float)
        d = landmark[..., :2] - pose[..., :2]
        direction = np.arctan2(d[..., 1], d[..., 0])
        sighting = [np.hypot(d[..., 0], d[..., 1]), wrap(direction - pose[..., 2])]
        if landmark.shape[-1] == 3:
            sighting.append(wrap(direction - landmark[..., 2]))
        return np.stack(np.broadcast_arrays(*sighting), axis=-1)

    def h_inverse(self, pose: ArrayLike, sighting: ArrayLike) -> Array:
        """The landmark that a sighting puts there, h^-1(x, z) = (x + l cos, y + l sin, theta + phi - psi).

        x and y of the sensor, cos and sin of theta + phi; (..., 2) without psi, (..., 3) with it, the heading wrapped.
        """
        pose, sighting = self.mount(pose), np.asarray(sighting, dtype=float)
        direction = pose[..., 2] + sighting[..., 1]
        landmark = [
            pose[..., 0] + sighting[..., 0] * np.cos(direction),
            pose[..., 1] + sighting[..., 0] * np.sin(direction),
        ]
        if sighting.shape[-1] == 3:
            landmark.append(wrap(direction - sighting[..., 2]))
        return np.stack(landmark, axis=-1)

    def H(self, pose: ArrayLike, landmark: ArrayLike) -> Array:
        """The derivative dh/dm of the sighting by the landmark; (..., 2, 2) or (..., 3, 3)."""
        pose, landmark = self.mount(pose), np.asarray(landmark, dtype=float)
        n = landmark.shape[-1]
        d, q, r = _offset(pose, landmark)
        jacobian = np.zeros((*r.shape, n, n))
        jacobian[..., 0, :2] = d / r[..., None]
        jacobian[..., 1, 0], jacobian[..., 1, 1] = -d[..., 1] / q, d[..., 0] / q
        if n == 3:
            jacobian[..., 2, :2] = jacobian[..., 1, :2]
            jacobian[..., 2, 2] = -1.0
        return jacobian

    def H_pose(self, pose: ArrayLike, landmark: ArrayLike) -> Array:
        """The derivative dh/dx of the sighting by the pose; (..., 2, 3) or (..., 3, 3)."""
        pose, landmark = np.asarray(pose, dtype=float), np.asarray(landmark, dtype=float)
        n = landmark.shape[-1]
        sensor = self.mount(pose)
        d, q, r = _offset(sensor, landmark)
        jacobian = np.zeros((*r.shape, n, 3))
        jacobian[..., 0, :2] = -d / r[..., None]
        jacobian[..., 1, 0], jacobian[..., 1, 1], jacobian[..., 1, 2] = d[..., 1] / q, -d[..., 0] / q, -1.0
        if n == 3:
            jacobian[..., 2, :2] = jacobian[..., 1, :2]
        if not self.centred:
            # turning the robot moves the sensor across the arm that carries it
            arm = sensor[..., :2] - pose[..., :2]
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

    def landmark_covariance(self, pose: ArrayLike, sighting: ArrayLike) -> Array:
        """The covariance of h^-1(x, z) for a known pose, R Q R'; (..., n, n)."""
        R = self.R(pose, sighting)
        return R @ self.Q(sighting) @ np.swapaxes(R, -1, -2)


def _offset(pose: Array, landmark: Array) -> tuple[Array, Array, Array]:
    d = landmark[..., :2] - pose[..., :2]
    q = d[..., 0] ** 2 + d[..., 1] ** 2
    return d, q, np.sqrt(q)
