# %% setup
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Ellipse

from fastslam import textbook
from graphslam import MotionModel, SensorModel, simulate

log, motion, sensor = simulate(seed=3, steps=20, clean=True), MotionModel(), SensorModel()
rng = np.random.default_rng(0)

# %% one
particles = textbook.start(30, log.initial_poses[0])
for t in range(0, 9):
    if t > 0:
        textbook.motion_update(particles, log.controls[t - 1], log.dt[t - 1], motion, rng)
    seen = log.steps == t
    textbook.observation_update(particles, log.landmarks[seen].tolist(), log.sightings[seen], sensor)
particle = particles[0]
print("poses:", len(particle.path), " log weight:", round(particle.log_weight, 2), " landmarks:", sorted(particle.map))
print("landmark", min(particle.map), "mean", np.round(particle.map[min(particle.map)].mean, 2))


# %% figure
def draw_particle(ax, particle, colour):
    """The trajectory of a particle and its map, ellipses of two standard deviations."""
    path = np.array(particle.path)
    ax.plot(path[:, 0], path[:, 1], ".-", color=colour, lw=0.8)
    for landmark in particle.map.values():
        values, vectors = np.linalg.eigh(landmark.covariance[:2, :2])
        angle = np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1]))
        ax.add_patch(Ellipse(landmark.mean[:2], *(4 * np.sqrt(values[::-1])), angle=angle, fill=False, color=colour))


fig, axes = plt.subplots(1, 3, figsize=(8, 3.2), sharex=True, sharey=True)
for ax, particle, colour in zip(axes, particles, ("C0", "C1", "C2")):
    draw_particle(ax, particle, colour)
    for m in log.true_landmarks.values():
        ax.plot(m[0], m[1], "k*")
    ax.set(xlabel="x [m]", aspect="equal", title=f"weight {np.exp(particle.log_weight):.2g}")
axes[0].set_ylabel("y [m]")

# %% cloud
fig, ax = plt.subplots()
poses = np.tile(np.zeros(3), (300, 1))
for t in range(6):
    poses = np.array([textbook.sample_motion(p, (0.3, 0.15), 3.0, motion, rng.standard_normal(5)) for p in poses])
    ax.plot(poses[:, 0], poses[:, 1], ".", ms=2, label=f"after {3 * (t + 1)} s")
ax.plot(0, 0, "ko")
ax.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
ax.legend(fontsize=8)

# %% spread
spreads = []
for duration in (3, 6, 12):
    ends = np.array([np.zeros(3)] * 300)
    for _ in range(duration // 3):
        ends = np.array([textbook.sample_motion(p, (0.3, 0.0), 3.0, motion, rng.standard_normal(5)) for p in ends])
    ahead, aside = ends[:, 0].std(), ends[:, 1].std()
    spreads.append([ahead, aside])
    print(f"after {duration:2} s straight ahead: standard deviation {ahead:.3f} m ahead, {aside:.3f} m to the side")
growth = (np.array(spreads[2]) / spreads[0]) ** 2  # of the variances, over four times the time
assert 3 < growth[0] < 5.3 and growth[1] > 16

# %% history
# the last pose is all that later steps need of the trajectory
short = textbook.Particle([particles[0].pose], particles[0].log_weight, dict(particles[0].map))
z, j = log.sightings[log.steps == 8][0], int(log.landmarks[log.steps == 8][0])
full = textbook.update_landmark(particles[0].pose, particles[0].map[j], z, sensor)
again = textbook.update_landmark(short.pose, short.map[j], z, sensor)
print("the same map without the history:", np.array_equal(full.mean, again.mean))
assert np.array_equal(full.mean, again.mean)

# %% drawn
pose, drawn = np.array([0.0, 0.0, np.pi / 2]), np.array([0.35, 0.0])  # the control with its noise
right = motion.f(pose, drawn, 2.0)  # gap
np.testing.assert_allclose(right, [0, 0.7, np.pi / 2], atol=1e-9)
print(np.round(right, 4) + 0.0)
ask(  # noqa: F821
    right,
    {
        (
            "The particle moves by the control that was drawn, with its noise",
            "雑音を加えた制御指令で動かしてください",
        ): [0, 0.6, np.pi / 2],
        ("The particle moves in the direction of its heading", "パーティクルは向きの方向に進みます"): [
            0.7,
            0,
            np.pi / 2,
        ],
    },
    unit="m, m, rad",
)

# %% ahead
right = [np.sqrt(motion.covariance(np.zeros(3), np.array([0.3, 0.0]), seconds)[0, 0]) for seconds in (3.0, 12.0)]
np.testing.assert_allclose(right, 0.19 * np.sqrt([0.9, 3.6]), rtol=2e-3)
print(np.round(right, 4))
ask(  # noqa: F821
    right,
    {
        (
            "The variance grows in proportion to the distance, not the standard deviation",
            "距離に比例するのは分散で、標準偏差ではありません",
        ): [0.19 * 0.9, 0.19 * 3.6],
        (
            "Four times the distance makes four times the variance, so twice the standard deviation",
            "距離が4倍なら分散が4倍、標準偏差は2倍です",
        ): [right[0], 4 * right[0]],
        ("These are variances", "それは分散です"): np.square(right),
    },
    unit="m",
)
