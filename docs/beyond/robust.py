# %% setup
import matplotlib.pyplot as plt
import numpy as np

from graphslam import Cauchy, GemanMcClure, Graph, Huber, simulate, solve
from graphslam.metrics import ate

log = simulate(seed=0, clean=True)
rng = np.random.default_rng(1000)
sightings = log.sightings.copy()
wrong = rng.choice(len(sightings), len(sightings) // 10, replace=False)  # every tenth sighting is a phantom
sightings[wrong, 0] = rng.uniform(0.5, 6, len(wrong))
sightings[wrong, 1] = rng.uniform(-np.pi / 3, np.pi / 3, len(wrong))
sightings[wrong, 2] = rng.uniform(-np.pi, np.pi, len(wrong))
bad = log.replace(sightings=sightings)

# %% kernels
r = np.linspace(0, 10, 400)
fig, (left, right) = plt.subplots(1, 2, figsize=(8, 3.4))
for kernel, line in ((None, "k:"), (Huber(), "C0-"), (Cauchy(), "C1--"), (GemanMcClure(), "C2-.")):
    name, k = ("squares", None) if kernel is None else (kernel.name, kernel.of_dimension(3))
    left.plot(r, r**2 if k is None else k.loss(r**2), line, label=name)
    right.plot(r, np.ones_like(r) if k is None else k.weight(r**2), line, label=name)
left.set(xlabel="r", ylabel="2 rho(r)", ylim=(0, 40))
right.set(xlabel="r", ylabel="weight w(r)")
right.legend()

# %% compare
clean = ate(log.true_poses, solve(Graph.from_log(log, weight="marginal")).poses)
print(f"{'no wrong sighting':18} ATE {clean:.3f} m")
errors = {}
for kernel in ("none", "huber", "cauchy", "geman-mcclure"):
    solution = solve(Graph.from_log(bad, weight="marginal", kernel=kernel))
    errors[kernel] = ate(log.true_poses, solution.poses)
    print(f"{kernel:18} ATE {errors[kernel]:.3f} m")
assert errors.pop("none") > 2 * clean
assert max(errors.values()) < 1.1 * clean
trusted = solve(Graph.from_log(bad, weight="marginal"), method="gnc")
print(f"{'gnc':18} ATE {ate(log.true_poses, trusted.poses):.3f} m; {trusted.notes[-1]}")

# %% trust
fig, ax = plt.subplots(figsize=(6.4, 2.8))
ax.plot(trusted.trust, ".", label="correct sighting")
ax.plot(wrong, trusted.trust[wrong], "rx", label="phantom")
ax.set(xlabel="sighting", ylabel="trust")
ax.legend(loc="center right")

# %% annealing
squares, c2 = np.linspace(0, 30, 300), 11.34  # c²: the 99 % quantile of chi-square with 3 degrees of freedom


def draw(mu):
    """The trust as a function of r² for one mu."""
    _, ax = plt.subplots(figsize=(6.4, 3))
    with np.errstate(divide="ignore"):
        w = np.sqrt(c2 * mu * (mu + 1)) / np.sqrt(squares) - mu
    ax.plot(squares, np.clip(w, 0, 1))
    ax.axvline(c2, color="k", ls=":", label="c²")
    ax.set(xlabel="r²", ylabel="trust w", ylim=(-0.05, 1.05), title=f"mu = {mu}")
    ax.legend()


slider("mu", [0.1, 0.5, 2, 10, 100], draw)  # noqa: F821  # given by the site: one figure for each value

# %% minimum
kernel = Cauchy().of_dimension(3)
c = kernel.width
h = 1e-6
for value in (0.5, 2.0, 8.0):
    slope = (kernel.loss((value + h) ** 2) - kernel.loss((value - h) ** 2)) / (4 * h)  # d rho / dr
    print(f"r = {value}: rho'(r) / r = {slope / value:.6f}, w(r) = {float(kernel.weight(value**2)):.6f}")
    assert np.isclose(slope / value, float(kernel.weight(value**2)), rtol=1e-6)

# %% missed
found = trusted.trust < 0.5
print("phantoms rejected:", int(found[wrong].sum()), "of", len(wrong))
print("correct sightings rejected:", int(found.sum() - found[wrong].sum()), "of", len(found) - len(wrong))
assert found[wrong].all()

# %% location
numbers = np.concatenate([rng.normal(0, 1, 20), [12.0, 15.0]])  # twenty good measurements of 0, and two wrong ones


def estimate(values, kernel=None, rounds=50):
    """The place that minimises the sum of 2 rho(r), by iterated weights."""
    m = np.median(values)
    for _ in range(rounds):
        w = np.ones_like(values) if kernel is None else kernel.of_dimension(1).weight((values - m) ** 2)
        m = np.sum(w * values) / np.sum(w)
    return m


for name, kernel in (("mean", None), ("Huber", Huber()), ("Cauchy", Cauchy()), ("Geman-McClure", GemanMcClure())):
    print(f"{name:14} {estimate(numbers, kernel):6.3f}")
assert estimate(numbers) > 1 > 3 * estimate(numbers, Huber()) > 3 * estimate(numbers, GemanMcClure())

# %% efficiency
samples = rng.normal(0, 1, (2000, 40))
plain = np.var([estimate(row) for row in samples])
for name, kernel in (("Huber", Huber()), ("Cauchy", Cauchy())):
    print(f"{name:7} efficiency {plain / np.var([estimate(row, kernel, 15) for row in samples]):.3f}")
    assert abs(plain / np.var([estimate(row, kernel, 15) for row in samples]) - 0.95) < 0.03

# %% three_weights
c, r = 2.0, 4.0
right = [c / r, 1 / (1 + (r / c) ** 2), (c**2 / (c**2 + r**2)) ** 2]  # gap
rho = [
    lambda s: c * (s - c / 2),
    lambda s: c**2 / 2 * np.log(1 + s**2 / c**2),
    lambda s: c**2 / 2 * s**2 / (c**2 + s**2),
]
np.testing.assert_allclose(right, [(f(r + 1e-6) - f(r - 1e-6)) / 2e-6 / r for f in rho], rtol=1e-6)
print(np.round(right, 4))
ask(  # noqa: F821
    right,
    {
        ("The weight is rho'(r) / r: divide by r", "重みはρ'(r) / rです。rで割ってください"): np.multiply(right, r),
    },
)

# %% ten
c, r = 2.0, 10.0
right = [2 * c * (r - c / 2), c**2 * np.log(1 + r**2 / c**2), c**2 * r**2 / (c**2 + r**2)]  # gap
np.testing.assert_allclose(right, [2 * f(r) for f in rho])
print(np.round(right, 3))
ask(right, {("That is r squared", "それはrの2乗です"): 3 * [100.0]})  # noqa: F821
