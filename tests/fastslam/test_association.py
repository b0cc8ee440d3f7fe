"""Unknown data association: against plain Python particle by particle, and in worlds with a known answer."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from fastslam import FastSLAM1, FastSLAM2, textbook
from fastslam.particles import standard_normals
from graphslam import MotionModel, OptionError, SensorModel, simulate

UNKNOWN = {"association": "maximum-likelihood"}
HALF = {
    "motion": MotionModel(nn=0.095, no=0.0005, on=0.065, oo=0.1, epsilon=2.5e-5),
    "sensor": SensorModel(range_rate=0.07, bearing_std=0.025, orientation_std=0.025),
}
CONTROL, DT = np.array([0.5, 0.2]), 1.0


def greedy(scores: np.ndarray) -> list[int]:
    """The most likely pair first; -1 for a sighting without a landmark."""
    scores, chosen = scores.copy(), [-1] * len(scores)
    while scores.size and scores.max() > -np.inf:
        k, c = np.unravel_index(scores.argmax(), scores.shape)
        chosen[k] = int(c)
        scores[k], scores[:, c] = -np.inf, -np.inf
    return chosen


@pytest.mark.slow
@pytest.mark.parametrize(("version", "weight"), [(1, "exact"), (2, "exact"), (2, "linearised")])
@pytest.mark.parametrize("columns", [2, pytest.param(3, marks=pytest.mark.nightly)])
def test_against_the_textbooks_equations(columns: int, version: int, weight: str) -> None:
    """Ten scans of landmarks so close that particles disagree: maps, weights and poses equal those of the textbook."""
    rng, particles, p = np.random.default_rng(3), 12, 0.05
    world = np.column_stack([rng.uniform(1, 5, 6), rng.uniform(-2, 2, 6), rng.uniform(-1, 1, 6)])[:, :columns]
    kind = {1: FastSLAM1, 2: FastSLAM2}[version]
    options = {"ess_threshold": 0.0, "new_landmark_threshold": p, "particles": particles, **HALF, **UNKNOWN}
    options["merge_interval"] = 0
    options["proposal_weight"] = weight
    slam = kind(seed=np.random.default_rng(8), **options)
    sensor, motion, noise_rng = slam.sensor, slam.motion, np.random.default_rng(8)
    slow = textbook.start(particles, np.zeros(3))
    evidence: list[dict[int, float]] = [{} for _ in slow]
    created, reach, pose, used_now = 0, np.array([np.inf, 0.0, 0.0]), np.zeros(3), [set() for _ in slow]
    disagreed, dropped = False, 0
    for t in range(10):
        normals = standard_normals(noise_rng, particles) if t else None
        if t:
            for i, particle in enumerate(slow):
                for j in set(particle.map) - used_now[i]:
                    r, phi = sensor.h(particle.pose, particle.map[j].mean)[:2]
                    if evidence[i][j] < 3 and reach[0] / 0.9 <= r <= 0.9 * reach[1] and abs(phi) <= 0.9 * reach[2]:
                        evidence[i][j] -= 1
                        dropped += evidence[i][j] == 0
                        if evidence[i][j] == 0:
                            del particle.map[j], evidence[i][j]
            slam.move(CONTROL, DT)
            pose = motion.f(pose, CONTROL, DT) + [0.02, -0.03, 0.05]
        visible = rng.permutation(6)[:4]
        z = sensor.h(pose, world[visible]) + 0.03 * rng.standard_normal((4, columns))
        slam.observe(None, z)
        reach = [min(reach[0], z[:, 0].min()), max(reach[1], z[:, 0].max()), max(reach[2], abs(z[:, 1]).max())]
        log_new = [
            -0.5 * (chi2.isf(p, columns) + np.log(np.linalg.det(2 * np.pi * sensor.Q(one)))) for one in z
        ]  # fmt: skip
        for i, particle in enumerate(slow):
            if t:
                moved = textbook.sample_motion(particle.pose, CONTROL, DT, motion, normals[i])
                belief = textbook.predict_pose(particle.pose, CONTROL, DT, motion)
                if version == 1:
                    belief = textbook.Gaussian(moved, np.zeros((3, 3)))
            else:
                moved, belief = particle.pose, textbook.Gaussian(particle.pose, np.zeros((3, 3)))
            names = sorted(particle.map)
            scores = np.array(
                [[textbook.correct_pose(belief, particle.map[j], one, sensor)[1] for j in names] for one in z]
            ).reshape(4, len(names))
            scores[scores < np.array(log_new)[:, None]] = -np.inf
            chosen = [names[c] if c >= 0 else None for c in greedy(scores)]
            for k, j in enumerate(chosen):
                if j is None:
                    particle.log_weight += log_new[k]
                elif version == 1:
                    particle.log_weight += scores[k, names.index(j)]
                else:
                    belief, likelihood = textbook.correct_pose(belief, particle.map[j], z[k], sensor)
                    if weight == "linearised" or not t:
                        particle.log_weight += likelihood
            now = moved
            if version == 2 and t and weight == "exact":
                now, ratio = textbook.draw_weighted(particle.pose, belief, CONTROL, DT, motion, normals[i])
                particle.log_weight += ratio
            elif version == 2 and t:
                now = textbook.draw_pose(belief, normals[i, :3])
            particle.path.append(now)
            used_now[i] = {created + k if j is None else j for k, j in enumerate(chosen)}
            for k, j in enumerate(chosen):
                if j is None:
                    particle.map[created + k] = textbook.initialize_landmark(now, z[k], sensor)
                    evidence[i][created + k] = 1
                else:
                    if version == 2 and t and weight == "exact":
                        particle.log_weight += textbook.log_likelihood(now, particle.map[j], z[k], sensor)
                    particle.map[j] = textbook.update_landmark(now, particle.map[j], z[k], sensor)
                    evidence[i][j] = min(evidence[i][j] + 1, 3)
        created += 4
        log_weights = np.array([particle.log_weight for particle in slow])
        np.testing.assert_allclose(
            slam.state.log_weights, log_weights - np.log(np.exp(log_weights).sum()), atol=1e-10, rtol=1e-10
        )
        np.testing.assert_allclose(slam.state.poses, [particle.pose for particle in slow], atol=1e-10)
        for i, particle in enumerate(slow):
            estimates = slam.state.map(i, provisional=True)
            assert estimates.keys() == particle.map.keys()
            for j, landmark in particle.map.items():
                np.testing.assert_allclose(estimates[j].mean, landmark.mean, atol=1e-10)
                np.testing.assert_allclose(estimates[j].covariance, landmark.covariance, atol=1e-10)
        disagreed |= len({tuple(sorted(particle.map)) for particle in slow}) > 1
    assert disagreed
    assert dropped > 0


@pytest.mark.parametrize("kind", [FastSLAM1, FastSLAM2])
@pytest.mark.parametrize("psi", [True, False])
def test_right_number_of_landmarks(kind: type, psi: bool) -> None:
    """Half the book's noise: landmarks are 5 standard deviations apart or more. docs/beyond/fastslam2.md has 50 seeds."""
    for seed in range(4):
        log = simulate(seed=seed, clean=True, orientation=psi, **HALF)
        slam = kind(log, particles=500, seed=seed, **HALF, **UNKNOWN)
        result, state = slam.run(), slam.state
        assert len(result.landmarks) == len(log.landmark_ids)
        mixture = state.mixture_map()
        assert len(mixture) == len(log.landmark_ids)
        # each estimate is that of another landmark
        truth = {j: m[:2] for j, m in log.true_landmarks.items() if j in log.landmark_ids}
        nearest = {min(truth, key=lambda j: np.hypot(*(mean[:2] - truth[j]))) for mean in result.landmarks.values()}
        assert len(nearest) == len(truth)


def test_ids_are_ignored() -> None:
    log = simulate(seed=1, clean=True, **HALF)
    shuffled = log.replace(landmarks=np.arange(len(log.landmarks))[::-1].copy())
    a, b = (FastSLAM1(one, particles=50, **HALF, **UNKNOWN).run() for one in (log, shuffled))
    np.testing.assert_array_equal(a.poses, b.poses)
    assert a.landmarks.keys() == b.landmarks.keys()


def test_a_false_detection_is_dropped_when_it_is_not_seen_again() -> None:
    marks = np.array([[3.0, 1.0, 0.2], [4.0, -1.0, -0.4], [5.0, 2.5, 1.0], [2.0, -2.0, 0.0]])
    slam = FastSLAM1(particles=20, **HALF, **UNKNOWN)
    real = slam.sensor.h(np.zeros(3), marks)
    false_detection = np.array([[4.5, 0.1, 0.0]])
    counts = []
    # landmarks seen three times are permanent
    for scan in (real, np.vstack([real, false_detection]), real, *[real[:1]] * 5):
        slam.observe(None, scan)
        counts.append(len(slam.state.map(provisional=True)))
        slam.move((0.0, 0.0), 0.0)
    assert counts == [4, 5, 5, 4, 4, 4, 4, 4]


def test_several_calls_in_a_step_are_one_observation() -> None:
    """A landmark that one call of a step sees is not missed by the other calls of the step."""
    marks = np.array([[3.0, 1.0, 0.2], [4.0, -1.0, -0.4], [5.0, 2.5, 1.0], [2.0, -2.0, 0.0]])
    together, apart = (FastSLAM1(particles=20, ess_threshold=0.0, **HALF, **UNKNOWN) for _ in range(2))
    real = together.sensor.h(np.zeros(3), marks)
    for _ in range(3):
        together.observe(None, real)
        for one in real:
            apart.observe(None, one[None])
        for slam in (together, apart):
            slam.move((0.0, 0.0), 0.0)
    maps = [[estimate.mean for estimate in slam.state.map(provisional=True).values()] for slam in (together, apart)]
    assert len(maps[0]) == 4
    np.testing.assert_allclose(*maps)


def test_an_empty_observation_misses_what_is_in_view() -> None:
    slam = FastSLAM1(particles=20, **HALF, **UNKNOWN)
    slam.observe(None, [])  # before the limits of the sensor are known
    slam.observe(None, [[4.0, 0.0], [1.0, 0.5], [6.0, -0.5]])
    slam.move((0.0, 0.0), 0.0)
    slam.move((0.0, 0.0), 0.0)  # no observation
    assert len(slam.state.map(provisional=True)) == 3
    slam.observe(None, [])
    slam.observe(None, np.empty((0, 2)))
    slam.move((0.0, 0.0), 0.0)
    # the other two are at the limits of what the sensor has seen
    assert [estimate.mean[0] for estimate in slam.state.map(provisional=True).values()] == pytest.approx(
        [np.cos(0.5), 6 * np.cos(0.5)]
    )


def test_mutual_exclusion() -> None:
    """Two equal sightings in one scan are two landmarks; in two scans they are one."""
    z = np.array([[3.0, 0.1]])
    together, apart = (FastSLAM1(particles=5, **HALF, **UNKNOWN) for _ in range(2))
    together.observe(None, np.vstack([z, z]))
    apart.observe(None, z)
    apart.observe(None, z)
    assert (len(together.state.map(provisional=True)), len(apart.state.map(provisional=True))) == (2, 1)


def test_the_pool_grows_and_is_reused() -> None:
    """Many landmarks, resampled at every scan: the pool grows, and slices of extinct particles are reused."""
    log = simulate(seed=2, clean=True, landmarks=60, arena=6.0, orientation=False, **HALF)
    slam = FastSLAM2(log, particles=60, ess_threshold=1.0, **HALF, **UNKNOWN)
    for state in slam:
        for i in (0, 59):
            for estimate in state.map(i, provisional=True).values():
                assert np.all(np.linalg.eigvalsh(estimate.covariance) > 0)
    used, (pool, created) = slam._engine.landmarks(), slam._engine.pool()
    assert len(np.unique(used)) == len(used) < pool < 200 < created
    assert len(slam.result().landmarks) > 20


@pytest.mark.parametrize("kind", [FastSLAM1, FastSLAM2])
def test_an_outlier_is_not_reported(kind: type) -> None:
    """One false sighting, never in view again: the particles have the landmark, the maps do not."""
    log = simulate(seed=1, steps=20, clean=True, **HALF)
    slam, landmarks = kind(log, particles=50, **HALF, **UNKNOWN), 0
    for state in slam:
        if state.step == 10:
            landmarks = len(state.map())
            slam.observe(None, [[30.0, 3.0, 0.0]])
    confirmed, everything = slam.state.map(), slam.state.map(provisional=True)
    assert len(confirmed) >= landmarks > 0
    assert max(np.hypot(*estimate.mean[:2]) for estimate in confirmed.values()) < 10
    assert max(np.hypot(*estimate.mean[:2]) for estimate in everything.values()) > 20
    assert {j for j, estimate in everything.items() if estimate.confirmed} == confirmed.keys()
    assert slam.result().landmarks.keys() == confirmed.keys()
    mixtures = [slam.state.mixture_map(provisional=asked) for asked in (False, True)]
    assert [sum(np.hypot(*e.mean[:2]) > 20 for e in mixture.values()) for mixture in mixtures] == [0, 1]
    assert all(estimate.confirmed for estimate in mixtures[0].values())


@pytest.mark.parametrize("kind", [FastSLAM1, FastSLAM2])
def test_same_result_whatever_the_number_of_threads(kind: type) -> None:
    log = simulate(seed=1, steps=15, clean=True, **HALF)
    a, b = (kind(log, particles=9000, threads=threads, **HALF, **UNKNOWN).run() for threads in (1, 2))
    np.testing.assert_array_equal(a.poses, b.poses)
    np.testing.assert_array_equal(a.log_weights, b.log_weights)


def test_options() -> None:
    with pytest.raises(OptionError, match="association must be one of auto, known, maximum-likelihood"):
        FastSLAM1(association="nearest")
    with pytest.raises(OptionError, match="new_landmark_threshold must lie between 0 and 1"):
        FastSLAM2(new_landmark_threshold=0.0)
    with pytest.raises(OptionError, match="new_landmark_threshold must be a number"):
        FastSLAM2(new_landmark_threshold="few")
    with pytest.raises(OptionError, match="ids may be None only if"):
        FastSLAM1().observe(None, [[1.0, 0.0]])


@pytest.mark.parametrize("kind", [FastSLAM1, FastSLAM2])
def test_a_phantom_is_dropped_where_the_sensor_s_limits_say_that_it_should_be_seen(kind: type[FastSLAM1]) -> None:
    """A sighting at 5 m that never comes again: without limits nothing says that the sensor sees as far as that."""
    there, phantom = [2.0, 0.1], [5.0, -0.5]

    def landmarks(**limits: float) -> int:
        slam = kind(particles=20, sensor=SensorModel(range_rate=0.01, bearing_std=0.01, **limits), **UNKNOWN)
        slam.observe(None, np.array([there, phantom]))
        for _ in range(3):
            slam.move(np.zeros(2), 1.0)
            slam.observe(None, np.array([there]))
        return len(slam.state.map(provisional=True))

    assert landmarks() == 2
    assert landmarks(max_range=8.0, field_of_view=2.0) == 1
    # near a limit, known or learned, it may be overlooked
    assert landmarks(max_range=5.2, field_of_view=2.0) == 2
    assert landmarks(max_range=8.0) == 2


def test_landmarks_that_no_particle_has_together_have_no_joint_covariance() -> None:
    log = simulate(seed=1, clean=True, orientation=False, steps=60, landmarks=20)
    slam = FastSLAM1(log, particles=50, seed=1, stage="motion", **UNKNOWN)
    next(state for state in slam if state.step == 22)
    ids = list(slam.landmarks)
    assert np.isfinite(slam.covariance(landmarks=ids)).all()
    with pytest.raises(OptionError, match="no particle has all of these landmarks"):
        slam.covariance(landmarks=ids, joint=True)
    assert np.isfinite(slam.covariance(landmarks=ids[:2], joint=True)).all()
