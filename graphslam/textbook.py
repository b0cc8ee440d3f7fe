"""The lectures' graph SLAM, equation by equation: dense Omega and xi, and plain loops.

It is the reference of the tests, and the place to read the method. `solve` repeats the book's program exactly, with two
properties that better solvers do not have: Omega_e is re-evaluated at every iteration, and the anchor enters Omega but not
xi, so that it is reset to the current x_0 at every step. Therefore the whole graph drifts by a small constant amount at
every step, and the program stops only because its threshold is coarse. Headings are not wrapped, so they count turns.

Source: the lectures on graph SLAM (LNPR chapter 9, slides 9.1 to 9.5).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from math import cos, pi, sin

import numpy as np

from .errors import GraphError, OptionError, checks, quoted
from .linear.precision import check_magnitudes
from .log import Log, check_is_log
from .models import MotionModel, SensorModel
from .se2 import Array

#: slides 9.1.1 and 9.2: information of the anchor; they take an infinite one, the book's program 1e6 I
OMEGA_0 = 1e6 * np.eye(3)
#: the step norms at which the book's two programs stop
THRESHOLDS = {"virtual": 0.01, "virtual+motion": 0.02}
#: where the threshold is the book's, the program stops if the steps became shorter by less than this part in so many steps
DRIFT, PATIENCE = 0.01, 10
#: Omega is singular to rounding where a Cholesky pivot is below this part of its diagonal entry
SINGULAR = 1e-12


@dataclass(frozen=True)
class TextbookSolution:
    """The result of `solve`.

    Attributes:
        poses: (T+1, 3), the headings not wrapped; poses that are not part of the graph keep their initial values.
        estimated: (T+1,), which poses are part of the graph.
        landmarks: {id: ...}, the map; see `solve_map`.
        step_norms: the norm of the whole correction in each iteration.
        costs: J before each iteration.
        iterations: the number of iterations.
        converged: whether the last step norm was below the threshold.
        num_edges: the number of virtual-motion edges.
        threshold: the step norm below which the program stops.
        reason: one sentence on why the program stopped.
    """

    poses: Array
    estimated: np.ndarray
    landmarks: dict[int, Array]
    step_norms: list[float]
    costs: list[float]
    iterations: int
    converged: bool
    num_edges: int
    threshold: float
    reason: str

    def __repr__(self) -> str:
        """One line: outcome and sizes."""
        outcome = "converged" if self.converged else "not converged"
        return f"<TextbookSolution: {outcome}, {self.reason}; {len(self.poses)} poses, {len(self.landmarks)} landmarks>"


def solve(
    log: Log,
    *,
    edges: str = "virtual",
    threshold: float | None = None,
    motion: MotionModel | None = None,
    sensor: SensorModel | None = None,
    dimensions: int | None = None,
    motion_copies: int = 1,
    max_iterations: int = 100,
) -> TextbookSolution:
    """Repeat the book's program on a log.

    Args:
        log: the log of the robot.
        edges: "virtual", or "virtual+motion".
        threshold: stop when the norm of the whole correction falls below this. Default: the book's, 0.01, and 0.02 with
            motion edges. With the default the program also stops, not converged, where the drift is greater than the
            threshold: when the steps became shorter by less than one percent in ten steps.
        motion, sensor: noise models; default: the book's.
        dimensions: 3 to use psi, 2 to ignore it; default: as the log has it.
        motion_copies: the number of times that each motion edge is counted (100 in the lectures' 2-D program).
        max_iterations: the most iterations.

    Raises:
        GraphError: the log lacks what is needed, or Omega is singular.
        OptionError: an option has an impossible value.
    """
    _check(log, edges, motion_copies, max_iterations)
    log.warn_of_unused("the lectures' program")
    patience = PATIENCE if threshold is None else max_iterations
    threshold = THRESHOLDS[edges] if threshold is None else threshold
    checks.check_not_negative(threshold=threshold)
    d = log.sightings.shape[1] if dimensions is None else dimensions
    checks.check_count(dimensions=d)
    if d not in (2, 3) or d > log.sightings.shape[1]:
        raise OptionError(f"dimensions must be 2 or 3 and not more than the log has, not {quoted(dimensions)}")
    motion, sensor = log.noise_models(motion, sensor)
    if not sensor.centred:
        raise GraphError("the lectures' program needs the sensor at the robot's pose; this one has an offset")
    check_magnitudes(log, motion, sensor)
    times, sightings = log.steps.tolist(), log.sightings[:, :d]
    seen: dict[int, list[int]] = {}
    for k, j in enumerate(log.landmarks.tolist()):
        seen.setdefault(j, []).append(k)
    pairs = [(a, b) for of_one in seen.values() for a, b in combinations(of_one, 2) if times[a] != times[b]]
    # without motion edges, poses that saw nothing are removed, but keep their numbers
    with_motion = edges == "virtual+motion"
    steps = list(range(log.num_poses)) if with_motion else sorted(set(times))
    if not steps or not (pairs or with_motion):
        raise GraphError(f"{log.name} has no landmark that was seen twice, so there are no virtual-motion edges")
    row = {t: 3 * k for k, t in enumerate(steps)}
    x = log.initial_poses.copy()

    step_norms: list[float] = []
    costs: list[float] = []
    converged = drifts = False
    while len(step_norms) < max_iterations and not (converged or drifts):
        try:
            Omega, xi, J = linear_system(
                x, row, log, sightings, pairs, sensor, motion, motion_copies if with_motion else 0
            )
            if not step_norms:
                _check_determined(Omega)
            Delta = np.linalg.solve(Omega, xi)
        except np.linalg.LinAlgError:
            raise GraphError(
                "Omega or the covariance of an edge is singular: the edges do not determine every pose (add motion edges), "
                "or the noise is too small"
            ) from None
        if not np.isfinite(Delta).all():
            raise GraphError(f"the iteration diverged: the step after {len(step_norms)} iterations is not finite")
        for t in steps:
            x[t] += Delta[row[t] : row[t] + 3]
        costs.append(J)
        step_norms.append(float(np.linalg.norm(Delta)))
        converged = step_norms[-1] < threshold
        drifts = len(step_norms) > patience and min(step_norms[-patience:]) > (1 - DRIFT) * min(step_norms[:-patience])
    last = f"the last step norm is {step_norms[-1]:.1e}" if step_norms else "no step was taken"
    reason = f"{last}; the threshold is {threshold:g}"
    if drifts:
        reason += ", and the steps become no shorter: the graph drifts, because the anchor is not in xi"
    elif not converged:
        reason += f", and max_iterations = {max_iterations} is reached"
    landmarks = {j: solve_map([(x[times[k]], sightings[k]) for k in of_one], sensor) for j, of_one in seen.items()}
    estimated = np.isin(np.arange(log.num_poses), steps)
    return TextbookSolution(
        x, estimated, landmarks, step_norms, costs, len(step_norms), converged, len(pairs), threshold, reason
    )


def linear_system(
    x: Array,
    row: dict[int, int],
    log: Log,
    sightings: Array,
    pairs: list[tuple[int, int]],
    sensor: SensorModel,
    motion: MotionModel,
    motion_copies: int,
) -> tuple[Array, Array, float]:
    """Omega = sum of B' Omega_e B and the anchor, xi = - sum of B' Omega_e e, J = sum of e' Omega_e e, at the poses x.

    Args:
        x: (T+1, 3).
        row: {step: its first row in Omega}.
        log: of the robot, with the controls.
        sightings: (K, 2 or 3) as they are used.
        pairs: the sightings of one landmark that make an edge.
        sensor, motion: noise models.
        motion_copies: the number of times that each motion edge is counted; 0: there are none.
    """
    Omega, xi, J = np.zeros((3 * len(row), 3 * len(row))), np.zeros(3 * len(row)), 0.0
    # the anchor: in Omega only, as in the book
    Omega[:3, :3] += OMEGA_0
    times = log.steps.tolist()
    # each sighting belongs to many edges
    places = [place_of(x[t], z, sensor) for t, z in zip(times, sightings)]
    for a, b in pairs:
        e, Omega_e, B1, B2 = difference(places[a], places[b])
        _add(Omega, xi, row[times[a]], row[times[b]], e, Omega_e, B1, B2)
        J += float(e @ Omega_e @ e)
    if motion_copies:
        assert log.controls is not None and log.dt is not None
        for t, (u, dt) in enumerate(zip(log.controls, log.dt.tolist()), start=1):
            e, Omega_e, B1, B2 = motion_edge(x[t - 1], x[t], u, dt, motion)
            _add(Omega, xi, row[t - 1], row[t], e, motion_copies * Omega_e, B1, B2)
            J += motion_copies * float(e @ Omega_e @ e)
    return Omega, xi, J


def virtual_motion_edge(
    x1: Array, z1: Array, x2: Array, z2: Array, sensor: SensorModel
) -> tuple[Array, Array, Array, Array]:
    """Two sightings z1, z2 of one landmark from poses x1, x2: e, Omega_e, B_1, B_2.

    e = h^-1(x2, z2) - h^-1(x1, z1), Omega_e^-1 = R1 Q1 R1' + R2 Q2 R2'. Without psi the third row is missing.
    (One slide prints R1 in the second term, too, by mistake.)
    """
    return difference(place_of(x1, z1, sensor), place_of(x2, z2, sensor))


#: the place of a landmark by one sighting: y, its covariance, and its derivative by the pose
Place = tuple[Array, Array, Array]


def place_of(x: Array, z: Array, sensor: SensorModel) -> Place:
    """The landmark by one sighting z from pose x: y = h^-1(x, z), its covariance R Q R', and B = dy/dx."""
    R = sighting_derivative(x, z)
    return inverse_observation(x, z), R @ sighting_covariance(z, sensor) @ R.T, pose_derivative(x, z)[: len(z)]


def difference(first: Place, second: Place) -> tuple[Array, Array, Array, Array]:
    """The edge between two places of one landmark: e = y2 - y1, Omega_e, -B_1, B_2."""
    (y1, covariance1, B1), (y2, covariance2, B2) = first, second
    e = y2 - y1
    if len(e) == 3:
        e[2] = _wrapped(e[2])
    return e, np.linalg.inv(covariance1 + covariance2), -B1, B2


def inverse_observation(x: Array, z: Array) -> Array:
    """h^-1(x, z) = (x + l cos(theta + phi), y + l sin(theta + phi), theta + phi - psi)."""
    place = [x[0] + z[0] * cos(x[2] + z[1]), x[1] + z[0] * sin(x[2] + z[1])]
    return np.array(place if len(z) == 2 else [*place, x[2] + z[1] - z[2]])


def sighting_derivative(x: Array, z: Array) -> Array:
    """R = dh^-1/dz = [[c, -l s, 0], [s, l c, 0], [0, 1, -1]]."""
    c, s, length = cos(x[2] + z[1]), sin(x[2] + z[1]), z[0]
    R = np.array([[c, -length * s, 0], [s, length * c, 0], [0, 1, -1]])
    return R[: len(z), : len(z)]


def sighting_covariance(z: Array, sensor: SensorModel) -> Array:
    """Q = diag((l sigma_l)², sigma_phi², sigma_psi²)."""
    variances = [
        (z[0] * sensor.range_rate) ** 2 + sensor.range_std**2,
        sensor.bearing_std**2,
        sensor.orientation_std**2,
    ]
    return np.diag(variances[: len(z)])


def pose_derivative(x: Array, z: Array) -> Array:
    """B = dh^-1/dx = [[1, 0, -l s], [0, 1, l c], [0, 0, 1]]."""
    c, s, length = cos(x[2] + z[1]), sin(x[2] + z[1]), z[0]
    return np.array([[1, 0, -length * s], [0, 1, length * c], [0, 0, 1]])


def motion_edge(x1: Array, x2: Array, u: Array, dt: float, motion: MotionModel) -> tuple[Array, Array, Array, Array]:
    """The control u took x1 to x2: e = x2 - f(x1, u), Omega_e^-1 = A M A' + S + epsilon I, B_1 = -F, B_2 = I.

    S = slip² |nu| dt n n' is our addition, the noise sideways; n is the normal of the chord.

    Written with the divisions of the slides, and with the book's lower limit that makes them possible: an omega below
    1e-5 counts as 1e-5 in A and F. (`MotionModel` needs neither.)
    """
    nu, omega = u
    theta = x1[2]
    if abs(omega) < 1e-10:
        f = x1 + np.array([nu * cos(theta), nu * sin(theta), omega]) * dt
    else:
        turned = theta + omega * dt
        f = x1 + np.array(
            [nu / omega * (sin(turned) - sin(theta)), nu / omega * (cos(theta) - cos(turned)), omega * dt]
        )
    e = x2 - f
    e[2] = _wrapped(e[2])
    if abs(omega) < 1e-5:
        omega = 1e-5
    c, s, ct, st = cos(theta), sin(theta), cos(theta + omega * dt), sin(theta + omega * dt)
    A = np.array(
        [
            [(st - s) / omega, -nu / omega**2 * (st - s) + nu / omega * dt * ct],
            [(c - ct) / omega, -nu / omega**2 * (c - ct) + nu / omega * dt * st],
            [0, dt],
        ]
    )
    M = np.diag(
        [
            (motion.nn**2 * abs(nu) + motion.no**2 * abs(omega)) / dt + motion.sigma_v**2,
            (motion.on**2 * abs(nu) + motion.oo**2 * abs(omega)) / dt + motion.sigma_omega**2,
        ]
    )
    F = np.array([[1, 0, nu / omega * (ct - c)], [0, 1, nu / omega * (st - s)], [0, 0, 1]])
    n = np.array([-sin(theta + omega * dt / 2), cos(theta + omega * dt / 2), 0])
    S = motion.slip**2 * abs(nu) * dt * np.outer(n, n)
    return e, np.linalg.inv(A @ M @ A.T + S + motion.epsilon * np.eye(3)), -F, np.eye(3)


def solve_map(sightings: list[tuple[Array, Array]], sensor: SensorModel) -> Array:
    """The landmark seen as (pose, sighting) pairs: m = (sum of Omega)^-1 sum of Omega y, Omega^-1 = R Q R'.

    As in the book's program the heading comes out relative to that of the first sighting, and without psi the map is
    the unweighted mean of the places. (`estimate_map` weights them, and gives the heading itself.)
    """
    if len(sightings[0][1]) == 2:
        return np.mean([inverse_observation(x, z) for x, z in sightings], axis=0)
    Omega, xi = np.zeros((3, 3)), np.zeros(3)
    first = inverse_observation(*sightings[0])[2]
    for x, z in sightings:
        y = inverse_observation(x, z)
        y[2] = _wrapped(y[2] - first)
        R = sighting_derivative(x, z)
        Omega_z = np.linalg.inv(R @ sighting_covariance(z, sensor) @ R.T)
        Omega += Omega_z
        xi += Omega_z @ y
    return np.linalg.solve(Omega, xi)


def _add(Omega: Array, xi: Array, i: int, j: int, e: Array, Omega_e: Array, B1: Array, B2: Array) -> None:
    """Omega += B' Omega_e B and xi -= B' Omega_e e, where row i belongs to the first pose and row j to the second."""
    B = np.hstack((B1, B2))
    added, force = B.T @ Omega_e @ B, B.T @ Omega_e @ e
    for a, at in ((i, slice(3)), (j, slice(3, 6))):
        xi[a : a + 3] -= force[at]
        Omega[a : a + 3, i : i + 3] += added[at, :3]
        Omega[a : a + 3, j : j + 3] += added[at, 3:]


def _check(log: Log, edges: str, motion_copies: int, max_iterations: int) -> None:
    """Raise where a log or an option is none that the program takes."""
    check_is_log(log)
    checks.check_choice("edges", edges, THRESHOLDS)
    checks.check_count(motion_copies=motion_copies, max_iterations=max_iterations)
    if motion_copies < 1:
        raise OptionError(f"motion_copies must be at least 1, not {motion_copies}")
    if edges == "virtual+motion":
        if log.composite:
            raise GraphError(
                f"{log.name} has motions of several controls each, and the lectures' program takes one a step"
            )
        if log.controls is None:
            raise GraphError(f"{log.name} has no controls for motion edges; use edges='virtual'")
    if not log.identified:
        raise GraphError(f"{log.name} has sightings without landmark ids, and the lectures' program needs them")


def _check_determined(Omega: Array) -> None:
    """Raise `numpy.linalg.LinAlgError` where Omega is singular to rounding, which `numpy.linalg.solve` need not notice."""
    pivots = np.diag(np.linalg.cholesky(Omega)) ** 2
    if np.any(pivots < SINGULAR * np.diag(Omega)):
        raise np.linalg.LinAlgError


def _wrapped(angle: float) -> float:
    while angle >= pi:
        angle -= 2 * pi
    while angle < -pi:
        angle += 2 * pi
    return angle
