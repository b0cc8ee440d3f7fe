# %% run
import comparisons

comparison = comparisons.run(
    estimators=["dead-reckoning", "graph", "fastslam1"], edges="landmark+motion", particles=300
)
for row in comparison.table:
    print(f"{row.name:15} ATE {row.ate_m:.3f} m")
errors = {row.name: row.ate_m for row in comparison.table}
assert errors["graph"] == min(errors.values())

# %% picture
comparison.figure()

# %% steps
from graphslam import Graph, estimate_map, load, sample_log_path, solve

log = load(sample_log_path())
print(log)
graph = Graph.from_log(log, edges="landmark+motion")  # landmarks as nodes
solution = solve(graph)
print(solution.reason)
print("landmark 0:", estimate_map(log, solution)[0].round(2))
print("standard deviation of pose 100:", (solution.covariance(100).diagonal() ** 0.5).round(3))

# %% plot
import matplotlib.pyplot as plt

fig, ax = plt.subplots()
ax.plot(*log.initial_poses[:, :2].T, ":", label="dead reckoning")
ax.plot(*log.true_poses[:, :2].T, "k", lw=1, label="ground truth")
ax.plot(*solution.poses[:, :2].T, "--", label="landmark nodes")
ax.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)

# %% without_motion
ends = {edges: solve(Graph.from_log(log, edges=edges)) for edges in ("virtual", "virtual+motion")}
for edges, end in ends.items():
    print(f"{edges:15} J {end.cost:9.2f}, {end.iterations} steps")
assert ends["virtual"].cost < ends["virtual+motion"].cost  # the terms of the motion edges are missing

# %% many
import numpy as np

from fastslam import FastSLAM1
from graphslam import simulate
from graphslam.metrics import ate

again = [ate(log.true_poses, FastSLAM1(log, particles=300, seed=seed).run().poses) for seed in range(20)]
print(f"FastSLAM on the sample log with 20 random seeds: {min(again):.2f} to {max(again):.2f} m")
assert (round(min(again), 2), round(max(again), 2)) == (0.18, 0.39)

errors = {"graph, landmark nodes": [], "graph, pairs": [], "FastSLAM": []}
for seed in range(20):
    drive = simulate(seed=seed, steps=160)
    for name, edges in (("graph, landmark nodes", "landmark+motion"), ("graph, pairs", "virtual+motion")):
        errors[name].append(ate(drive.true_poses, solve(Graph.from_log(drive, edges=edges)).poses))
    errors["FastSLAM"].append(ate(drive.true_poses, FastSLAM1(drive, particles=300, seed=seed).run().poses))
for name, values in errors.items():
    print(f"{name:21} median ATE {np.median(values):.3f} m")
better = sum(np.array(errors["graph, landmark nodes"]) < errors["FastSLAM"])
print(f"landmark nodes are better than FastSLAM on {better} of 20 logs")
assert better >= 15
assert np.median(errors["graph, pairs"]) > np.median(errors["FastSLAM"])
