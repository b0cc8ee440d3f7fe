# %% setup
import matplotlib.pyplot as plt
import numpy as np

from graphslam import Graph, SensorModel, simulate, solve, textbook
from graphslam.se2 import wrap

log = simulate(seed=0, clean=True)  # the book's world; the noise follows the models
sensor = SensorModel()


# %% split
def turn(angle):
    """D: rotate x and y, keep the heading."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def landmark_axes(z):
    """L: the derivative R in the axes of the landmark, from which the sighting comes from direction psi."""
    c, s = np.cos(z[2]), np.sin(z[2])
    return np.array([[c, -z[0] * s, 0], [s, z[0] * c, 0], [0, 1, -1]])


x, z = np.array([1.0, 2.0, 0.7]), np.array([3.0, -0.4, 1.9])
gamma = x[2] + z[1] - z[2]
print(np.abs(textbook.sighting_derivative(x, z) - turn(gamma) @ landmark_axes(z)).max())
assert np.allclose(textbook.sighting_derivative(x, z), turn(gamma) @ landmark_axes(z), atol=1e-12)

# %% steps
anchored = {frame: Graph.from_log(log, edges="virtual", frame=frame) for frame in ("world", "body")}


def plain_steps(graph, count):
    """Norms of the corrections of Omega Delta = xi, repeated without any acceleration."""
    state, norms = graph.initial.copy(), []
    for _ in range(count):
        system, _ = graph.linearize(state)
        delta = np.linalg.solve(system.to_sparse().toarray(), system.xi.ravel()).reshape(-1, 3)
        state = state + delta
        state[:, 2] = wrap(state[:, 2])
        norms.append(np.linalg.norm(delta))
    return norms


norms = {"the lectures' program": textbook.solve(log, threshold=1e-9, max_iterations=12).step_norms}
norms["world frame, anchor in xi"] = plain_steps(anchored["world"], 30)
norms["body frame"] = plain_steps(anchored["body"], 12)
for name, values in norms.items():
    print(f"{name:26}", " ".join(f"{value:.0e}" for value in values[1::2][:6]))

fig, ax = plt.subplots()
for (name, values), line in zip(norms.items(), ("o-", "s--", "^-"), strict=True):
    ax.semilogy(range(1, len(values) + 1), values, line, ms=4, label=name)
ax.set(xlabel="iteration", ylabel="norm of the correction", ylim=(1e-12, 1e2))
ax.legend()
assert norms["body frame"][9] < 1e-2 * norms["body frame"][7]
assert norms["world frame, anchor in xi"][29] > 0.5 * norms["world frame, anchor in xi"][28]

# %% gradient
ends = {frame: solve(graph).state for frame, graph in anchored.items()}


def slope(graph, state, h=1e-5):
    """The largest derivative of J by a heading, with Omega re-evaluated along the way."""
    derivatives = []
    for node in range(1, len(state)):
        step = np.zeros_like(state)
        step[node, 2] = h
        derivatives.append((graph.cost(state + step) - graph.cost(state - step)) / (2 * h))
    return np.abs(derivatives).max()


for frame, graph in anchored.items():
    print(f"{frame}: largest dJ/dtheta at the end of the iteration {slope(graph, ends[frame]):.1e}")
assert slope(anchored["body"], ends["body"]) < 1e-5 < slope(anchored["world"], ends["world"])

# %% rotated
state = solve(anchored["body"]).state
rotated = state @ turn(0.5).T + [0, 0, 0.5]
sightings = next(family for family in anchored["body"].families if hasattr(family, "sightings"))
print("before:", sightings.cost(state, state), " after:", sightings.cost(rotated, rotated))
assert np.isclose(sightings.cost(state, state), sightings.cost(rotated, rotated), rtol=1e-12)

# %% accelerated
for frame, graph in anchored.items():
    steps = solve(graph, initialize="given").iterations
    print(frame, steps, "steps with Anderson acceleration where it is needed")
    # without it, the world frame is far from its end after thirty
    assert steps < 20 and norms["world frame, anchor in xi"][29] > 1e-6

# %% constant
from graphslam.textbook import sighting_covariance

moved = x + [0.5, -1.0, 0.9]  # the same sighting from another pose
for name, pose in (("first pose", x), ("moved pose", moved)):
    R = textbook.sighting_derivative(pose, z)
    print(f"{name}: R Q R' =", (R @ sighting_covariance(z, sensor) @ R.T)[0, :2].round(4), "(first row)")
L = landmark_axes(z)
print("either pose: L Q L' =", (L @ sighting_covariance(z, sensor) @ L.T)[0, :2].round(4))
assert not np.allclose(*(textbook.sighting_derivative(pose, z)[:2, 0] for pose in (x, moved)))

# %% apart
difference = ends["world"] - ends["body"]
print("the two ends differ by at most", np.abs(difference[:, :2]).max().round(4), "m")
for frame, graph in anchored.items():
    print(f"J of the {frame} frame:", {name: round(graph.cost(end), 3) for name, end in ends.items()})
assert all(graph.cost(ends["body"]) < graph.cost(ends["world"]) for graph in anchored.values())

# %% axes_of_landmark
sight = np.array([2.0, 0.3, np.pi / 2])
right = landmark_axes(sight)  # gap
np.testing.assert_allclose(right, [[0, -2, 0], [1, 0, 0], [0, 1, -1]], atol=1e-12)
print(np.round(right, 3) + 0.0)
ask(  # noqa: F821
    right,
    {
        (
            "In the axes of the landmark the line of sight has the direction psi, not phi",
            "ランドマークの座標系では、視線の方向はφではなくψです",
        ): [[np.cos(0.3), -2 * np.sin(0.3), 0], [np.sin(0.3), 2 * np.cos(0.3), 0], [0, 1, -1]],
    },
)

# %% turned_residual
e, gamma_1 = np.array([0.3, 0.1, 0.05]), np.pi / 2
right = turn(gamma_1).T @ e  # gap
np.testing.assert_allclose(right, [0.1, -0.3, 0.05], atol=1e-12)
print(np.round(right, 4))
ask(  # noqa: F821
    right,
    {
        ("Turn the other way: D is transposed", "回転が逆です。Dは転置します"): turn(gamma_1) @ e,
    },
    unit="m, m, rad",
)
