# %% setup
import matplotlib.pyplot as plt
import numpy as np

from fastslam import textbook
from graphslam import MotionModel, SensorModel, simulate

log, motion, sensor = simulate(seed=3, steps=20, clean=True), MotionModel(), SensorModel()

# %% figure
# the belief about the position, before and after a sighting
rng = np.random.default_rng(0)
particles = textbook.start(150, log.initial_poses[0])
textbook.observation_update(particles, log.landmarks[log.steps == 0].tolist(), log.sightings[log.steps == 0], sensor)
fig, ax = plt.subplots()
for t in range(1, 9):
    textbook.motion_update(particles, log.controls[t - 1], log.dt[t - 1], motion, rng)
    seen = log.steps == t
    before = np.array([p.pose[:2] for p in particles])
    textbook.observation_update(particles, log.landmarks[seen].tolist(), log.sightings[seen], sensor)
weights = np.exp([p.log_weight for p in particles])
ax.scatter(before[:, 0], before[:, 1], s=4 + 2000 * weights, alpha=0.5, label="particles, area by weight")
ax.plot(*log.true_poses[8, :2], "k+", ms=14, label="true position")
ax.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
ax.margins(0.1)
ax.legend(fontsize=8, markerscale=0.3, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)

# %% bayes
# Bayes' theorem on a grid: a landmark on a line, one range of 2.0 m with a standard deviation of 0.28 m
m = np.linspace(0, 4, 401)
prior = np.exp(-0.5 * ((m - 2.5) / 0.5) ** 2)
likelihood = np.exp(-0.5 * ((2.0 - m) / 0.28) ** 2)
posterior = prior * likelihood
posterior /= posterior.sum()
mean = (m * posterior).sum()
print(f"posterior mean {mean:.3f}, Kalman filter {2.5 + 0.25 / (0.25 + 0.0784) * (2.0 - 2.5):.3f}")
assert np.isclose(mean, 2.5 + 0.25 / (0.25 + 0.0784) * (2.0 - 2.5), atol=1e-3)

# %% order
# sightings of one step can be processed in any order, because each multiplies the belief by its likelihood
start = textbook.initialize_landmark(np.zeros(3), np.array([2.0, 0.1, 0.0]), sensor)
z1, z2 = np.array([2.1, 0.12, 0.02]), np.array([1.9, 0.05, -0.01])
ab = textbook.update_landmark(np.zeros(3), textbook.update_landmark(np.zeros(3), start, z1, sensor), z2, sensor)
ba = textbook.update_landmark(np.zeros(3), textbook.update_landmark(np.zeros(3), start, z2, sensor), z1, sensor)
print("means:", np.round(ab.mean, 3), np.round(ba.mean, 3))
assert np.allclose(ab.mean, ba.mean, atol=0.01) and not np.array_equal(ab.mean, ba.mean)

# %% two_places
prior, likelihood = np.array([0.6, 0.4]), np.array([0.2, 0.5])
right = prior * likelihood / (prior @ likelihood)  # gap
np.testing.assert_allclose(right, [0.375, 0.625])
print(right)
ask(  # noqa: F821
    right,
    {("Normalise: the two probabilities have the sum 1", "和が1になるように正規化してください"): prior * likelihood},
)

# %% gaussians
mean, variance, measured, noise = 4.0, 0.09, 4.6, 0.18
right = [(mean / variance + measured / noise) / (1 / variance + 1 / noise), 1 / (1 / variance + 1 / noise)]  # gap
np.testing.assert_allclose(right, [4.2, 0.06])
print(np.round(right, 4))
ask(  # noqa: F821
    right,
    {
        (
            "The weights are exchanged: the smaller variance counts more",
            "重みが逆です。分散が小さいほうの重みを大きくしてください",
        ): [4.4, 0.06],
        ("That is the plain mean", "それは単純な平均です"): [4.3, 0.06],
        ("That is the standard deviation", "それは標準偏差です"): [4.2, np.sqrt(0.06)],
        ("The informations add, not the variances", "足すのは分散ではなく、その逆数です"): [4.2, 0.27],
    },
)
