# %% setup
import matplotlib.pyplot as plt
import numpy as np

from graphslam import Graph, MotionModel, SensorModel, calibrate, load, simulate, solve
from graphslam.metrics import ate
from graphslam.simulation.simulator import MotionFaults, SensorFaults

# %% times
log = load("examples/own_robot")
print(log)
print(f"{len(log.controls)} controls for {log.num_poses - 1} motions; composite motions: {log.composite}")
print("times of the first poses [s]:", log.times[:6].round(3))
assert log.composite

# %% biases
steady = MotionFaults(velocity_bias_std=0.0)  # the wheels still slip on pebbles
sharp = SensorFaults(range_bias_rate_std=0.0, bearing_bias_std=0.0, orientation_bias_std=0.0)
cases = {
    "book's simulator": {},
    "no sensor bias": {"sensor_faults": sharp},
    "no speed bias": {"motion_faults": steady},
    "noise alone": {"sensor_faults": sharp, "motion_faults": steady},
}
medians = {}
for name, faults in cases.items():
    errors, ratios = [], []
    for seed in range(8):
        log = simulate(seed=seed, **faults)
        solution = solve(Graph.from_log(log, edges="landmark+motion"))
        errors.append(ate(log.true_poses, solution.poses))
        ratios.append(np.nanmean(solution.nees(log.true_poses)))
    medians[name] = np.median(errors)
    print(f"{name:17} median ATE {medians[name]:.3f} m, mean NEES {np.mean(ratios):.2f}")
assert medians["noise alone"] < medians["no sensor bias"] < medians["no speed bias"] < medians["book's simulator"]

# %% calibration
motion, sensor = MotionModel.constant(0.05, 0.05), SensorModel(range_rate=0.0, range_std=0.05, bearing_std=0.02)
true = simulate(seed=1, clean=True, steps=200, motion=motion, sensor=sensor)
measured = true.sightings.copy()
measured[:, 0] = 1.05 * measured[:, 0]  # the range finder reads 5 % too much
controls = true.controls.copy()
controls[:, 1] += 0.02  # the gyroscope has a bias of 0.02 rad/s
drive = true.replace(sightings=measured, controls=controls, initial_poses=None)
found = calibrate(drive)
for name in ("range_scale", "wheel_scale", "turn_rate_bias"):
    print(f"{name:15} {found.numbers[name]:.4f} +- {found.errors.get(name, np.nan):.4f}")
assert abs(found.numbers["range_scale"] - 1.05) < 0.005 and abs(found.numbers["turn_rate_bias"] - 0.02) < 0.005

# %% corrected
errors = []
for name, used in (("as recorded", drive), ("corrected", found.apply(drive))):
    solution = solve(Graph.from_log(used, edges="landmark+motion", motion=found.motion, sensor=found.sensor))
    errors.append(ate(true.true_poses, solution.poses))
    print(f"{name:12} ATE {errors[-1]:.3f} m")
assert errors[1] < errors[0]


# %% correlated
rng = np.random.default_rng(0)
K, std, trials = 100, 0.05, 4000  # a robot stands still and measures the range of one tag 100 times
correlations = np.array([0.0, 0.3, 0.6, 0.8, 0.9, 0.95])
nees = []
for rho in correlations:
    errors = np.empty((trials, K))
    errors[:, 0] = rng.normal(0, std, trials)
    for k in range(1, K):  # each error keeps a part rho of the one before; the variance stays the same
        errors[:, k] = rho * errors[:, k - 1] + np.sqrt(1 - rho**2) * rng.normal(0, std, trials)
    nees.append(np.mean(errors.mean(axis=1) ** 2 / (std**2 / K)))  # claimed variance of the mean: std² / K
    print(f"correlation {rho:4}: NEES of the mean {nees[-1]:5.2f}")
assert np.isclose(nees[0], 1, atol=5 * np.sqrt(2 / trials)) and np.all(np.diff(nees) > 0)

# %% figure
fig, ax = plt.subplots(figsize=(6.4, 3.2))
fine = np.linspace(0, 0.96, 200)
ax.semilogy(fine, (1 + fine) / (1 - fine), "k:", label="(1 + rho) / (1 - rho)")
ax.semilogy(correlations, nees, "o", label="simulated")
ax.axhline(1, color="C2", label="consistent")
ax.set(xlabel="correlation rho of neighbouring errors", ylabel="NEES")
ax.legend()

# %% scale
costs = []
for scale in (0.9, 1.0, 1.1):
    stretched = true.sightings.copy()  # wheels and ranges are both wrong by the same factor
    stretched[:, 0] *= scale
    both = true.replace(sightings=stretched, controls=true.controls * [scale, 1.0], initial_poses=None)
    solution = solve(Graph.from_log(both, edges="landmark+motion", motion=motion, sensor=sensor))
    costs.append(solution.cost)
    print(f"everything times {scale}: J {solution.cost:8.2f}, ATE {ate(true.true_poses, solution.poses):.3f} m")
assert costs == sorted(costs)  # the smallest world has the smallest J

# %% worth
rho, n = 0.8, 90
ratio = (1 + rho) / (1 - rho)
right = [n / ratio, np.sqrt(ratio)]  # gap
np.testing.assert_allclose(right, [10, 3])
print("independent sightings:", round(right[0], 2), " factor of the standard deviation:", round(right[1], 2))
ask(  # noqa: F821
    right,
    {
        (
            "The variance is 9 times as large; the standard deviation is its root",
            "9倍になるのは分散です。標準偏差はその平方根です",
        ): [10, 9],
        ("Divide by (1 + rho) / (1 - rho)", "(1 + ρ) / (1 − ρ)で割ってください"): [90 * 0.2, 3],
    },
)

# %% what_remains
distance, scale_error, noise_std, count = 5.0, 0.04, 0.1, 25
right = [scale_error * distance, noise_std / np.sqrt(count)]  # gap
np.testing.assert_allclose(right, [0.2, 0.02])
print(np.round(right, 4))
ask(  # noqa: F821
    right,
    {
        ("A constant error does not become smaller by averaging", "一定の誤差は、平均しても小さくなりません"): [
            0.04,
            0.02,
        ],
        (
            "The standard deviation of a mean falls with the root of the number",
            "平均の標準偏差は、個数の平方根に反比例します",
        ): [0.2, 0.004],
    },
    unit="m",
)
