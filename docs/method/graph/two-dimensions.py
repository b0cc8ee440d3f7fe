# %% setup
import matplotlib.pyplot as plt
import numpy as np

from graphslam import Graph, SensorModel, simulate, solve, textbook
from graphslam.metrics import ate

log = simulate(seed=3, steps=30, clean=True).without_orientation()  # sightings (range, bearing)

# %% rows
e, Omega, B1, B2 = textbook.virtual_motion_edge(
    np.zeros(3), np.array([2.0, 0.3]), np.array([1.0, 0.2, 0.5]), np.array([1.5, 0.1]), SensorModel()
)
print("residual", np.round(e, 3), " Omega", Omega.shape, " B_1", B1.shape)
assert (e.shape, Omega.shape, B1.shape) == ((2,), (2, 2), (2, 3))

# %% undetermined
# a pose that shares one landmark with another pose can turn around this landmark
fig, ax = plt.subplots()
landmark, z = np.array([0.0, 0.0]), np.array([2.0, 0.4])
for angle in np.linspace(0, 2 * np.pi, 13)[:-1]:
    position = landmark - 2.0 * np.array([np.cos(angle), np.sin(angle)])
    heading = angle - z[1]
    ax.annotate(
        "",
        position + 0.5 * np.array([np.cos(heading), np.sin(heading)]),
        position,
        arrowprops={"arrowstyle": "->", "color": "C0"},
    )
    ax.plot([position[0], 0], [position[1], 0], "C0:", lw=0.8)
ax.plot(0, 0, "k*", ms=14, label="landmark")
ax.plot([], [], "C0-", label="poses with the same sighting (2 m, 0.4 rad)")
ax.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
ax.legend(fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0))

# %% solved
solution = textbook.solve(log, edges="virtual+motion", motion_copies=100)
error = ate(log.true_poses, solution.poses)
print(f"textbook, motion edges counted 100 times: {solution.iterations} iterations, error {error:.3f} m")
fast = solve(Graph.from_log(log, edges="landmark+motion", kernel="none"))
print(f"landmarks as nodes: {fast.iterations} iterations, error {ate(log.true_poses, fast.poses):.3f} m")
assert ate(log.true_poses, fast.poses) < error

# %% three
from graphslam import GraphError, load

three = load("examples/three_poses.txt")
try:
    textbook.solve(three, edges="virtual", dimensions=2)
except GraphError as error:
    print(error)
else:
    raise AssertionError("the poses are determined")
solution_3 = textbook.solve(three, edges="virtual+motion", dimensions=2)
print("with motion edges:", np.round(solution_3.poses[1:], 3).tolist())

# %% copies
errors, odometry = {}, {}
for copies in (1, 10, 100):
    solution = textbook.solve(log, edges="virtual+motion", motion_copies=copies, max_iterations=40)
    errors[copies] = ate(log.true_poses, solution.poses)
    odometry[copies] = ate(log.initial_poses, solution.poses)  # the distance to dead reckoning
    print(
        f"motion edges counted {copies:3} times: converged {solution.converged}, "
        f"error {errors[copies]:.3f} m, {odometry[copies]:.3f} m from dead reckoning"
    )
    assert solution.converged
assert errors[10] < errors[1] < errors[100]
assert odometry[100] < odometry[10] < odometry[1]

# %% rank
# the information of one edge about pose 2, with pose 1 fixed: rank 2 of 3
print("rank:", np.linalg.matrix_rank(B2.T @ Omega @ B2))
assert np.linalg.matrix_rank(B2.T @ Omega @ B2) == 2

# %% rows_of_four
K = 4
right = [2 * K * (K - 1) // 2, 2 * (K - 1), 3 * (K - 1)]
rows = []
for a in range(K):
    for b in range(a + 1, K):
        for k in range(2):  # e_ab = y_b - y_a, where y are the places from the poses
            rows.append([0.0] * 2 * K)
            rows[-1][2 * b + k], rows[-1][2 * a + k] = 1.0, -1.0
assert right == [len(rows), np.linalg.matrix_rank(rows), 9] == [12, 6, 9]
print("rows, independent rows, unknowns:", right)
ask(  # noqa: F821
    right,
    {
        ("Each edge has two rows without psi", "ψがないので、エッジの残差は2行です"): [18, 9, 9],
        (
            "e_02 is e_01 + e_12: not all rows are independent",
            "e_02 = e_01 + e_12なので、すべての行が独立ではありません",
        ): [12, 12, 9],
        ("The first pose is fixed", "最初の姿勢は固定されています"): [12, 6, 12],
    },
)

# %% flat
x, z = np.array([1.0, 1.0, 0.0]), np.array([2.0, np.pi / 2])
right = textbook.pose_derivative(x, z)[:2]  # gap
np.testing.assert_allclose(right, [[1, 0, -2], [0, 1, 0]], atol=1e-12)
print(np.round(right, 3) + 0.0)
ask(  # noqa: F821
    right,
    {
        ("The direction is theta + phi = pi/2: its sine is 1", "方向はθ + φ = π/2で、その正弦は1です"): [
            [1, 0, 0],
            [0, 1, 2],
        ],
    },
)
