# %% sample
import comparisons

comparison = comparisons.run(estimators=["dead-reckoning", "graph", "graph-marginal", "fastslam2"], particles=300)
comparison.figure()

# %% ellipses
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Ellipse

from graphslam import Graph, load, sample_log_path, solve

log = load(sample_log_path())
solution = solve(Graph.from_log(log, edges="landmark+motion"))


def ellipse(ax, place, covariance, **style):
    """Draw the ellipse of three standard deviations."""
    values, vectors = np.linalg.eigh(covariance[:2, :2])
    angle = np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1]))
    ax.add_patch(Ellipse(place[:2], *(6 * np.sqrt(values[::-1])), angle=angle, fill=False, **style))


fig, ax = plt.subplots()
ax.plot(*solution.poses[:, :2].T, lw=1)
for step in range(0, log.num_poses, 10):
    ellipse(ax, solution.poses[step], solution.covariance(step), color="C0")
for name, place in solution.landmarks.items():
    ellipse(ax, place, solution.landmark_covariances[name], color="C1", lw=2)
ax.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")

# %% iterations
states = [solve(Graph.from_log(log, edges="virtual"), initialize="given", max_iterations=n).poses for n in range(1, 7)]


def draw(count):
    """The trajectory after a number of iterations from dead reckoning."""
    _, ax = plt.subplots()
    poses = log.initial_poses if count == 0 else states[count - 1]
    ax.plot(*log.true_poses[:, :2].T, "k:", lw=1, label="ground truth")
    ax.plot(*poses[:, :2].T, ".-", ms=3, label=f"after {count} iterations")
    ax.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", xlim=(-12, 12), ylim=(-12, 12))
    ax.legend(loc="upper right")


slider("iterations:", range(7), draw)  # noqa: F821  # given by the site: one figure for each value

# %% matrix
system, _ = solution.graph.linearize(solution.state)
fig, ax = plt.subplots(figsize=(4.5, 4.5))
ax.spy(system.to_sparse(), markersize=0.4)
ax.set(title="Omega: poses, then landmarks")
