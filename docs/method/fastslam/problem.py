# %% setup
import matplotlib.pyplot as plt
import numpy as np

from graphslam import MotionModel, SensorModel, simulate

log = simulate(seed=3, steps=20, clean=True)  # the book's world
sensor = SensorModel()

# %% naive
# move by the control, write what is seen onto the map, and never correct either
from graphslam import textbook as graph_textbook

drive = simulate(seed=3, clean=True)
pose, naive, written = drive.initial_poses[0], [drive.initial_poses[0]], {}
for t in range(drive.num_poses):
    if t > 0:
        pose = MotionModel().f(pose, drive.controls[t - 1], drive.dt[t - 1])
        naive.append(pose)
    for j, z in zip(drive.landmarks[drive.steps == t], drive.sightings[drive.steps == t]):
        written.setdefault(int(j), []).append(graph_textbook.inverse_observation(pose, z)[:2])
naive = np.array(naive)
fig, axes = plt.subplots(1, 2, figsize=(8.4, 4.2), sharex=True, sharey=True)
for ax, last, name in ((axes[0], 4, "after 4 motions"), (axes[1], drive.num_poses - 1, "after 62 motions")):
    ax.plot(*drive.true_poses[: last + 1, :2].T, "k--", lw=0.8, label="ground truth")
    ax.plot(*naive[: last + 1, :2].T, "C0", lw=1, label="naive trajectory")
    for j, places in written.items():
        count = int(np.sum((drive.landmarks == j) & (drive.steps <= last)))
        ax.plot(*np.array(places[:count]).reshape(-1, 2).T, ".", color=f"C{j + 1}", ms=4)
        ax.plot(*drive.true_landmarks[j][:2], "k*", ms=9)
    ax.set(xlabel="x [m]", aspect="equal", title=name)
axes[0].set_ylabel("y [m]")
axes[0].legend(fontsize=8, loc="lower left")
away = np.hypot(*(naive - drive.true_poses)[:, :2].T)
print(f"error of the position: {away[4]:.2f} m after 4 motions, at most {away.max():.2f} m in {drive.num_poses - 1}")
spread = [np.ptp(places, axis=0).max() for places in written.values()]
print(f"one landmark is written onto places that are up to {max(spread):.1f} m apart")
assert drive.num_poses == 63
assert away[4] < 0.3 * away.max()
assert max(spread) > 5

# %% independent
# one landmark seen from a known pose, another one, too: with the pose known, their errors have nothing in common
rng = np.random.default_rng(0)
known, unknown = [], []
for _ in range(2000):
    noise = rng.standard_normal((2, 3)) * [0.14 * 2.0, 0.05, 0.05]
    turn = rng.normal(0, 0.2)  # the uncertainty of the heading
    a, b = np.array([2.0, 0.4, 0.0]) + noise[0], np.array([2.0, -0.4, 0.0]) + noise[1]
    known.append([sensor.h_inverse(np.zeros(3), a)[1], sensor.h_inverse(np.zeros(3), b)[1]])
    unknown.append([sensor.h_inverse(np.array([0, 0, turn]), a)[1], sensor.h_inverse(np.array([0, 0, turn]), b)[1]])
known, unknown = np.array(known), np.array(unknown)
print(f"correlation of the two landmarks, pose known:        {abs(np.corrcoef(known.T)[0, 1]):.2f}")
print(f"correlation of the two landmarks, heading uncertain: {np.corrcoef(unknown.T)[0, 1]:.2f}")
assert abs(np.corrcoef(known.T)[0, 1]) < 5 / np.sqrt(2000) and np.corrcoef(unknown.T)[0, 1] > 0.8

# %% figure
fig, axes = plt.subplots(1, 2, figsize=(7, 3.4), sharex=True, sharey=True)
for ax, places, name in ((axes[0], known, "pose known"), (axes[1], unknown, "heading uncertain")):
    ax.plot(places[:, 0], places[:, 1], "C0.", ms=2)
    ax.set(title=name, xlabel="y of landmark 1 [m]")
axes[0].set_ylabel("y of landmark 2 [m]")

# %% numbers
landmarks = 6
for steps in (10, 60):
    joint = 3 * steps + 2 * landmarks
    print(f"{steps} steps, {landmarks} landmarks: one Gaussian has {joint * (joint + 1) // 2 + joint} numbers,")
    print(f"    a particle {3 * steps} for the trajectory and {landmarks * 5} for the map")

# %% average
# Rao-Blackwell: replacing a sampled quantity by its mean given the others never makes an estimate worse
rng = np.random.default_rng(1)
sampled, exact = [], []
for _ in range(400):
    x = rng.standard_normal(50)  # particles of the trajectory
    m = 0.8 * x + 0.6 * rng.standard_normal(50)  # and of the landmark given the trajectory
    sampled.append(m.mean())
    exact.append((0.8 * x).mean())  # the mean of the landmark given the trajectory
print(
    f"standard deviation of the estimate: landmark sampled {np.std(sampled):.3f}, landmark computed {np.std(exact):.3f}"
)
assert np.std(exact) < np.std(sampled)

# %% size
N, marks = 100, 8
one = (
    3 + 1 + marks * (2 + 3)
)  # pose, weight, and for each landmark the mean and the three different entries of the covariance
right = [one, N * one]
assert right == [44, 4400]
print("one particle:", right[0], " all:", right[1])
ask(  # noqa: F821
    right,
    {
        (
            "A covariance is symmetric: three numbers for each landmark",
            "共分散行列は対称なので、ランドマークごとに3つの数です",
        ): [52, 5200],
        ("The weight is a number, too", "重みも1つの数です"): [43, 4300],
    },
)

# %% shared
distance, heading_std, across_std = 3.0, 0.1, 0.15
common = (distance * heading_std) ** 2  # both landmarks move by the same turn
right = common / (common + across_std**2)  # gap
np.testing.assert_allclose(right, 0.8)
print("correlation:", round(right, 4))
ask(  # noqa: F821
    right,
    {
        ("That is the correlation if the pose is known", "それは姿勢が既知の場合の相関です"): 0.0,
        ("Use variances, not standard deviations", "標準偏差ではなく分散を使ってください"): 0.3 / 0.45,
    },
)
