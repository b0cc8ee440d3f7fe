# %% setup
import matplotlib.pyplot as plt
import numpy as np

from fastslam import FastSLAM1, textbook
from graphslam import simulate

log = simulate(seed=3, steps=40, clean=True)
rng = np.random.default_rng(0)

# %% run
states = {}
for t, particles in enumerate(textbook.fastslam1(log, particles=40, rng=rng)):
    if t and t % 8 == 0:
        best = max(particles, key=lambda p: p.log_weight)
        states[t] = ([np.array(p.path) for p in particles], {j: m.mean for j, m in best.map.items()})


def draw(step):
    """All trajectories after resampling, and the map of the best particle."""
    paths, landmarks = states[step]
    _, ax = plt.subplots(figsize=(5, 5))
    for path in paths:
        ax.plot(path[:, 0], path[:, 1], "C0-", lw=0.6, alpha=0.5)
    ax.plot(log.true_poses[: step + 1, 0], log.true_poses[: step + 1, 1], "k--", lw=0.8)
    for m in landmarks.values():
        ax.plot(m[0], m[1], "C1o")
    for m in log.true_landmarks.values():
        ax.plot(m[0], m[1], "k*")
    ax.set(xlim=(-6, 6), ylim=(-6, 6), xlabel="x [m]", ylabel="y [m]", aspect="equal")


slider("step", list(states), draw)  # noqa: F821  # given by the site: one figure for each value

# %% copies
weights = np.array([0.5, 0.3, 0.15, 0.05])
particles = [textbook.Particle([np.zeros(3)], float(np.log(w)), {}) for w in weights]
for k, particle in enumerate(particles):
    particle.path[0] = np.array([float(k), 0.0, 0.0])
counts = np.zeros(4)
for seed in range(2000):
    for survivor in textbook.resample(particles, np.random.default_rng(seed)):
        counts[int(survivor.pose[0])] += 1
assert np.allclose(counts / counts.sum(), weights, atol=0.005)
print("share of the copies:", np.round(counts / counts.sum(), 3), " weights:", weights)

# %% ess
sizes = []
for w in ([0.25] * 4, [0.5, 0.3, 0.15, 0.05], [0.97, 0.01, 0.01, 0.01]):
    particles = [textbook.Particle([np.zeros(3)], float(np.log(v)), {}) for v in w]
    sizes.append(textbook.effective_sample_size(particles))
    print(w, "effective sample size", round(sizes[-1], 2))
assert np.isclose(sizes[0], 4) and 1 < sizes[2] < 1.1

# %% number
from graphslam.metrics import ate

medians = {}
for count in (10, 100, 1000, 10_000):
    errors = [ate(log.true_poses, FastSLAM1(log, particles=count, seed=s).run().poses) for s in range(5)]
    medians[count] = np.median(errors)
    print(f"{count:6} particles: trajectory error {medians[count]:.3f} m (median of five runs)")
assert medians[1000] < 0.75 * medians[100]
assert medians[10_000] > 0.9 * medians[1000]

# %% copies_of_four
sums = np.cumsum([0.5, 0.3, 0.15, 0.05])
positions = 0.1 + 0.25 * np.arange(4)
right = np.bincount(np.searchsorted(sums, positions), minlength=4)  # gap
assert right.tolist() == [2, 1, 1, 0]
print("positions", positions.round(2), " copies", right)
ask(  # noqa: F821
    right,
    {
        (
            "These are the mean numbers of copies; with this offset the numbers are whole",
            "それは平均の個数です。オフセットが決まれば整数になります",
        ): [2, 1.2, 0.6, 0.2],
    },
    within=0.001,
)

# %% effective
w = np.array([0.4, 0.4, 0.1, 0.1])
right = 1 / np.sum(w**2)  # gap
np.testing.assert_allclose(
    right, textbook.effective_sample_size([textbook.Particle([np.zeros(3)], float(np.log(v)), {}) for v in w])
)
print("effective sample size:", round(right, 3))
ask(  # noqa: F821
    right,
    {
        (
            "That is the number of particles; their weights differ",
            "それはパーティクルの数です。重みは等しくありません",
        ): 4
    },
)
