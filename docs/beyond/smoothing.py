# %% setup
import matplotlib.pyplot as plt
import numpy as np

rng = np.random.default_rng(0)
T, move, see = 40, 1.0, 0.5  # steps; standard deviations of a motion and of a measurement
truth = np.cumsum(rng.normal(0, move, T))
z = truth + rng.normal(0, see, T)  # a robot on a line measures its position


def log_normal(x, std):
    """The logarithm of the Gaussian density, without its constant."""
    return -0.5 * (x / std) ** 2


def draw(log_weights, size=None):
    """Indices drawn with probabilities in proportion to exp(log_weights)."""
    w = np.exp(log_weights - log_weights.max())
    return rng.choice(len(w), size=size, p=w / w.sum())


# %% depletion
def distinct(N):
    """The number of distinct histories at each step, after a filter with resampling at every step."""
    ancestors, x = np.zeros((T, N), dtype=int), rng.normal(0, move, N)
    for t in range(1, T):
        ancestors[t] = draw(log_normal(z[t - 1] - x, see), N)
        x = x[ancestors[t]] + rng.normal(0, move, N)
    alive, counts = np.arange(N), np.zeros(T, dtype=int)
    for t in range(T - 1, -1, -1):
        counts[t] = len(np.unique(alive))
        alive = ancestors[t][alive]
    return counts


fig, ax = plt.subplots(figsize=(6.4, 3.2))
for N in (20, 100, 500):
    ax.semilogy(distinct(N), label=f"{N} particles")
ax.set(xlabel="step", ylabel="distinct poses among the histories")
ax.legend()


# %% backward
def forward(N):
    """The particles of a filter at each step before its resampling, and the logarithms of their weights."""
    x, log_w = np.zeros((T, N)), np.zeros((T, N))
    for t in range(T):
        start = x[t - 1, draw(log_w[t - 1], N)] if t else 0
        x[t] = start + rng.normal(0, move, N)
        log_w[t] = log_normal(z[t] - x[t], see)
    return x, log_w


def backward(x, log_w):
    """A trajectory, drawn from the last step to the first."""
    new = np.zeros(T)
    new[-1] = x[-1, draw(log_w[-1])]
    for t in range(T - 2, -1, -1):
        new[t] = x[t, draw(log_w[t] + log_normal(new[t + 1] - x[t], move))]
    return new


particles = forward(100)
drawn = np.array([backward(*particles) for _ in range(500)])
print(
    "distinct poses among 500 trajectories, at every eighth step:",
    [len(np.unique(drawn[:, t])) for t in range(0, T, 8)],
)
assert len(np.unique(drawn[:, 0])) > 30


# %% gibbs
def sweep(kept, N=10, ancestor_sampling=True):
    """A new trajectory, given the one that is kept: a filter whose last particle is the kept trajectory."""
    x, ancestors = np.zeros((T, N)), np.zeros((T, N), dtype=int)
    x[0] = rng.normal(0, move, N)
    x[0, -1] = kept[0]
    for t in range(1, T):
        log_w = log_normal(z[t - 1] - x[t - 1], see)
        ancestors[t] = draw(log_w, N)
        x[t] = x[t - 1, ancestors[t]] + rng.normal(0, move, N)
        x[t, -1] = kept[t]
        # which particle could have moved to the kept pose?
        ancestors[t, -1] = draw(log_w + log_normal(kept[t] - x[t - 1], move)) if ancestor_sampling else N - 1
    k, new = draw(log_normal(z[-1] - x[-1], see)), np.zeros(T)
    for t in range(T - 1, -1, -1):
        new[t] = x[t, k]
        k = ancestors[t, k]
    return new


samples = [truth * 0]
for _ in range(3000):
    samples.append(sweep(samples[-1]))
samples = np.array(samples[100:])

# %% exact
information = np.diag(np.full(T, 2 / move**2 + 1 / see**2)) - np.eye(T, k=1) / move**2 - np.eye(T, k=-1) / move**2
information[-1, -1] -= 1 / move**2
mean, std = np.linalg.solve(information, z / see**2), np.sqrt(np.diag(np.linalg.inv(information)))
print(
    "largest error of the mean:",
    np.abs(samples.mean(axis=0) - mean).max().round(3),
    "of a standard deviation",
    std.mean().round(3),
)
assert np.allclose(samples.std(axis=0) / std, 1, atol=0.1)
print("standard deviations, sampled / exact:", (samples.std(axis=0) / std)[::8].round(2))

# %% figure
fig, ax = plt.subplots(figsize=(6.4, 3.4))
ax.plot(samples[::100].T, "C0", lw=0.5, alpha=0.4)
ax.plot(truth, "k:", label="truth")
ax.fill_between(range(T), mean - 2 * std, mean + 2 * std, color="C1", alpha=0.3, label="exact, two standard deviations")
ax.plot([], [], "C0", label="samples")
ax.set(xlabel="step", ylabel="position [m]")
ax.legend()

# %% slam
from fastslam import FastSLAM2, ParticleGibbs
from graphslam import Graph, SensorModel, simulate, solve

sensor = SensorModel(range_rate=0.05, bearing_std=0.02, orientation_std=0.02)
log = simulate(seed=0, clean=True, sensor=sensor)
smoother = ParticleGibbs(log, particles=20, iterations=800, warm_up=100, seed=0, sensor=sensor).run()
print(smoother.mixing.statement)
graph = solve(Graph.from_log(log, edges="landmark+motion", sensor=sensor))
for step in (10, 30, 60):
    by_graph = np.sqrt(np.diag(graph.covariance(step)))
    by_samples = np.sqrt(np.diag(smoother.covariance(step)))
    print(f"std of pose {step}: graph {by_graph.round(3)}, samples {by_samples.round(3)}")
    assert np.allclose(by_graph, by_samples, rtol=0.15)

# %% filter
filtered = FastSLAM2(log, particles=200, seed=0, sensor=sensor, smoothing=100).run()
errors = []
for name, poses in (
    ("FastSLAM 2.0, one history", filtered.poses),
    ("its histories, drawn backwards", filtered.smoothed.poses),
    ("samples, their mean", smoother.poses),
    ("graph", graph.poses),
):
    errors.append(np.sqrt(np.mean((poses - log.true_poses)[:, :2] ** 2)))
    print(f"{name:30} position error {errors[-1]:.3f} m")
assert max(errors[1:3]) < 0.7 * errors[0]

# %% stuck
for sampling in (False, True):
    kept, firsts = truth * 0, []
    for _ in range(300):
        kept = sweep(kept, N=10, ancestor_sampling=sampling)
        firsts.append(kept[5])
    print(f"ancestor sampling {sampling}: {len(np.unique(firsts))} different values of step 5 in 300 sweeps")
    assert (len(np.unique(firsts)) > 100) == sampling

# %% early
first, late = {}, {}
for N in (20, 100, 500):
    counts = np.mean([distinct(N) for _ in range(100)], axis=0)  # of a hundred runs
    first[N], late[N] = counts[0], counts[T - 5]
    print(f"{N} particles: {first[N]:.1f} distinct poses at the first step, {late[N]:.1f} five steps before the end")
assert first[20] < 1.1
assert first[500] < 0.03 * 500
assert late[500] > 0.15 * 500

# %% who
particles_t, w, later = np.array([0.0, 1.0]), np.array([0.7, 0.3]), 1.5
right = w * np.exp(log_normal(later - particles_t, move))
right = right / right.sum()  # gap
np.testing.assert_allclose(right[1] / right[0], 0.3 / 0.7 * np.exp(1.125 - 0.125))
print(np.round(right, 4))
ask(  # noqa: F821
    right,
    {
        ("The motion to the later pose counts, too", "後の姿勢への移動の確率もかけてください"): w,
        ("The weights of the filter count, too", "フィルタの重みもかけてください"): np.exp(
            log_normal(later - particles_t, move)
        )
        / np.exp(log_normal(later - particles_t, move)).sum(),
    },
)

# %% small_graph
# x_1 ~ N(0, 1), x_2 = x_1 + N(0, 1); measured 1 and 2 with the variance 0.25
right = np.array([[1 + 1 + 4, -1, 4 * 1], [-1, 1 + 4, 4 * 2]])  # gap
exact = np.linalg.solve(right[:, :2], right[:, 2])
print(right, " mean:", exact.round(4))
np.testing.assert_allclose(right[:, :2], np.linalg.inv([[1, 1], [1, 2]]) + 4 * np.eye(2))
ask(  # noqa: F821
    right,
    {
        (
            "The motion belongs to both poses: it adds 1 to both diagonal elements",
            "移動は両方の姿勢に関係し、どちらの対角成分にも1を足します",
        ): [[5, -1, 4], [-1, 5, 8]],
        ("The information is the inverse variance, 4", "情報は分散の逆数の4です"): [[2.25, -1, 0.25], [-1, 1.25, 0.5]],
    },
)
