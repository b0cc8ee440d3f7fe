# %% drive
from graphslam import Drive, Graph, estimate_robot, solve
from graphslam.metrics import ate

log, truth = Drive(seed=3).simulate()  # 10 minutes in a warehouse with 50 tags
print(log)
print(f"{truth.misread_share:.1%} of the sightings have a wrong id")
print(f"dead reckoning: ATE {ate(log.true_poses, log.dead_reckoning()):.2f} m")
assert 0.04 < truth.misread_share < 0.06

# %% book
book = solve(Graph.from_log(log, noise="book", edges="landmark+motion"))
print(
    f"ATE {ate(log.true_poses, book.poses):.2f} m, J per degree of freedom {book.cost / book.graph.degrees_of_freedom:.2f}"
)
assert ate(log.true_poses, book.poses) > 5 and abs(book.cost / book.graph.degrees_of_freedom - 1) < 0.2

# %% estimate
found = estimate_robot(log)
for sentence in found.sentences:
    print("-", sentence)

# %% noise
for given, true, names in (
    (found.motion, truth.motion, ("nn", "oo", "slip")),
    (found.sensor, truth.sensor, ("range_rate", "bearing_std")),
):
    book_model = type(given)()
    for name in names:
        values = [getattr(model, name) for model in (given, true, book_model)]
        print(f"{name:12} estimated {values[0]:.4f}, true {values[1]:.4f}, book {values[2]:.4f}")
        assert values[0] < values[2] / 5 or name == "slip"

# %% ids
wrong, named = truth.misread | truth.clutter, found.ids.changed | found.ids.dropped
print(
    f"found: {named[wrong].mean():.1%} of the wrong ids; taken for wrong: {named[~wrong].mean():.1%} of the right ones"
)
assert named[wrong].mean() > 0.95 and named[~wrong].mean() < 0.01

# %% steps
import matplotlib.pyplot as plt

right_ids = found.ids.correct(log)
options = {"edges": "landmark+motion", "kernel": "cauchy"}
models = {"motion": found.motion, "sensor": found.sensor}
steps = {
    "the book's noise": book,
    "noise estimated": solve(Graph.from_log(log, **models, **options)),
    "ids corrected, too": solve(Graph.from_log(right_ids, **models, **options)),
    "biases taken out, too": solve(Graph.from_log(found.log, **options)),
}
errors = [ate(log.true_poses, solution.poses) for solution in steps.values()]
for name, error in zip(steps, errors):
    print(f"{name:22} ATE {error:6.3f} m")
assert errors[1] < errors[0] / 10 and errors[3] < errors[2] / 2

fig, axes = plt.subplots(1, 3, figsize=(9, 3.4), sharex=True, sharey=True)
for ax, name in zip(axes, ("the book's noise", "noise estimated", "biases taken out, too")):
    ax.plot(*log.true_poses[:, :2].T, color="0.6", lw=3, label="ground truth")
    ax.plot(*steps[name].poses[:, :2].T, lw=1, label="estimate")
    ax.set(title=name, xlabel="x [m]", aspect="equal")
axes[0].set_ylabel("y [m]")
axes[0].legend(loc="upper left", fontsize=8)

# %% errors
fig, ax = plt.subplots(figsize=(7, 3))
for name, solution in steps.items():
    off = solution.poses[:, :2] - log.true_poses[:, :2]
    ax.semilogy(log.times, (off**2).sum(axis=1) ** 0.5, lw=1, label=name)
ax.set(xlabel="time [s]", ylabel="distance to the truth [m]", ylim=(1e-3, 100))
ax.legend(fontsize=8)
