# %% setup
import matplotlib.pyplot as plt
import numpy as np

from graphslam import Graph, load, sample_log_path, solve

log = load(sample_log_path())
graph = Graph.from_log(log, edges="virtual+motion", weight="pairs", kernel="none")
best = solve(graph)

# %% trajectories
fig, ax = plt.subplots()
ax.plot(log.true_poses[:, 0], log.true_poses[:, 1], "k-", label="ground truth")
ax.plot(log.initial_poses[:, 0], log.initial_poses[:, 1], "C7--", label="initial values: dead reckoning")
ax.plot(best.poses[:, 0], best.poses[:, 1], "C0-", label="x*, the most probable trajectory")
places = np.array(list(best.landmarks.values()))
ax.plot(places[:, 0], places[:, 1], "C1*", ms=10, label="m*, the most probable map")
ax.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
ax.legend(fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)

# %% likely
bent = best.poses.copy()
bent[:, 1] += 0.02 * np.arange(len(bent))  # the same trajectory, shifted more and more to the left
candidates = {"dead reckoning": log.initial_poses, "x*, bent to the left": bent, "x*": best.poses}
for name, poses in candidates.items():
    print(f"{name:22} J = {graph.cost(poses):14.1f}")
assert graph.cost(best.poses) < graph.cost(bent) < graph.cost(log.initial_poses)

# %% count
poses, landmarks = log.num_poses - 1, len(log.landmark_ids)
print(f"unknown: {poses} poses and {landmarks} landmarks, {3 * (poses + landmarks)} numbers")
print(f"without the landmarks: {3 * poses} numbers")
print(f"measured: {log.controls.size + log.sightings.size} numbers")
assert log.controls.size + log.sightings.size > 3 * (poses + landmarks)

# %% strain
# ten poses on a circle with four landmarks: where each sighting puts its landmark, before and after the solution
from graphslam import simulate, textbook

landmarks = ((2.6, -2.4, 0.0), (2.2, 1.8, 0.0), (-2.4, 1.6, 0.0), (-2.2, -2.2, 0.0))
circle = {
    "steps": 9,
    "dt": 4.0,
    "speed": 0.35,
    "turn_rate": 2 * np.pi / 36,
    "start": (0.0, -2.0, 0.0),
    "max_range": 5.0,
}
loop = simulate(seed=25, landmarks=landmarks, clean=True, **circle)
loop_graph = Graph.from_log(loop, edges="virtual+motion", weight="pairs", kernel="none")
strained = {"dead reckoning": loop_graph.initial, "after the poses have moved": solve(loop_graph).poses}


def spring(a, b, turns=7, width=0.07):
    """A zigzag line from a to b."""
    along = np.linspace(0, 1, 2 * turns + 3)
    side = np.array([0, 0, *(width * (-1) ** np.arange(2 * turns - 1)), 0, 0])
    normal = np.array([a[1] - b[1], b[0] - a[0]]) / max(np.hypot(*(b - a)), 1e-9)
    return a + along[:, None] * (b - a) + side[:, None] * normal


fig, axes = plt.subplots(1, 2, figsize=(8.4, 4.7), sharex=True, sharey=True)
lengths = {}
for ax, (name, x) in zip(axes, strained.items()):
    places = np.array([textbook.inverse_observation(x[t], z)[:2] for t, z in zip(loop.steps, loop.sightings)])
    for j in np.unique(loop.landmarks):
        rows = np.flatnonzero(loop.landmarks == j)
        for k, a in enumerate(rows):
            for b in rows[k + 1 :]:
                ax.plot(*spring(places[a], places[b]).T, "C1", lw=0.5, alpha=0.6)
                lengths.setdefault(name, []).append(np.hypot(*(places[a] - places[b])))
    for t, place in zip(loop.steps, places):
        ax.plot(*np.array([x[t, :2], place]).T, "k:", lw=0.4)
    ax.plot(*places.T, "k.", ms=3)
    ax.quiver(*x[:, :2].T, np.cos(x[:, 2]), np.sin(x[:, 2]), color="C0", scale=18, width=0.008)
    ax.set(xlabel="x [m]", aspect="equal", title=f"{name}: J = {loop_graph.cost(x):.0f}")
axes[0].set_ylabel("y [m]")
means = {name: np.mean(values) for name, values in lengths.items()}
print("mean length of the springs [m]:", {name: round(float(value), 2) for name, value in means.items()})
assert means["after the poses have moved"] < 0.5 * means["dead reckoning"]

# %% three
from graphslam import load

three = load("examples/three_poses.txt")
print("controls (nu, omega):", np.round(three.controls, 4).tolist())
# 1 m straight ahead, and a quarter of a circle of the radius nu / omega = 1 m, in one second each
assert np.allclose(three.controls, [[1, 0], [np.pi / 2, np.pi / 2]], atol=1e-4) and np.allclose(three.dt, 1)
for t, (length, bearing, psi) in zip(three.steps, three.sightings):
    print(f"from pose {t}: range {length:.2f} m, bearing {bearing:.4f} rad, psi {psi:.4f} rad")

# %% unknowns
poses, landmarks = 5, 3  # the poses after the first; a landmark has three numbers, as a pose
right = [3 * (poses + landmarks), 3 * poses]
assert right == [24, 15]
print("with the map:", right[0], " trajectory alone:", right[1])
ask(  # noqa: F821
    right,
    {
        ("The first pose is known", "最初の姿勢は既知です"): [27, 18],
        (
            "A landmark has a heading here, so it has three numbers",
            "ここではランドマークにも向きがあるので、3つの数です",
        ): [21, 15],
    },
)

# %% straight
x = np.array([1.0, 2.0, np.pi / 2])
length = 0.5 * 4.0  # speed times time
right = x + [length * np.cos(x[2]), length * np.sin(x[2]), 0.0]  # gap
np.testing.assert_allclose(right, [1, 4, np.pi / 2])
print(np.round(right, 4))
ask(  # noqa: F821
    right,
    {
        (
            "The robot drives in the direction of its heading: pi/2 is the y axis",
            "ロボットは向きの方向に進みます。π/2はy軸の方向です",
        ): [3, 2, np.pi / 2],
        ("The distance is speed times time", "距離は速度×時間です"): [1, 2.5, np.pi / 2],
    },
    unit="m, m, rad",
)
