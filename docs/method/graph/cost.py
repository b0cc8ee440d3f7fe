# %% setup
import matplotlib.pyplot as plt
import numpy as np

from graphslam import Graph, SensorModel, load, sample_log_path, solve, textbook

log = load(sample_log_path())
sensor = SensorModel()

# %% ellipses
# which residuals (x, y) have the same cost? one edge with a distant landmark, one with a near one
fig, ax = plt.subplots()
angle = np.linspace(0, 2 * np.pi, 200)
for length, colour in ((4.0, "C0"), (1.0, "C1")):
    z = np.array([length, 0.3, 0.0])
    _, Omega, *_ = textbook.virtual_motion_edge(np.zeros(3), z, np.array([0.5, 0.0, 0.2]), z, sensor)
    Omega_xy = np.linalg.inv(np.linalg.inv(Omega)[:2, :2])
    root = np.linalg.cholesky(np.linalg.inv(Omega_xy))
    for distance in (1, 2, 3):
        x, y = distance * root @ np.array([np.cos(angle), np.sin(angle)])
        ax.plot(x, y, colour, label=f"landmark {length:g} m away" if distance == 1 else None)
ax.plot(*(0.3, 0.0), "ko")
ax.annotate("the same residual, 0.3 m", (0.3, 0.0), (0.5, -0.6), arrowprops={"arrowstyle": "->"})
ax.set(xlabel="residual in x [m]", ylabel="residual in y [m]", aspect="equal")
ax.legend()

# %% distances
e, squares = np.array([0.3, 0.0, 0.0]), []
for length in (4.0, 1.0):
    z = np.array([length, 0.3, 0.0])
    _, Omega, *_ = textbook.virtual_motion_edge(np.zeros(3), z, np.array([0.5, 0.0, 0.2]), z, sensor)
    squares.append(e @ Omega @ e)
    print(f"landmark {length:g} m away: e'e = {e @ e:.2f}, e' Omega e = {squares[-1]:6.2f}")
far, near = np.sqrt(squares)
assert far < 1 and 2 < near < 3

# %% three
three = load("examples/three_poses.txt")
J_3 = 0.0
for a_3, b_3 in ((0, 1), (0, 2), (1, 2)):
    (x_a, x_b), (z_a, z_b) = three.initial_poses[[a_3, b_3]], three.sightings[[a_3, b_3]]
    e_3, Omega_3, *_ = textbook.virtual_motion_edge(x_a, z_a, x_b, z_b, sensor)
    print(f"edge {a_3}, {b_3}: squared Mahalanobis distance {e_3 @ Omega_3 @ e_3:.3f}")
    J_3 += e_3 @ Omega_3 @ e_3
body_3 = Graph.from_log(three, edges="virtual", kernel="none")
print(f"J = {J_3:.3f}, in the body frame {body_3.cost(body_3.initial):.3f}")
assert e_3 @ Omega_3 @ e_3 > 2 and body_3.cost(body_3.initial) < J_3

# %% product
# the product of densities and J order trajectories in the same way
graph = Graph.from_log(log, edges="virtual+motion", weight="pairs", kernel="none")
best = solve(graph)
values = []
for factor in (0.0, 0.5, 1.0):
    poses = factor * log.initial_poses + (1 - factor) * best.poses
    J = graph.cost(poses)
    values.append(J)
    print(
        f"{factor:.0%} dead reckoning: J = {J:10.1f}, log of the product = -J/2 + constant = {-J / 2:10.1f} + constant"
    )

assert values[0] < values[2] < values[1]  # halfway is worse than either end

# %% lambda
from graphslam.metrics import ate

errors = []
for motion_weight in (0.01, 1.0, 100.0):
    poses = solve(Graph.from_log(log, edges="virtual+motion", kernel="none", motion_weight=motion_weight)).poses
    errors.append(ate(log.true_poses, poses))
    print(f"lambda = {motion_weight:6g}: absolute trajectory error {errors[-1]:.3f} m")
assert errors[2] < errors[1] < errors[0]

# %% squared
e, covariance = np.array([0.3, 0.1]), np.diag([0.3**2, 0.1**2])
right = e @ np.linalg.inv(covariance) @ e  # gap
np.testing.assert_allclose(right, 2)
print("squared Mahalanobis distance:", round(right, 4))
ask(  # noqa: F821
    right,
    {
        ("That is the distance; the square is asked", "それは距離です。2乗を答えてください"): np.sqrt(2),
        ("That is e'e, without the information matrix", "それは精度行列のないe'eです"): 0.1,
        ("The information matrix is the inverse of the covariance", "精度行列は共分散行列の逆行列です"): 0.0082,
    },
)

# %% times
right = np.exp((7 - 3) / 2)
np.testing.assert_allclose(right, np.exp(-3 / 2) / np.exp(-7 / 2))
print("times as probable:", round(right, 3))
ask(  # noqa: F821
    right,
    {
        ("The exponent of a Gaussian is -J/2", "ガウス分布の指数部は −J/2 です"): np.exp(4),
        (
            "The trajectory with the smaller J is the more probable one",
            "Jが小さい軌跡のほうが確からしくなります",
        ): np.exp(-2),
    },
)
