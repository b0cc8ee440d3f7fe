# %% setup
import matplotlib.pyplot as plt
import numpy as np

from graphslam import Graph, SensorModel, simulate, solve, textbook

log = simulate(seed=0, clean=True)  # the book's world and noise
sensor = SensorModel()
graph = Graph.from_log(log, edges="landmark+motion", sensor=sensor)

# %% jacobian
p, theta, m = np.array([1.0, 2.0]), 0.7, np.array([3.5, 1.0])
range_, phi = 2.7, -1.1


def R(angle):
    """The rotation by an angle."""
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def residual(p, theta, m):
    """The landmark in the axes of the robot, minus the sighting."""
    return R(theta).T @ (m - p) - range_ * np.array([np.cos(phi), np.sin(phi)])


h = 1e-6
numeric = (residual(p, theta + h, m) - residual(p, theta - h, m)) / (2 * h)
v = R(theta).T @ (m - p)
print("de/dtheta:", numeric.round(6), " formula (v_y, -v_x):", np.array([v[1], -v[0]]).round(6))
assert np.allclose(numeric, [v[1], -v[0]], atol=1e-8)

# %% information
z = np.array([range_, phi])
L = np.array([[np.cos(phi), -range_ * np.sin(phi)], [np.sin(phi), range_ * np.cos(phi)]])
Q = textbook.sighting_covariance(z, sensor)
x = np.array([*p, theta])
derivative = textbook.sighting_derivative(x, z)
difference = R(theta) @ L @ Q @ L.T @ R(theta).T - derivative @ Q @ derivative.T
print("R(theta) L Q L' R(theta)' - R Q R':", np.abs(difference).max())
assert np.allclose(difference, 0, atol=1e-12)

# %% matrix
system, _ = graph.linearize(graph.initial)
Omega = system.to_sparse().toarray()
poses = 3 * log.num_poses
used = np.flatnonzero(np.abs(Omega).sum(axis=0) > 0)
inside, outside = used[used < poses], used[used >= poses]
A, B, C = Omega[np.ix_(inside, inside)], Omega[np.ix_(inside, outside)], Omega[np.ix_(outside, outside)]
schur = A - B @ np.linalg.solve(C, B.T)  # the landmarks eliminated

fig, (left, right) = plt.subplots(1, 2, figsize=(8, 4))
left.spy(np.block([[A, B], [B.T, C]]), markersize=0.5)
left.set_title(f"landmark nodes: {np.count_nonzero(Omega):,} entries")
right.spy(np.abs(schur) > 1e-9, markersize=0.5)
right.set_title(f"landmarks eliminated: {np.count_nonzero(np.abs(schur) > 1e-9):,} entries")

# %% same
xi = system.xi.ravel()
whole = np.linalg.solve(Omega[np.ix_(used, used)], xi[used])
reduced = np.linalg.solve(schur, xi[inside] - B @ np.linalg.solve(C, xi[outside]))
print("largest difference of the corrections of the poses:", np.abs(whole[: len(inside)] - reduced).max())
assert np.allclose(whole[: len(inside)], reduced, atol=1e-9)

# %% count
for K in (10, 100, 1000):
    print(f"{K:5} sightings of a landmark: {K:5} edges to its node, {K * (K - 1) // 2:7} virtual-motion edges")

# %% solve
nodes, marginal = solve(graph), solve(Graph.from_log(log, sensor=sensor, weight="marginal"))
apart = np.abs(nodes.poses - marginal.poses)[:, :2].max()
print(f"J {nodes.cost:.4f} (nodes), {marginal.cost:.4f} (marginal), positions differ by {apart:.4f} m at most")
assert np.isclose(nodes.cost, marginal.cost) and apart < 1e-6

# %% newton
x, plain = graph.initial, []
for _ in range(8):
    system, _ = graph.linearize(x)
    step = system.factorize().solve(system.xi).reshape(x.shape)
    x = x + step
    plain.append(np.linalg.norm(step))
steps = solve(graph, initialize="given").step_norms
for name, norms in (("Gauss-Newton", plain), ("solve", steps)):
    print(f"{name:12}", *(f"{norm:.0e}" for norm in norms))
assert len(steps) <= 9 and steps[-1] < 1e-9 and plain[-1] > 1e-6


# %% order
def filled(order):
    """The number of entries of the Cholesky factor for an order of elimination."""
    return np.count_nonzero(np.abs(np.linalg.cholesky(Omega[np.ix_(order, order)])) > 1e-12)


print("poses first, landmarks last:", filled(used))
print("landmarks first, poses last:", filled(np.concatenate([outside, inside])))
assert 2 * filled(used) < filled(np.concatenate([outside, inside]))

# %% single
once = np.sort([np.flatnonzero(log.landmarks == j)[0] for j in np.unique(log.landmarks)])
reduced_log = log.replace(steps=log.steps[once], landmarks=log.landmarks[once], sightings=log.sightings[once])
with_once = solve(Graph.from_log(reduced_log, edges="landmark+motion", sensor=sensor))
moved = np.abs(with_once.poses - reduced_log.dead_reckoning())[:, :2].max()
print(f"every landmark seen once: J {with_once.cost:.1e}; the poses move by at most {moved:.1e} m")
assert with_once.cost < 1e-12 and moved < 1e-9

# %% by_hand
p, theta, m, z = np.array([1.0, 1.0]), np.pi / 2, np.array([1.0, 4.0]), np.array([2.8, 0.1])
right = R(theta).T @ (m - p) - z[0] * np.array([np.cos(z[1]), np.sin(z[1])])  # gap
np.testing.assert_allclose(right, [3 - 2.8 * np.cos(0.1), -2.8 * np.sin(0.1)], atol=1e-12)
print(np.round(right, 4))
ask(  # noqa: F821
    right,
    {
        ("Turn m - p into the axes of the robot", "m − pをロボットの座標系に回転させてください"): m
        - p
        - 2.8 * np.array([np.cos(0.1), np.sin(0.1)]),
    },
    unit="m",
)

# %% turning
v = R(theta).T @ (m - p)
right = np.array([v[1], -v[0]])  # gap
h = 1e-6
np.testing.assert_allclose(right, (R(theta + h).T @ (m - p) - R(theta - h).T @ (m - p)) / (2 * h), atol=1e-6)
print(np.round(right, 4) + 0.0)
ask(  # noqa: F821
    right,
    {
        ("That is v itself; its derivative is (v_y, -v_x)", "それはv自身です。微分は(v_y, −v_x)です"): v,
    },
    unit="m/rad",
)
