# %% tables
from pathlib import Path

folder = Path("examples/own_robot")
for name in ("odometry.csv", "sightings.csv"):
    print(name, *(folder / name).read_text().splitlines()[:3], sep="\n  ")

# %% look
import matplotlib.pyplot as plt
import numpy as np

from graphslam import load

log = load(folder)
print(log)
for note in log.notes:
    print("note:", note)

# %% ranges
fig, (left, right) = plt.subplots(1, 2, figsize=(8, 3))
left.plot(*log.initial_poses[:, :2].T, ".-", ms=3)
left.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", title="dead reckoning")
right.hist(np.degrees(log.sightings[:, 1]), bins=15)
right.set(xlabel="bearing [degrees]", ylabel="sightings")

# %% solve
from graphslam import Graph, solve

graph = Graph.from_log(log, edges="landmark+motion")
solution = solve(graph)
print(solution.reason)
print(f"J {solution.cost:.0f}, expected {graph.expected_cost:.0f}")
print(graph.notes[0])
assert 0.8 < solution.cost / graph.expected_cost < 1.2

# %% map
fig, ax = plt.subplots()
ax.plot(*solution.poses[:, :2].T, label="landmark nodes")
if log.true_poses is not None:
    ax.plot(*log.true_poses[:, :2].T, "k:", label="ground truth")
for name, place in solution.landmarks.items():
    ax.plot(place[0], place[1], "C1^")
    ax.annotate(str(name), place[:2], textcoords="offset points", xytext=(5, 5))
ax.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
ax.margins(0.1)
ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)

# %% mistake
from graphslam import Log, SlamError

odometry = {"t": np.arange(0, 20, 0.1), "nu": np.full(200, 0.5), "omega": np.full(200, 0.3)}
sightings = {"t": [1.0, 3.0, 5.0], "id": [7, 7, 4], "range": [2.1, 1.4, 2.0], "bearing": [20.0, 35.0, -15.0]}
try:
    Log.from_tables(odometry, sightings)
except SlamError as error:
    message = str(error)
print(message)
assert "is it in degrees? Then add --angles sightings=degrees" in message
print(Log.from_tables(odometry, sightings, angles={"sightings": "degrees"}))
