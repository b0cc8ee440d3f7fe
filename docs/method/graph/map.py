# %% setup
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Ellipse

from graphslam import SensorModel, simulate, textbook

log = simulate(seed=3, clean=True)
solution = textbook.solve(log, edges="virtual+motion")
sensor = SensorModel()

# %% map
for j, m in solution.landmarks.items():
    print(
        f"landmark {j}: ({m[0]:6.2f}, {m[1]:6.2f}), true ({log.true_landmarks[j][0]:6.2f}, {log.true_landmarks[j][1]:6.2f})"
    )
    assert np.hypot(*(m - log.true_landmarks[j])[:2]) < 0.5

# %% figure
j = max(solution.landmarks, key=lambda j: np.sum(log.landmarks == j))
fig, ax = plt.subplots()
for t, z in zip(log.steps[log.landmarks == j], log.sightings[log.landmarks == j]):
    x = solution.poses[t]
    R = textbook.sighting_derivative(x, z)
    C = R @ textbook.sighting_covariance(z, sensor) @ R.T
    values, vectors = np.linalg.eigh(C[:2, :2])
    angle = np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1]))
    place = textbook.inverse_observation(x, z)
    ax.add_patch(Ellipse(place[:2], *(2 * np.sqrt(values[::-1])), angle=angle, fill=False, color="C1", lw=0.8))
    ax.plot(place[0], place[1], "C1.", ms=4)
ax.plot(*solution.landmarks[j][:2], "C0*", ms=14, label="m*, the weighted mean")
ax.plot(*log.true_landmarks[j][:2], "k+", ms=14, label="true landmark")
ax.plot([], [], "C1-", label="sightings, one standard deviation")
ax.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
ax.legend(fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0))

# %% three
from graphslam import load

three = load("examples/three_poses.txt")
solution_3 = textbook.solve(three, edges="virtual", threshold=1e-9)
places_3 = np.array([textbook.inverse_observation(x_3, z_3) for x_3, z_3 in zip(solution_3.poses, three.sightings)])
print(np.round(places_3, 4))
print("m* =", np.round(solution_3.landmarks[1][:2], 4))
assert np.ptp(places_3, axis=0).max() < 1e-9

# %% mean
weighted, plain = [], []
for j in solution.landmarks:
    rows = np.flatnonzero(log.landmarks == j)
    places = [textbook.inverse_observation(log.true_poses[log.steps[k]], log.sightings[k]) for k in rows]
    best = textbook.solve_map([(log.true_poses[log.steps[k]], log.sightings[k]) for k in rows], sensor)
    truth = log.true_landmarks[j]
    weighted.append(np.hypot(*(best[:2] - truth[:2])))
    plain.append(np.hypot(*(np.mean(places, axis=0)[:2] - truth[:2])))
assert np.mean(weighted) < 0.6 * np.mean(plain)
print(f"on the true poses: weighted mean {np.mean(weighted):.3f} m off, plain mean {np.mean(plain):.3f} m off")

# %% minimum
rows = np.flatnonzero(log.landmarks == j)
sightings = [(solution.poses[log.steps[k]], log.sightings[k]) for k in rows]


def cost(m):
    """Sum of (m - h^-1)' Omega (m - h^-1) over the sightings, positions only."""
    total = 0.0
    for x, z in sightings:
        e = m[:2] - textbook.inverse_observation(x, z[:2])
        R = textbook.sighting_derivative(x, z[:2])
        total += e @ np.linalg.inv(R @ textbook.sighting_covariance(z[:2], sensor) @ R.T) @ e
    return total


Omegas = [
    np.linalg.inv(R @ textbook.sighting_covariance(z[:2], sensor) @ R.T)
    for x, z in sightings
    for R in [textbook.sighting_derivative(x, z[:2])]
]
best = np.linalg.solve(
    sum(Omegas), sum(W @ textbook.inverse_observation(x, z[:2]) for W, (x, z) in zip(Omegas, sightings))
)
rng = np.random.default_rng(0)
print(
    "J(m*) =",
    round(cost(best), 3),
    " smaller than at 1000 places around it:",
    all(cost(best + d) > cost(best) for d in rng.normal(0, 0.1, (1000, 2))),
)
assert all(cost(best + d) > cost(best) for d in rng.normal(0, 0.1, (1000, 2)))

# %% two
places, stds = np.array([2.0, 2.6]), np.array([0.1, 0.2])
Omega = 1 / stds**2
right = [Omega @ places / Omega.sum(), np.sqrt(1 / Omega.sum())]  # gap
np.testing.assert_allclose(right, [(100 * 2 + 25 * 2.6) / 125, 1 / np.sqrt(125)])
print(np.round(right, 4))
ask(  # noqa: F821
    right,
    {
        (
            "That is the plain mean; the finer sighting counts more",
            "それは単純な平均です。精度の高いセンサ値の重みを大きくしてください",
        ): [2.3, right[1]],
        (
            "The weights are the inverse variances, not the inverse standard deviations",
            "重みは標準偏差ではなく分散の逆数です",
        ): [2.2, right[1]],
        ("The weights are exchanged", "重みが逆です"): [2.48, right[1]],
        ("The mean of both is more certain than either", "2つを合わせると、どちらの値よりも確かになります"): [
            right[0],
            0.1,
        ],
        ("That is the variance", "それは分散です"): [right[0], 1 / 125],
    },
    unit="m",
)

# %% crossed
places = np.array([[2.0, 0.0], [2.2, 0.1]])
# both from 2 m; the first line of sight points along x, the second along y
Omegas = [np.diag([1 / 0.28**2, 1 / 0.1**2]), np.diag([1 / 0.1**2, 1 / 0.28**2])]
right = np.linalg.solve(sum(Omegas), sum(W @ y for W, y in zip(Omegas, places)))  # gap
np.testing.assert_allclose(right[0], (2 / 0.0784 + 2.2 / 0.01) / (1 / 0.0784 + 1 / 0.01))
print(np.round(right, 4))
ask(  # noqa: F821
    right,
    {
        ("That is the mean without weights", "それは重みのない平均です"): places.mean(axis=0),
        (
            "A sighting is precise across its line of sight, not along it",
            "センサ値が正確なのは視線の方向ではなく、それと垂直な方向です",
        ): np.linalg.solve(sum(Omegas), sum(W @ y for W, y in zip(Omegas[::-1], places))),
    },
    unit="m",
)
