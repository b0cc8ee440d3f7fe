# %% setup
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Ellipse

from graphslam import Graph, MotionModel, SensorModel, simulate, solve
from graphslam.metrics import pose_nees
from graphslam.se2 import difference, wrap

motion = MotionModel(nn=0.019, no=0.0001, on=0.013, oo=0.02, epsilon=1e-6)  # a tenth of the book's noise
sensor = SensorModel(range_rate=0.014, bearing_std=0.005, orientation_std=0.005)


def solved(seed, motion=motion, sensor=sensor):
    """A simulated log and its solution with landmark nodes."""
    log = simulate(seed=seed, clean=True, motion=motion, sensor=sensor)
    return log, solve(Graph.from_log(log, edges="landmark+motion", motion=motion, sensor=sensor))


log, solution = solved(0)

# %% inverse
system, _ = solution.graph.linearize(solution.state)
Omega = system.to_sparse().toarray()
P = np.linalg.inv(Omega)
rows = slice(3 * 30, 3 * 31)  # pose 30
print("Omega has", Omega.shape, "entries,", f"{np.mean(Omega != 0):.0%} of them not zero")
print("largest difference to solution.covariance(30):", np.abs(P[rows, rows] - solution.covariance(30)).max())
assert np.allclose(P[rows, rows], solution.covariance(30), atol=1e-12)

# %% marginal
alone = np.sqrt(np.diag(P[rows, rows]))
others_known = np.sqrt(np.diag(np.linalg.inv(Omega[rows, rows])))
print("standard deviations of pose 30 (x, y, theta):", alone.round(4))
print("if all other poses and landmarks were known: ", others_known.round(4))
assert np.all(others_known < 0.5 * alone)

# %% growth
by_odometry = np.zeros((log.num_poses, 3, 3))
for t in range(1, log.num_poses):
    x, u, dt = log.true_poses[t - 1], log.controls[t - 1], log.dt[t - 1]
    F = motion.F(x, u, dt)
    by_odometry[t] = F @ by_odometry[t - 1] @ F.T + motion.covariance(x, u, dt)
by_graph = solution.covariance()

fig, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6))
for covariances, color, name in ((by_odometry, "C1", "odometry alone"), (by_graph, "C0", "graph")):
    left.plot(np.sqrt(covariances[:, 0, 0] + covariances[:, 1, 1]), color, label=name)
    for t in range(0, log.num_poses, 5):
        values, vectors = np.linalg.eigh(covariances[t, :2, :2])
        angle = np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1]))
        size = 6 * np.sqrt(np.maximum(values[::-1], 0))
        right.add_patch(Ellipse(log.true_poses[t, :2], *size, angle=angle, fill=False, color=color))
left.set(xlabel="step", ylabel="standard deviation of the position [m]")
left.legend()
right.plot(*log.true_poses[:, :2].T, "k:", lw=1)
right.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", title="three standard deviations")


# %% anchor
def without_anchor(poses, covariances):
    """The covariances (T+1, 3, 3) relative to the first pose."""
    G = np.tile(np.eye(3), (len(poses), 1, 1))
    G[:, 0, 2], G[:, 1, 2] = poses[0, 1] - poses[:, 1], poses[:, 0] - poses[0, 0]
    return covariances - G @ covariances[0] @ G.transpose(0, 2, 1)


wheels = MotionModel(nn=1e-3, no=5e-6, on=6.5e-4, oo=1e-3, epsilon=2.5e-9)  # a twentieth of the noise above
accurate = SensorModel(range_rate=7e-4, bearing_std=2.5e-4, orientation_std=2.5e-4)
stated, relative = [], []
for seed in range(8):
    drive, result = solved(seed, wheels, accurate)
    errors = difference(result.poses, drive.true_poses)[1:]
    stated.append(np.nanmean(result.nees(drive.true_poses)[1:]))
    relative.append(np.mean(pose_nees(errors, without_anchor(result.poses, result.covariance())[1:])))
print(f"NEES / 3 of 8 logs: {np.mean(stated):.2f} with the anchor, {np.mean(relative):.2f} without it")
assert np.mean(stated) < 0.5 < np.mean(relative)

# %% correlation
both = solution.covariance([30, 31], joint=True)  # of both poses together, (6, 6)
C = both[:3, 3:]
scale = np.sqrt(np.outer(np.diag(both[:3, :3]), np.diag(both[3:, 3:])))
print("correlation of pose 30 and pose 31:", np.diag(C / scale).round(3))
assert np.all(np.diag(C / scale) > 0.8)

# %% landmark
for j, covariance in list(solution.landmark_covariances.items())[:3]:
    error = np.hypot(*(solution.landmarks[j] - log.true_landmarks[j])[:2])
    print(f"landmark {j}: std {np.sqrt(np.diag(covariance)[:2]).round(4)} m, error {error:.4f} m")
    assert error < 4 * np.sqrt(np.trace(covariance[:2, :2]))

# %% trials
errors, claimed = [], []
for seed in range(40):
    other_log, other = solved(seed)
    e = other.poses[30] - other_log.true_poses[30]
    e[2] = wrap(e[2])
    errors.append(e)
    claimed.append(np.diag(other.covariance(30)))
print("standard deviation of the errors:", np.std(errors, axis=0).round(4))
print("mean claimed standard deviation: ", np.sqrt(np.mean(claimed, axis=0)).round(4))
ratio = np.std(errors, axis=0) / np.sqrt(np.mean(claimed, axis=0))
assert np.all(np.abs(ratio - 1) < 3 / np.sqrt(2 * 40))  # three times 11 %

# %% difference
both = solution.covariance(30) + solution.covariance(31)
right_one = both - C - C.T
print("std of x_31 - x_30 with the correlation:   ", np.sqrt(np.diag(right_one)).round(4))
print("std of x_31 - x_30 as if they were independent:", np.sqrt(np.diag(both)).round(4))
assert np.all(np.diag(right_one) < 0.2 * np.diag(both))

# %% two_numbers
W = np.array([[4.0, 2.0], [2.0, 2.0]])
right = [np.linalg.inv(W)[0, 0], 1 / W[0, 0]]  # gap
np.testing.assert_allclose(right, [0.5, 0.25])
print("marginal:", right[0], " conditional:", right[1])
ask(  # noqa: F821
    right,
    {
        ("Marginal and conditional are exchanged", "周辺と条件付きが逆です"): [0.25, 0.5],
    },
)

# %% distance_apart
together = np.array([[0.04, 0.03], [0.03, 0.05]])
right = np.array([-1, 1]) @ together @ np.array([-1, 1])  # gap
np.testing.assert_allclose(right, 0.03)
print("variance of the difference:", round(right, 4))
ask(  # noqa: F821
    right,
    {
        ("That takes the two as independent", "それは2つが独立な場合です"): 0.09,
        ("The covariance has a minus sign for a difference", "差の分散では、共分散の符号は負です"): 0.15,
    },
    unit="m²",
)
