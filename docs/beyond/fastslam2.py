# %% setup
import matplotlib.pyplot as plt
import numpy as np

from fastslam import FastSLAM1, FastSLAM2
from graphslam import SensorModel, simulate

rng = np.random.default_rng(0)


def normal(x, mean, std):
    """The Gaussian density."""
    return np.exp(-0.5 * ((x - mean) / std) ** 2) / (np.sqrt(2 * np.pi) * std)


# %% problem
motion_std, range_std, z = 0.8, 0.1, 1.6  # the robot moves along a line; a landmark stands at (2, 1)


def h(x):
    """The range to the landmark."""
    return np.hypot(2 - x, 1)


def proposal():
    """The motion N(0, motion_std²), corrected by z with h linearised: mean and standard deviation."""
    H = (0 - 2) / h(0)  # dh/dx at the prediction
    K = motion_std**2 * H / (H**2 * motion_std**2 + range_std**2)
    return K * (z - h(0)), motion_std * np.sqrt(1 - K * H)


grid = np.linspace(-4, 8, 6001)
posterior = normal(grid, 0, motion_std) * normal(z, h(grid), range_std)
posterior /= posterior.sum() * (grid[1] - grid[0])
mean, std = proposal()

fig, ax = plt.subplots()
ax.plot(grid, normal(grid, 0, motion_std), "C0:", label="motion p(x), the proposal of FastSLAM 1.0")
ax.plot(grid, normal(grid, mean, std), "C1--", label="corrected q(x), the proposal of FastSLAM 2.0")
ax.plot(grid, posterior, "k", label="p(x | z), exact")
ax.set(xlabel="x [m]", xlim=(-2, 3), ylim=(0, 6))
ax.legend(loc="upper left")

# %% weights
N = 100_000
moved, drawn = motion_std * rng.standard_normal(N), mean + std * rng.standard_normal(N)
weights = {
    "1.0: p(z | x)": (moved, normal(z, h(moved), range_std)),
    "2.0, original: constant here": (drawn, np.ones(N)),
    "2.0, exact: p(z | x) p(x) / q(x)": (
        drawn,
        normal(z, h(drawn), range_std) * normal(drawn, 0, motion_std) / normal(drawn, mean, std),
    ),
}
exact = (grid * posterior).sum() * (grid[1] - grid[0])
print(f"{'exact posterior':34} mean {exact:.3f}")
means, shares = [], []
for name, (x, w) in weights.items():
    w = w / w.sum()
    means.append((w * x).sum())
    shares.append(1 / (w**2).sum() / N)
    print(f"{name:34} mean {means[-1]:.3f}  ESS / N {shares[-1]:.2f}")
# against four standard errors of a mean of so many samples
assert abs(means[1] - exact) > 4 * std / np.sqrt(N) > abs(means[2] - exact) and shares[2] < shares[1]

# %% filters
sensor = SensorModel(range_rate=0.014, bearing_std=0.005, orientation_std=0.005)  # a tenth of the book's noise
log = simulate(seed=0, clean=True, sensor=sensor)
filters = {}
for method in (FastSLAM1, FastSLAM2):
    errors, sizes = [], []
    for seed in range(5):
        result = method(log, particles=100, seed=seed, sensor=sensor).run()
        errors.append(np.sqrt(np.mean((result.poses - log.true_poses)[:, :2] ** 2)))
        sizes.append(np.mean(result.ess))
    filters[method] = np.median(errors), np.median(sizes)
    print(f"{method.__name__}: position error {np.median(errors):.3f} m, mean ESS {np.median(sizes):.1f} of 100")
assert filters[FastSLAM2][0] < filters[FastSLAM1][0]
assert round(filters[FastSLAM2][1] / filters[FastSLAM1][1]) == 16

# %% narrow
sizes = {}
for range_std in (0.5, 0.1, 0.02):
    mean, std = proposal()
    drawn = mean + std * rng.standard_normal(N)
    w1 = normal(z, h(moved), range_std)
    w2 = normal(z, h(drawn), range_std) * normal(drawn, 0, motion_std) / normal(drawn, mean, std)
    sizes[range_std] = [w.sum() ** 2 / (w**2).sum() / N for w in (w1, w2)]
    print(f"sensor noise {range_std} m: ESS / N {sizes[range_std][0]:.3f} (1.0), {sizes[range_std][1]:.3f} (2.0)")
assert sizes[0.02][1] < 0.1 < sizes[0.1][1]

# %% linear
H_line, z_line, prior_std, noise = -1.0, 1.6, 0.8, 0.1  # h(x) = 2 - x: a landmark straight ahead
gain = prior_std**2 * H_line / (H_line**2 * prior_std**2 + noise**2)
m, s = gain * (z_line - 2), prior_std * np.sqrt(1 - gain * H_line)
x = m + s * rng.standard_normal(5)
w = normal(z_line, 2 - x, noise) * normal(x, 0, prior_std) / normal(x, m, s)
print("exact weights:", w.round(6), " N(z; h(m), H P H' + V):", normal(z_line, 2, np.hypot(prior_std, noise)).round(6))
assert np.allclose(w, normal(z_line, 2, np.hypot(prior_std, noise)))

# %% number
needed = {noise: 100 * ess2 / ess1 for noise, (ess1, ess2) in sizes.items()}
for noise, count in needed.items():
    print(f"sensor noise {noise} m: 100 particles of 2.0 are worth {count:.0f} of 1.0")
assert needed[0.02] < 100 < needed[0.5] < needed[0.1]

# %% corrected
P, H_x, z_measured, h_predicted, noise = 0.64, -1.0, 1.6, 2.0, 0.01
K = P * H_x / (H_x * P * H_x + noise)
right = [K * (z_measured - h_predicted), (1 - K * H_x) * P]  # gap
np.testing.assert_allclose(1 / right[1], 1 / P + 1 / noise)
np.testing.assert_allclose(right[0], right[1] * (2 - z_measured) / noise)
print(np.round(right, 5))
ask(  # noqa: F821
    right,
    {
        ("The proposal takes the sighting into account", "提案分布にはセンサ値を反映させてください"): [0.0, 0.64],
        (
            "That is V, the variance of the difference between sighting and prediction",
            "それはセンサ値と予測の差の分散Vです",
        ): [right[0], 0.65],
    },
)

# %% importance
likelihood, prior_density, proposal_density = 0.5, 0.2, 0.4
right = likelihood * prior_density / proposal_density  # gap
np.testing.assert_allclose(right, 0.25)
print("weight:", right)
ask(  # noqa: F821
    right,
    {
        ("Divide by the density q from which the pose was drawn", "姿勢を引いた分布qの密度で割ってください"): 1.0,
        ("That is the weight of FastSLAM 1.0, which draws from p(x)", "それはp(x)から引くFastSLAM 1.0の重みです"): 0.5,
    },
)
