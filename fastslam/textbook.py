"""FastSLAM and Monte Carlo localisation as in the lectures: particle by particle, one equation per function.

This program is written for students, plain and slow, and the tests compare the array versions with it. The random
numbers come from one generator in the same order as in the array versions: for each motion ``standard_normals(rng, N)``,
five Gaussian numbers per particle, row i for particle i, and for each systematic resampling one ``rng.random()``.

Sources: Ueda, *LNPR*, chapters 5 and 8; Montemerlo, Thrun, Koller and Wegbreit, *FastSLAM*, AAAI 2002, and *FastSLAM
2.0*, IJCAI 2003; Thrun, Burgard and Fox, *Probabilistic Robotics*, sections 8.3, 13.3 and 13.5 to 13.8.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from graphslam import Log, LogError, MotionModel, SensorModel
from graphslam.errors.checks import check_choice
from graphslam.se2 import Array, wrap

from .options import PROPOSAL_WEIGHTS
from .particles import standard_normals


@dataclass(frozen=True)
class Gaussian:
    """N(mean, covariance): a particle's estimate of one landmark, (n,) and (n, n), n = 2 or 3, or of its pose in 2.0.

    The covariance of a landmark on a known map is zero.
    """

    mean: Array
    covariance: np.ndarray


@dataclass
class Particle:
    """A trajectory whose last pose is x_t, the logarithm of its weight, and a map of its own {id: Gaussian}."""

    path: list[Array]
    log_weight: float
    map: dict[int, Gaussian] = field(default_factory=dict)

    @property
    def pose(self) -> Array:
        """The current pose x_t, (3,)."""
        return self.path[-1]


def start(particles: int, pose: ArrayLike) -> list[Particle]:
    """Return N particles at the known first pose, each of weight 1/N, with empty maps."""
    return [Particle([wrap_heading(np.array(pose, dtype=float))], -np.log(particles)) for _ in range(particles)]


def wrap_heading(pose: Array) -> Array:
    """Return the pose with its heading in [-pi, pi)."""
    return np.array([pose[0], pose[1], wrap(pose[2])])


def sample_motion(pose: Array, control: ArrayLike, dt: float, motion: MotionModel, noise: Array) -> Array:
    """Sample x_t ~ p(x_t | x_{t-1}, u_t): u' ~ N(u_t, M), x_t = f(x_{t-1}, u') + e with e ~ N(0, epsilon I).

    The lectures have no e. The framework's motion edges add epsilon I to the covariance A M A', and with e both
    estimate the same posterior. A slip of the motion model is not drawn; `fastslam1` and `fastslam2` refuse one. The
    noise is five standard normal numbers (nu, omega, x, y, theta).
    """
    noisy_control = np.asarray(control) + np.sqrt(np.diag(motion.M(control, dt))) * noise[:2]
    return wrap_heading(motion.f(pose, noisy_control, dt) + np.sqrt(motion.epsilon) * noise[2:])


def motion_update(
    particles: list[Particle], control: ArrayLike, dt: float, motion: MotionModel, rng: np.random.Generator
) -> None:
    """Sample the motion of every particle."""
    for particle, noise in zip(particles, standard_normals(rng, len(particles)), strict=True):
        particle.path.append(sample_motion(particle.pose, control, dt, motion, noise))


def initialize_landmark(pose: Array, z: Array, sensor: SensorModel) -> Gaussian:
    """Initialise a landmark by its first sighting: mean h^-1(x, z), covariance (H' Q^-1 H)^-1."""
    mean = sensor.h_inverse(pose, z)
    H = sensor.H(pose, mean)
    return Gaussian(mean, np.linalg.inv(H.T @ np.linalg.inv(sensor.Q(z)) @ H))


def residual(pose: Array, landmark: Gaussian, z: Array, sensor: SensorModel) -> Array:
    """Return the residual z - h(m), angles wrapped."""
    difference = z - sensor.h(pose, landmark.mean)
    return np.array([difference[0], *wrap(difference[1:])])


def innovation_covariance(pose: Array, landmark: Gaussian, z: Array, sensor: SensorModel) -> Array:
    """Return the covariance of the residual, V = H S H' + Q, with Q at the measured range as in the graph's edges."""
    H = sensor.H(pose, landmark.mean)
    return H @ landmark.covariance @ H.T + sensor.Q(z)


def log_likelihood(pose: Array, landmark: Gaussian, z: Array, sensor: SensorModel) -> float:
    """Return the logarithm of N(z; h(m), V) = det(2 pi V)^(-1/2) exp(-r' V^-1 r / 2), r = z - h(m).

    The determinant differs between particles and belongs to the weight. -inf where the particle stands on the
    landmark (nearer than 1e-9 m), which then has no bearing.
    """
    if np.hypot(*(landmark.mean[:2] - pose[:2])) < 1e-9:
        return -np.inf
    V = innovation_covariance(pose, landmark, z, sensor)
    return log_density(residual(pose, landmark, z, sensor), V)


def log_density(r: Array, V: Array) -> float:
    """Return the logarithm of the density N(r; 0, V)."""
    return float(-0.5 * (r @ np.linalg.solve(V, r) + np.log(np.linalg.det(2 * np.pi * V))))


def update_landmark(pose: Array, landmark: Gaussian, z: Array, sensor: SensorModel) -> Gaussian:
    """Update a landmark by a later sighting: K = S H' (Q + H S H')^-1, m += K (z - h(m)), S = (I - K H) S."""
    H = sensor.H(pose, landmark.mean)
    V = innovation_covariance(pose, landmark, z, sensor)
    K = landmark.covariance @ H.T @ np.linalg.inv(V)
    mean = landmark.mean + K @ residual(pose, landmark, z, sensor)
    mean[2:] = wrap(mean[2:])
    return Gaussian(mean, (np.eye(len(mean)) - K @ H) @ landmark.covariance)


def observation_update(
    particles: list[Particle], ids: Iterable[int], sightings: Iterable[Array], sensor: SensorModel
) -> bool:
    """Process the sightings of one step, one after the other: w *= N(z; h(m), V), then update m and S.

    The weights then sum to 1. Returns whether any sighting was weighed; first sightings do not change the weights.
    """
    before = [particle.log_weight for particle in particles]
    sighted = list(zip(ids, sightings, strict=True))
    weighed = [weigh_and_map(particle, sighted, sensor) for particle in particles]
    normalize(particles, before)
    return any(weighed)


def weigh_and_map(
    particle: Particle, sighted: list[tuple[int, Array]], sensor: SensorModel, leading: Collection[int] = ()
) -> bool:
    """Process the sightings (id, z) of a step from the particle's pose, and return whether any is of a known landmark.

    The sightings with numbers in ``leading`` do not change the weight: FastSLAM 2.0 has weighed them before.
    """
    weighed = False
    for k, (j, z) in enumerate(sighted):
        if j not in particle.map:
            particle.map[j] = initialize_landmark(particle.pose, z, sensor)
            continue
        weighed = True
        likelihood = log_likelihood(particle.pose, particle.map[j], z, sensor)
        if k not in leading:
            particle.log_weight += likelihood
        if likelihood > -np.inf:
            particle.map[j] = update_landmark(particle.pose, particle.map[j], z, sensor)
    return weighed


def predict_pose(pose: Array, control: ArrayLike, dt: float, motion: MotionModel) -> Gaussian:
    """FastSLAM 2.0: predict the pose before the sightings as a Gaussian, N(f(x_{t-1}, u_t), A M A' + epsilon I)."""
    return Gaussian(wrap_heading(motion.f(pose, control, dt)), motion.covariance(pose, control, dt))


def correct_pose(belief: Gaussian, landmark: Gaussian, z: Array, sensor: SensorModel) -> tuple[Gaussian, float]:
    """FastSLAM 2.0: correct the Gaussian of a pose by one sighting, and return also the log likelihood of the sighting.

    V = H_x P H_x' + H_m S H_m' + Q, K = P H_x' V^-1, mean += K (z - h), P = (I - K H_x) P. The likelihood N(z; h, V) is
    the one under the prediction, before the pose is drawn. It is 0 where the mean stands on the landmark.
    """
    if np.hypot(*(landmark.mean[:2] - belief.mean[:2])) < 1e-9:
        return belief, -np.inf
    H_x, H_m = sensor.H_pose(belief.mean, landmark.mean), sensor.H(belief.mean, landmark.mean)
    V = H_x @ belief.covariance @ H_x.T + H_m @ landmark.covariance @ H_m.T + sensor.Q(z)
    r = residual(belief.mean, landmark, z, sensor)
    K = belief.covariance @ H_x.T @ np.linalg.inv(V)
    corrected = Gaussian(wrap_heading(belief.mean + K @ r), (np.eye(3) - K @ H_x) @ belief.covariance)
    return corrected, log_density(r, V)


def draw_pose(belief: Gaussian, noise: Array) -> Array:
    """Sample x_t ~ N(mean, P) as mean + L noise with P = L L'; three standard normal numbers."""
    return wrap_heading(belief.mean + np.linalg.cholesky(belief.covariance) @ noise)


def draw_weighted(
    pose: Array, belief: Gaussian, control: ArrayLike, dt: float, motion: MotionModel, noise: Array
) -> tuple[Array, float]:
    """FastSLAM 2.0: draw the pose from its corrected Gaussian q, and return also log p(x) - log q(x).

    x* ~ q = N(mean, P+), and p(x*) = N(x*; f(x_{t-1}, u_t), P). In the linear model x* - f = A c + e, with the noise
    c ~ N(0, I) of the control, A = df/du M^(1/2) and e ~ N(0, epsilon I). The noise is drawn given x*, c ~ N(A' P^-1 (x* -
    f), I - A' P^-1 A), and put into the motion itself, x = f(x_{t-1}, u_t + M^(1/2) c) + e: then the weight is exact also
    for this x. ``noise``: three standard normal numbers for x*, two for c.
    """
    predicted, spread = predict_pose(pose, control, dt, motion), np.sqrt(np.diag(motion.M(control, dt)))
    drawn = draw_pose(belief, noise[:3])
    d = drawn - predicted.mean
    d[2] = wrap(d[2])
    # the three numbers of the noise have the density of x* under q, but for the determinant
    ratio = log_density(d, predicted.covariance) - log_density(noise[:3], np.eye(3))
    ratio += np.log(np.linalg.det(np.linalg.cholesky(belief.covariance)))
    A = motion.A(pose, control, dt) * spread
    gain = A.T @ np.linalg.inv(predicted.covariance)
    c = gain @ d + np.linalg.cholesky(np.eye(2) - gain @ A) @ noise[3:]
    return wrap_heading(motion.f(pose, np.asarray(control) + spread * c, dt) + d - A @ c), float(ratio)


def proposal_update(
    particles: list[Particle],
    control: ArrayLike,
    dt: float,
    ids: Iterable[int],
    sightings: Iterable[Array],
    motion: MotionModel,
    sensor: SensorModel,
    rng: np.random.Generator,
    weight: str = "exact",
) -> bool:
    """FastSLAM 2.0, one whole step: each particle corrects its motion, draws its pose and updates its map from there.

    The first sighting of each known landmark corrects the motion, one after the other. The weight "exact" is multiplied
    by p(x) / q(x) and by the likelihoods from the drawn pose, as in 1.0. The weight "linearised", that of the lectures, is
    multiplied by their likelihoods under the prediction. Further sightings of a landmark in the step are weighed as in
    1.0, from the drawn pose. A step without known landmarks is that of 1.0. The weights then sum to 1. Returns whether
    any sighting was weighed.
    """
    sighted = list(zip(ids, sightings, strict=True))
    before = [particle.log_weight for particle in particles]
    weighed = False
    for particle, noise in zip(particles, standard_normals(rng, len(particles)), strict=True):
        leading = {k for k, (j, _) in enumerate(sighted) if j in particle.map and j not in [i for i, _ in sighted[:k]]}
        if leading:
            belief = predict_pose(particle.pose, control, dt, motion)
            for k in sorted(leading):
                j, z = sighted[k]
                belief, likelihood = correct_pose(belief, particle.map[j], z, sensor)
                if weight == "linearised":
                    particle.log_weight += likelihood
            if weight == "linearised":
                particle.path.append(draw_pose(belief, noise[:3]))
            else:
                leading = set()
                drawn, ratio = draw_weighted(particle.pose, belief, control, dt, motion, noise)
                particle.path.append(drawn)
                particle.log_weight += ratio
        else:
            particle.path.append(sample_motion(particle.pose, control, dt, motion, noise))
        weighed |= weigh_and_map(particle, sighted, sensor, leading)
    normalize(particles, before)
    return weighed


def localization_update(
    particles: list[Particle],
    ids: Iterable[int],
    sightings: Iterable[Array],
    landmarks: Mapping[int, Array],
    sensor: SensorModel,
) -> None:
    """Monte Carlo localisation: the landmarks are known (S = 0), so w *= N(z; h(m), Q) and no landmark moves."""
    before = [particle.log_weight for particle in particles]
    for j, z in zip(ids, sightings, strict=True):
        n = min(len(z), len(landmarks[j]))
        known = Gaussian(np.asarray(landmarks[j])[:n], np.zeros((n, n)))
        for particle in particles:
            particle.log_weight += log_likelihood(particle.pose, known, z[:n], sensor)
    normalize(particles, before)


def normalize(particles: list[Particle], before: list[float]) -> None:
    """Make the weights sum to 1; where all of them vanished, restore those from before the sightings."""
    log_weights = np.array([particle.log_weight for particle in particles])
    if np.all(log_weights == -np.inf):
        log_weights = np.array(before)
    log_weights = log_weights - log_weights.max()
    log_weights -= np.log(np.exp(log_weights).sum())
    for particle, log_weight in zip(particles, log_weights, strict=True):
        particle.log_weight = float(log_weight)


def effective_sample_size(particles: list[Particle]) -> float:
    """Return ESS = 1 / sum of w_i², between 1 and N."""
    # rounding must not make it exceed N, because a threshold of N means always
    return float(min(1 / sum(np.exp(particle.log_weight) ** 2 for particle in particles), len(particles)))


def resample(particles: list[Particle], rng: np.random.Generator) -> list[Particle]:
    """Resample systematically at N positions 1/N apart, with one random offset, on the cumulative sum of the weights.

    Every survivor is copied with its map and its path, so that two particles never share them.
    """
    count = len(particles)
    cumulative = np.cumsum([np.exp(particle.log_weight) for particle in particles])
    offset, k, survivors = rng.random(), 0, []
    for i in range(count):
        while cumulative[k] <= (offset + i) / count * cumulative[-1] and k < count - 1:
            k += 1
        survivors.append(deepcopy(particles[k]))
        survivors[-1].log_weight = -np.log(count)
    return survivors


def resample_if_due(
    particles: list[Particle], weighed: bool, ess_threshold: float, rng: np.random.Generator
) -> list[Particle]:
    """Resample after sightings when ESS <= ess_threshold * N; 1 is the lectures' way, after every step with sightings."""
    due = weighed and effective_sample_size(particles) <= ess_threshold * len(particles)
    return resample(particles, rng) if due else particles


def measurements(
    log: Log, motion: MotionModel, sensor: SensorModel
) -> Iterator[tuple[Array | None, float, list[int], Array]]:
    """Yield for every step: the control that led to it (None at the first), its duration, the ids and the sightings.

    Raises:
        LogError: the log has no controls, several controls in a step, a sensor at an offset, sightings without ids, or a
            motion model with slip.
    """
    if log.controls is None or log.dt is None:
        raise LogError(f"{log.name} has no controls, and a particle filter moves its particles by them")
    if not log.identified:
        raise LogError(
            f"{log.name} has sightings without ids; the lectures' filter takes those of known landmarks only"
        )
    if log.composite or not sensor.centred:
        raise LogError(f"{log.name}: the lectures' filter takes one control a step, and a sensor at the robot's pose")
    if motion.slip > 0:
        raise LogError(f"{log.name}: the lectures' filter has no noise sideways; take a motion model with slip=0")
    for t in range(log.num_poses):
        now = log.steps == t
        u, dt = (log.controls[t - 1], log.dt[t - 1]) if t > 0 else (None, 0.0)
        yield u, dt, log.landmarks[now].tolist(), log.sightings[now]


def fastslam1(
    log: Log,
    *,
    particles: int = 100,
    rng: np.random.Generator | int,
    motion: MotionModel | None = None,
    sensor: SensorModel | None = None,
    ess_threshold: float = 1.0,
) -> Iterator[list[Particle]]:
    """Run FastSLAM 1.0 over a log and yield the particles after every step, the first at the known first pose.

    ``rng`` gives the random numbers, or is the seed of one that does.

    Raises:
        LogError: the log has no controls, several controls in a step, a sensor at an offset, or a motion model with slip.
    """
    motion, sensor, rng = *log.noise_models(motion, sensor), np.random.default_rng(rng)
    current = start(particles, log.initial_poses[0])
    for u, dt, ids, sightings in measurements(log, motion, sensor):
        if u is not None:
            motion_update(current, u, dt, motion, rng)
        weighed = observation_update(current, ids, sightings, sensor)
        current = resample_if_due(current, weighed, ess_threshold, rng)
        yield current


def fastslam2(
    log: Log,
    *,
    particles: int = 100,
    rng: np.random.Generator | int,
    motion: MotionModel | None = None,
    sensor: SensorModel | None = None,
    ess_threshold: float = 1.0,
    proposal_weight: str = "exact",
) -> Iterator[list[Particle]]:
    """Run FastSLAM 2.0 over a log, as `fastslam1`; proposal_weight: "exact" or "linearised", see `proposal_update`.

    Raises:
        LogError: the log has no controls, several controls in a step, a sensor at an offset, or a motion model with slip.
        OptionError: there is no such proposal_weight.
    """
    check_choice("proposal_weight", proposal_weight, PROPOSAL_WEIGHTS)
    motion, sensor, rng = *log.noise_models(motion, sensor), np.random.default_rng(rng)
    current = start(particles, log.initial_poses[0])
    for u, dt, ids, sightings in measurements(log, motion, sensor):
        if u is None:
            weighed = observation_update(current, ids, sightings, sensor)
        else:
            weighed = proposal_update(current, u, dt, ids, sightings, motion, sensor, rng, proposal_weight)
        current = resample_if_due(current, weighed, ess_threshold, rng)
        yield current
