# %% setup
import matplotlib.pyplot as plt
import numpy as np

from graphslam import load, sample_log_path, simulate, textbook

log = load(sample_log_path())  # made by this project's simulator, with psi
print(log)

# %% raw
# dead reckoning, and where each sighting puts its landmark if dead reckoning is believed
fig, ax = plt.subplots(figsize=(6.4, 5))
ax.plot(log.initial_poses[:, 0], log.initial_poses[:, 1], "k.-", lw=0.8, label="dead reckoning")
for j in log.landmark_ids:
    rows = np.flatnonzero(log.landmarks == j)
    places = np.array([textbook.inverse_observation(log.initial_poses[log.steps[k]], log.sightings[k]) for k in rows])
    ax.plot(places[:, 0], places[:, 1], ".", ms=4)
    truth = log.true_landmarks[int(j)]
    ax.plot(truth[0], truth[1], "k*", ms=9)
ax.plot([], [], "k*", label="true landmarks")
ax.plot([], [], "C0.", label="sightings, one colour for each landmark")
ax.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
ax.legend(fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)

# %% psi
# a landmark with a heading of 0.6 rad, seen from two poses
landmark = np.array([2.0, 1.0, 0.6])
fig, ax = plt.subplots()
ax.plot(landmark[0], landmark[1], "k*", ms=12)
ax.annotate("", landmark[:2] + [np.cos(0.6), np.sin(0.6)], landmark[:2], arrowprops={"arrowstyle": "->", "lw": 2})
for pose, colour in ((np.array([0.0, 0.0, 0.3]), "C0"), (np.array([2.5, -1.2, 1.4]), "C1")):
    difference = landmark[:2] - pose[:2]
    direction = np.arctan2(difference[1], difference[0])
    length, phi, psi = np.hypot(*difference), direction - pose[2], direction - landmark[2]
    ax.plot(*pose[:2], "o", color=colour)
    ax.annotate(
        "",
        pose[:2] + 0.6 * np.array([np.cos(pose[2]), np.sin(pose[2])]),
        pose[:2],
        arrowprops={"arrowstyle": "->", "color": colour},
    )
    ax.plot(
        *np.column_stack([pose[:2], landmark[:2]]),
        ":",
        color=colour,
        label=f"l = {length:.2f} m, phi = {phi:.2f}, psi = {psi:.2f}",
    )
    print("h^-1:", np.round(textbook.inverse_observation(pose, np.array([length, phi, psi])), 6))
    assert np.allclose(textbook.inverse_observation(pose, np.array([length, phi, psi])), landmark)
ax.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
ax.legend()

# %% pairs
from itertools import combinations

by_landmark = {int(j): log.steps[log.landmarks == j].tolist() for j in log.landmark_ids}
for j, seen in list(by_landmark.items())[:3]:
    print(f"landmark {j}: seen {len(seen)} times, {len(list(combinations(seen, 2)))} virtual-motion edges")
pairs = sum(len(list(combinations(seen, 2))) for seen in by_landmark.values())
print("all:", pairs)
assert pairs == sum(len(seen) * (len(seen) - 1) // 2 for seen in by_landmark.values())

# %% three
three = load("examples/three_poses.txt")
places = [textbook.inverse_observation(three.initial_poses[t], z) for t, z in zip(three.steps, three.sightings)]
for t, place in zip(three.steps, places):
    print(f"from pose {t} the landmark is at", np.round(place, 4))
assert len(list(combinations(places, 2))) == 3
assert all(np.hypot(*(p - q)[:2]) > 0.05 for p, q in combinations(places, 2))

# %% spread
# how far apart are the places of one landmark, for dead reckoning and for the true poses?
medians = []
for name, poses in (("dead reckoning", log.initial_poses), ("true poses", log.true_poses)):
    spreads = []
    for j in log.landmark_ids:
        rows = np.flatnonzero(log.landmarks == j)
        places = np.array([textbook.inverse_observation(poses[log.steps[k]], log.sightings[k])[:2] for k in rows])
        spreads.append(np.sqrt(((places - places.mean(axis=0)) ** 2).sum(axis=1).mean()))
    medians.append(np.median(spreads))
    print(f"{name}: {medians[-1]:.2f} m")
assert medians[1] < medians[0] / 2

# %% more
counts = []
for steps in (20, 40, 80):
    short = simulate(seed=1, steps=steps)
    count = sum(np.sum(short.landmarks == j) * (np.sum(short.landmarks == j) - 1) // 2 for j in short.landmark_ids)
    counts.append((len(short.sightings), count))
    print(f"{steps} steps: {len(short.sightings)} sightings, {count} edges")
growth = [later[1] / earlier[1] / (later[0] / earlier[0]) ** 2 for earlier, later in zip(counts, counts[1:])]
assert all(0.75 < ratio < 1.25 for ratio in growth)

# %% sighted
from graphslam import SensorModel

pose, tag = np.array([1.0, 1.0, np.pi / 2]), np.array([3.0, 3.0, 0.0])
direction = np.arctan2(tag[1] - pose[1], tag[0] - pose[0])
right = [np.hypot(*(tag - pose)[:2]), direction - pose[2], direction - tag[2]]  # gap
np.testing.assert_allclose(right, SensorModel().h(pose, tag), atol=1e-12)
np.testing.assert_allclose(right, [np.sqrt(8), -np.pi / 4, np.pi / 4])
print(np.round(right, 4))
ask(  # noqa: F821
    right,
    {
        ("The bearing is relative to the heading of the robot", "φはロボットの向きを基準にした角度です"): [
            np.sqrt(8),
            np.pi / 4,
            np.pi / 4,
        ],
        ("psi is theta + phi - m_theta", "ψはθ + φ − m_θです"): [np.sqrt(8), -np.pi / 4, -np.pi / 4],
    },
    unit="m, rad, rad",
)

# %% twelve
K = 12
right = [K * (K - 1) / 2, K - 1]
assert right == [len(list(combinations(range(K), 2))), sum(0 in pair for pair in combinations(range(K), 2))]
print("edges:", right[0], " with one sighting:", right[1])
ask(  # noqa: F821
    right,
    {
        (
            "Each pair makes one edge, whatever the order of its sightings",
            "順序を入れ替えても同じ組なので、エッジは1本です",
        ): [132, 11],
        ("A sighting makes no pair with itself", "センサ値は自分自身とは組になりません"): [78, 12],
    },
)
