# %% setup
import matplotlib.pyplot as plt
import numpy as np

from graphslam import simulate, textbook

log = simulate(seed=3, clean=True)  # the book's world: six landmarks, 62 motions, psi is measured
solution = textbook.solve(log, edges="virtual")

# %% norms
print("norms of the steps:", [float(f"{norm:.3g}") for norm in solution.step_norms])
print("J before each step:", [float(f"{cost:.4g}") for cost in solution.costs])
assert solution.step_norms[-1] < solution.threshold < solution.step_norms[-2]

# %% slider
results = {0: log.initial_poses} | {
    n: textbook.solve(log, edges="virtual", threshold=0.0, max_iterations=n).poses for n in (1, 2, 3, 5, 10)
}


def draw(iterations):
    """The trajectory after some iterations, with the places of the landmarks that its sightings give."""
    poses = results[iterations]
    _, ax = plt.subplots(figsize=(5.2, 5.2))
    ax.plot(log.true_poses[:, 0], log.true_poses[:, 1], "k-", lw=0.8, label="ground truth")
    ax.plot(poses[:, 0], poses[:, 1], "C0.-", lw=0.8, label="estimate")
    places = np.array([textbook.inverse_observation(poses[t], z) for t, z in zip(log.steps, log.sightings)])
    ax.plot(places[:, 0], places[:, 1], "C1.", ms=3, label="landmarks from each sighting")
    ax.set(xlim=(-6, 6), ylim=(-6, 6), xlabel="x [m]", ylabel="y [m]", aspect="equal")
    ax.legend(loc="lower right", fontsize=8)


slider("iterations:", list(results), draw)  # noqa: F821  # given by the site: one figure for each value

# %% isolated
seen = np.isin(np.arange(log.num_poses), log.steps)
print(f"{log.num_poses} poses, {np.sum(~seen)} of them saw nothing")
print(
    "poses of the graph:",
    solution.estimated.sum(),
    " with motion edges:",
    textbook.solve(log, edges="virtual+motion").estimated.sum(),
)
assert solution.estimated.sum() == log.num_poses - np.sum(~seen)

# %% three
from graphslam import load

three = load("examples/three_poses.txt")
solution_3 = textbook.solve(three, edges="virtual", threshold=1e-9)
print("J before each step:", [f"{cost:.3g}" for cost in solution_3.costs])
print(np.round(solution_3.poses, 4) + 0.0)
assert solution_3.converged and solution_3.iterations == 3 and solution_3.costs[1] > 0.01 > 1e-20 > solution_3.costs[2]

# %% drift
# the book's anchor is reset at every step: the graph drifts by a constant step
long = textbook.solve(log, edges="virtual", threshold=1e-9, max_iterations=60)
norms = np.array(long.step_norms)
print("norm of steps 10, 20, ..., 60:", [float(f"{norm:.3g}") for norm in norms[9::10]])
assert norms.argmin() == 19  # the twentieth
assert np.ptp(norms[-10:]) < 1e-3 * norms[-1]

# %% fast
from graphslam import Graph, solve

for frame in ("world", "body"):
    fast = solve(Graph.from_log(log, edges="virtual+motion", kernel="none", frame=frame), initialize="given")
    print(f"{frame}: {fast.iterations} iterations, last step {fast.step_norms[-1]:.1e}, converged: {fast.converged}")
    assert fast.converged

# %% newton
theta, steps = 0.0, []
for _ in range(2):  # e = sin(theta) - 0.5, B = cos(theta)
    e, B = np.sin(theta) - 0.5, np.cos(theta)
    steps.append(-e / B)  # Omega = B B, xi = - B e
    theta += steps[-1]
right = np.array(steps)
np.testing.assert_allclose(theta, np.pi / 6, atol=2e-4)
print("steps:", np.round(right, 4), " heading:", round(theta, 4))
ask(  # noqa: F821
    right,
    {
        ("The second step begins where the first one ends, at 0.5", "2回目は、1回目の結果である0.5から始まります"): [
            0.5,
            0.5,
        ],
        ("Divide by the derivative at 0.5, which is cos 0.5", "0.5での微分係数cos 0.5で割ってください"): [
            0.5,
            -(np.sin(0.5) - 0.5),
        ],
    },
    unit="rad",
)

# %% halves
norm, right = 1.0, 1
while norm >= 1e-3:
    norm, right = norm / 2, right + 1
assert right == 11
print("step", right, "has the norm", norm)
ask(  # noqa: F821
    right,
    {
        (
            "The first step has the norm 1, so step k has the norm 2^(1-k)",
            "1回目のノルムが1なので、k回目のノルムは2^(1-k)です",
        ): 10
    },
    within=0.001,
)
