# %% setup
import matplotlib.pyplot as plt
import numpy as np

from graphslam import Graph, MotionModel, SensorModel, simulate, solve

motion = MotionModel(nn=0.019, no=0.0001, on=0.013, oo=0.02, epsilon=1e-6)  # a tenth of the book's noise
sensor = SensorModel(range_rate=0.014, bearing_std=0.005, orientation_std=0.005)
variants = {
    "pairs": {"weight": "pairs"},
    "tempered": {"weight": "tempered"},
    "marginal": {"weight": "marginal"},
    "landmark nodes": {"edges": "landmark+motion"},
}

# %% scalar
rng = np.random.default_rng(0)
K, trials = 20, 5000
z = rng.standard_normal((trials, K))  # K sightings of a place at 0, each with variance 1
estimate = z.mean(axis=1)
print("variance of the estimate:", round(estimate.var(), 4), " 1/K:", 1 / K)
# the pairs (a, b), each with variance 2, seen as measurements of the position of the first pose relative to the others
pair_information = (K - 1) / 2
print("information of one sighting among the pairs:", pair_information, " right:", round((K - 1) / K, 2))
assert abs(estimate.var() * K - 1) < 5 * np.sqrt(2 / trials)

# %% nees
joint = {name: [] for name in variants}
for seed in range(10):
    log = simulate(seed=seed, clean=True, motion=motion, sensor=sensor)
    for name, options in variants.items():
        solution = solve(Graph.from_log(log, motion=motion, sensor=sensor, **options))
        joint[name].append(solution.joint_nees(log.true_poses))
for name, values in joint.items():
    print(f"{name:15} joint ANEES {np.mean(values):.2f}")
assert np.mean(joint["pairs"]) > 5
assert all(0.9 < np.mean(joint[name]) < 1.1 for name in ("tempered", "marginal", "landmark nodes"))

# %% bars
fig, ax = plt.subplots(figsize=(6.4, 3.2))
ax.boxplot(list(joint.values()), tick_labels=[name.replace(" ", "\n") for name in joint], orientation="horizontal")
ax.axvline(1, color="C2", lw=2, label="consistent")
ax.set(xlabel="joint NEES / degrees of freedom, 10 logs", xscale="log")
ax.legend()

# %% equal
log = simulate(seed=0, clean=True, motion=motion, sensor=sensor)
end = {name: solve(Graph.from_log(log, motion=motion, sensor=sensor, **options)) for name, options in variants.items()}
exact = end["landmark nodes"]
for name, solution in end.items():
    apart = np.abs(solution.poses - exact.poses)[:, :2].max()
    std = np.sqrt(np.diag(solution.covariance(30)))
    print(
        f"{name:15} J {solution.cost:8.2f}  {1000 * apart:5.1f} mm from landmark nodes  std of pose 30: {std.round(4)}"
    )
assert np.isclose(end["marginal"].cost, exact.cost) and np.allclose(
    end["marginal"].covariance(30), exact.covariance(30)
)
assert np.all(np.diag(end["pairs"].covariance(30)) < 0.5**2 * np.diag(exact.covariance(30)))

# %% accuracy
accuracy = []
for weight in ("pairs", "marginal"):
    errors = []
    for seed in range(5):
        drive = simulate(seed=seed, clean=True, motion=motion, sensor=sensor)
        poses = solve(Graph.from_log(drive, motion=motion, sensor=sensor, weight=weight)).poses
        errors.append(np.sqrt(np.mean((poses - drive.true_poses)[:, :2] ** 2)))
    accuracy.append(np.mean(errors))
    print(f"{weight:9} root mean square position error: {accuracy[-1]:.4f} m")
assert accuracy[1] < 0.8 * accuracy[0]

# %% unequal
variances = np.array([1.0] * 10 + [0.01] * 2)  # ten coarse sightings of a place and two fine ones
W = 1 / variances
between = variances[:, None] + variances[None, :]  # the variance of each pair
# the information about the place of sighting 0 relative to all others, which the pairs with it give
pairs = np.sum(1 / between[0, 1:])
right = 1 / (variances[0] + 1 / W[1:].sum())
tempered = 2 / len(variances) * pairs
print(f"one coarse sighting: pairs {pairs:.3f}, tempered {tempered:.3f}, right {right:.3f}")
pairs, right = np.sum(1 / between[-1, :-1]), 1 / (variances[-1] + 1 / W[:-1].sum())
assert 0.15 < 2 / len(variances) * pairs / right < 0.25
print(f"one fine sighting:   pairs {pairs:.3f}, tempered {2 / len(variances) * pairs:.3f}, right {right:.3f}")

# %% band
from scipy.stats import chi2

widths = []
for logs in (10, 50, 200):
    d = logs * 3 * 62  # degrees of freedom: three for each pose
    low, high = chi2.ppf([0.025, 0.975], d) / d
    widths.append((high - low) * np.sqrt(logs))
    print(f"{logs:3} logs: a consistent estimate has a joint ANEES from {low:.3f} to {high:.3f} in 95 % of the studies")
assert np.ptp(widths) < 0.01 * widths[0]

# %% eight
K = 8
pair, proper = (K - 1) / 2, (K - 1) / K  # in units of 1 / sigma²
right = [K - 1, pair / proper, 2 / K]
np.testing.assert_allclose(right, [7, 4, 0.25])
print("edges, ratio, factor:", right)
ask(  # noqa: F821
    right,
    {
        ("A sighting makes no pair with itself", "センサ値は自分自身とは組になりません"): [8, 4, 0.25],
        ("The ratio is K / 2", "比はK / 2です"): [7, 7, 0.25],
    },
)

# %% nees_by_hand
e, claimed = np.array([0.2, 0.1]), np.diag([0.01, 0.01])
nees = e @ np.linalg.inv(claimed) @ e
right = [nees, nees / 2, np.sqrt(nees / 2)]  # gap
np.testing.assert_allclose(right, [5, 2.5, 1.5811], rtol=1e-4)
print(np.round(right, 4))
ask(  # noqa: F821
    right,
    {
        ("Standard deviations are the roots of variances", "標準偏差は分散の平方根です"): [5, 2.5, 2.5],
        ("Divide by the two degrees of freedom", "自由度の2で割ってください"): [5, 5, np.sqrt(5)],
    },
)
