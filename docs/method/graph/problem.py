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
ax.legend(fontsize=8)

# %% likely
bent = best.poses.copy()
bent[:, 1] += 0.02 * np.arange(len(bent))  # the same trajectory, shifted more and more to the left
candidates = {"dead reckoning": log.initial_poses, "x*, bent to the left": bent, "x*": best.poses}
for name, poses in candidates.items():
    print(f"{name:22} J = {graph.cost(poses):14.1f}")

# %% count
poses, landmarks = log.num_poses - 1, len(log.landmark_ids)
print(f"unknown: {poses} poses and {landmarks} landmarks, {3 * (poses + landmarks)} numbers")
print(f"without the landmarks: {3 * poses} numbers")
print(f"measured: {log.controls.size + log.sightings.size} numbers")

# %% three
from graphslam import load

three = load("examples/three_poses.txt")
print("controls (nu, omega):", np.round(three.controls, 4).tolist())
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
