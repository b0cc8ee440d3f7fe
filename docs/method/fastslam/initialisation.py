# %% setup
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Ellipse

from fastslam import textbook
from graphslam import MotionModel, SensorModel, simulate

sensor, motion = SensorModel(), MotionModel()
log = simulate(seed=3, steps=30, clean=True)

# %% covariance
pose, z = np.array([0.0, 0.0, 0.4]), np.array([3.0, 0.3, 0.2])
first = textbook.initialize_landmark(pose, z, sensor)
R = np.array([[np.cos(0.7), -3.0 * np.sin(0.7), 0], [np.sin(0.7), 3.0 * np.cos(0.7), 0], [0, 1, -1]])
print("mean:", np.round(first.mean, 3))
print("(H' Q^-1 H)^-1 = R Q R':", np.allclose(first.covariance, R @ sensor.Q(z) @ R.T))
assert np.allclose(first.covariance, R @ sensor.Q(z) @ R.T)

# %% film
# no weights, no resampling: every particle keeps its own map, and they drift apart
rng = np.random.default_rng(0)
particles = textbook.start(20, log.initial_poses[0])
states = {}
for t in range(log.num_poses):
    if t > 0:
        textbook.motion_update(particles, log.controls[t - 1], log.dt[t - 1], motion, rng)
    sighted = list(zip(log.landmarks[log.steps == t].tolist(), log.sightings[log.steps == t]))
    for particle in particles:
        textbook.weigh_and_map(particle, sighted, sensor)  # the weights are computed and not used
    if t % 5 == 0:
        states[t] = ([np.array(p.path) for p in particles[:6]], dict(particles[0].map))


def draw(step):
    """The trajectories of six particles and the map of the first."""
    paths, landmarks = states[step]
    _, ax = plt.subplots(figsize=(5, 5))
    for k, path in enumerate(paths):
        ax.plot(path[:, 0], path[:, 1], "C0-" if k == 0 else "C7-", lw=1.5 if k == 0 else 0.5)
    for landmark in landmarks.values():
        values, vectors = np.linalg.eigh(landmark.covariance[:2, :2])
        angle = np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1]))
        ax.add_patch(Ellipse(landmark.mean[:2], *(4 * np.sqrt(values[::-1])), angle=angle, fill=False, color="C0"))
    for m in log.true_landmarks.values():
        ax.plot(m[0], m[1], "k*")
    ax.set(xlim=(-6.5, 6.5), ylim=(-8, 5), xlabel="x [m]", ylabel="y [m]", aspect="equal")


slider("step", list(states), draw)  # noqa: F821  # given by the site: one figure for each value

# %% errors
error = [np.hypot(*(p.map[j].mean - m)[:2]) for p in particles for j, m in log.true_landmarks.items() if j in p.map]
print(f"landmarks of all particles: {np.mean(error):.2f} m off on average, without weights")
assert np.mean(error) > 2

# %% distance
for length in (0.5, 2.0, 8.0):
    std = np.sqrt(
        np.linalg.eigvalsh(
            textbook.initialize_landmark(np.zeros(3), np.array([length, 0.0, 0.0]), sensor).covariance[:2, :2]
        )
    )
    print(f"{length} m away: {std.max():.3f} m along the line of sight, {std.min():.3f} m across")
    assert np.isclose(std.max(), 0.14 * length) and np.isclose(std.min(), 0.05 * length)

# %% place
pose, z = np.array([1.0, 1.0, np.pi / 2]), np.array([2.0, -np.pi / 2, 0.0])
right = textbook.initialize_landmark(pose, z, sensor).mean[:2]  # gap
np.testing.assert_allclose(right, [3, 1], atol=1e-12)
print(np.round(right, 4))
ask(  # noqa: F821
    right,
    {
        ("Add the heading of the particle to the bearing", "φにパーティクルの向きを足してください"): [1, -1],
        ("Add the position of the particle", "パーティクルの位置を足してください"): [2, 0],
    },
    unit="m",
)

# %% slanted
pose, z = np.array([0.0, 0.0, np.pi / 4]), np.array([1.0, 0.0, 0.0])
right = textbook.initialize_landmark(pose, z, sensor).covariance[:2, :2]  # gap
np.testing.assert_allclose(right, [[0.01105, 0.00855], [0.00855, 0.01105]], atol=1e-9)
print(np.round(right, 5))
ask(  # noqa: F821
    right,
    {
        (
            "That is the covariance in the axes of the line of sight; turn it by 45 degrees",
            "それは視線方向を軸とした共分散です。45度回転させてください",
        ): np.diag([0.0196, 0.0025]),
    },
)
