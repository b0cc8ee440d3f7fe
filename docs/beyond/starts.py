# %% setup
import matplotlib.pyplot as plt
import numpy as np

from graphslam import Graph, simulate, solve

log = simulate(seed=4, clean=True)  # the book's world and noise
graph = Graph.from_log(log)
best = solve(graph)

# %% wells
theta = np.linspace(-np.pi, np.pi, 200)


def cost_of_turning(step):
    """J while all poses after a step turn about it."""
    values = []
    for angle in theta:
        state = best.state.copy()
        c, s = np.cos(angle), np.sin(angle)
        state[step:, :2] = (state[step:, :2] - state[step, :2]) @ np.array([[c, s], [-s, c]]) + state[step, :2]
        state[step:, 2] += angle
        values.append(graph.cost(state))
    return values


def draw(step):
    """J over the angle."""
    _, ax = plt.subplots(figsize=(6.4, 3))
    ax.semilogy(theta, cost_of_turning(step))
    ax.axvline(0, color="k", ls=":", lw=1)
    ax.set(xlabel="turn of the rest of the trajectory [rad]", ylabel="J", title=f"turned at pose {step}")


slider("pose", [10, 20, 30, 40, 50], draw)  # noqa: F821  # given by the site: one figure for each value

# %% turns
pairs = []  # (a, b, tau): the measured turn between two poses, from the virtual-motion edges and the controls
for j in np.unique(log.landmarks):
    rows = np.flatnonzero(log.landmarks == j)
    for k, a in enumerate(rows):
        for b in rows[k + 1 :]:
            (_, phi_a, psi_a), (_, phi_b, psi_b) = log.sightings[a], log.sightings[b]
            pairs.append((log.steps[a], log.steps[b], (phi_b - psi_b) - (phi_a - psi_a)))
for t in range(log.num_poses - 1):
    pairs.append((t, t + 1, -log.controls[t, 1] * log.dt[t]))
print(len(pairs), "measured turns for", log.num_poses, "headings")

# %% headings
rows = np.zeros((len(pairs) + 1, log.num_poses), dtype=complex)
right = np.zeros(len(pairs) + 1, dtype=complex)
for k, (a, b, tau) in enumerate(pairs):  # z_b exp(i tau) - z_a = 0
    rows[k, b], rows[k, a] = np.exp(1j * tau), -1
rows[-1, 0], right[-1] = 1e3, 1e3 * np.exp(1j * log.initial_poses[0, 2])  # the first heading is known
z = np.linalg.lstsq(rows, right, rcond=None)[0]
headings = np.angle(z)


def error(values):
    """The root mean square error of headings [rad]."""
    return np.sqrt(np.mean(np.angle(np.exp(1j * (values - log.true_poses[:, 2]))) ** 2))


print(f"dead reckoning {error(log.initial_poses[:, 2]):.3f} rad")
print(f"linear system  {error(headings):.3f} rad")
print(f"solution       {error(best.poses[:, 2]):.3f} rad")
assert error(headings) < 0.1 * error(log.initial_poses[:, 2])

# %% figure
states = {name: solve(graph, initialize=name, max_iterations=1).poses for name in ("given", "rotation-first")}
fig, ax = plt.subplots()
ax.plot(*log.initial_poses[:, :2].T, "C1", lw=1, label="dead reckoning")
ax.plot(*states["given"][:, :2].T, "C1--", lw=1, label="one iteration from dead reckoning")
ax.plot(*states["rotation-first"][:, :2].T, "C0--", lw=1, label="one iteration from rotation first")
ax.plot(*best.poses[:, :2].T, "C2", label="minimum of J")
ax.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
ax.legend(fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)

# %% compare
rng = np.random.default_rng(0)
lost = dict.fromkeys(("given", "rotation-first", "auto"), 0)
for _ in range(10):
    wild = graph.initial.copy()
    wild[1:, 2] = rng.uniform(-np.pi, np.pi, len(wild) - 1)  # headings that mean nothing
    for name in lost:
        end = solve(graph.with_initial(wild), initialize=name)
        lost[name] += not (end.converged and end.cost < best.cost * (1 + 1e-6))
assert lost == {"given": 10, "rotation-first": 0, "auto": 0}
for name, count in lost.items():
    print(f"{name:15} misses the minimum from {count} of 10 random starts")

# %% spread
for std in (0.05, 0.2, 0.5, 1.0, 2.0):
    reached = 0
    for _ in range(10):
        start = best.state.copy()
        start[1:, 2] += rng.normal(0, std, len(start) - 1)
        end = solve(graph.with_initial(start), initialize="given")
        reached += bool(end.converged and end.cost < best.cost * (1 + 1e-6))
    print(f"headings {std:4} rad off: {reached} of 10 reach the minimum")
    assert reached == 10 if std <= 1 else reached <= 3
end = solve(graph, initialize="given")
print(
    "dead reckoning reaches it:",
    bool(end.converged and np.isclose(end.cost, best.cost)),
    f"after {end.iterations} steps",
)
assert np.isclose(end.cost, best.cost)

# %% length
lengths = []
for noise in (0.1, 1.0, 3.0):
    turns = [(a, b, tau + rng.normal(0, noise)) for a, b, tau in pairs]
    for k, (_, b, tau) in enumerate(turns):
        rows[k, b] = np.exp(1j * tau)
    unit = np.linalg.lstsq(rows, right, rcond=None)[0]
    print(
        f"noise of a turn {noise} rad: mean length of z {np.abs(unit).mean():.3f}, error {error(np.angle(unit)):.3f} rad"
    )
    lengths.append(np.abs(unit).mean())
assert lengths == sorted(lengths, reverse=True)

# %% tau
phi_a, psi_a, phi_b, psi_b, theta_a = 0.3, 1.0, -0.2, 0.9, 1.0
tau = (phi_b - psi_b) - (phi_a - psi_a)
right = [tau, theta_a - tau]  # gap
np.testing.assert_allclose(right, [-0.4, 1.4])
np.testing.assert_allclose(theta_a + phi_a - psi_a, right[1] + phi_b - psi_b)
print(np.round(right, 4))
ask(  # noqa: F821
    right,
    {
        ("theta_b is theta_a minus tau", "θ_bはθ_a − τです"): [-0.4, 0.6],
    },
    unit="rad",
)

# %% mean_of_angles
z_mean = (np.exp(3.0j) + np.exp(-2.8j)) / 2
right = [np.angle(z_mean), np.abs(z_mean)]  # gap
np.testing.assert_allclose(right, [(3.0 + (2 * np.pi - 2.8)) / 2 - 2 * np.pi, np.cos((2 * np.pi - 5.8) / 2)])
print(np.round(right, 4))
ask(  # noqa: F821
    right,
    {
        (
            "The mean of the numbers points the other way: angles wrap",
            "数の平均では反対の向きになります。角度は一周すると元に戻ります",
        ): [0.1, right[1]],
        ("Normalise the angle to [-pi, pi)", "角度を[−π, π)に正規化してください"): [right[0] + 2 * np.pi, right[1]],
    },
    unit="rad, 1",
)
