# %% setup
import matplotlib.pyplot as plt
import numpy as np

from fastslam import textbook
from graphslam import SensorModel

sensor = SensorModel()
pose = np.zeros(3)
landmark = textbook.Gaussian(np.array([2.0, 0.5, 0.3]), np.diag([0.02, 0.04, 0.01]))
z = np.array([2.2, 0.3, 0.05])

# %% integral
# <p(z | m)> over the landmark's Gaussian, by two million random landmarks, and by the formula
rng = np.random.default_rng(0)
m = landmark.mean + rng.standard_normal((2_000_000, 3)) * np.sqrt(np.diag(landmark.covariance))
Q = np.diag(sensor.Q(z))
predicted = sensor.h(np.tile(pose, (len(m), 1)), m)
e = z - predicted
likelihoods = np.exp(-0.5 * np.sum(e**2 / Q, axis=1)) / np.sqrt((2 * np.pi) ** 3 * np.prod(Q))
print(f"mean of the likelihoods {likelihoods.mean():.4f}")
print(f"formula                 {np.exp(textbook.log_likelihood(pose, landmark, z, sensor)):.4f}")
assert np.isclose(likelihoods.mean(), np.exp(textbook.log_likelihood(pose, landmark, z, sensor)), rtol=0.03)

# %% figure
# the likelihood of a range, for a landmark that is known well and for one that is not
ranges = np.linspace(1, 3.5, 200)
fig, ax = plt.subplots()
for variance, colour in ((0.001, "C0"), (0.3, "C1")):
    uncertain = textbook.Gaussian(np.array([2.0, 0.0]), variance * np.eye(2))
    V = textbook.innovation_covariance(pose, uncertain, np.array([2.0, 0.0]), sensor)[0, 0]
    ax.plot(
        ranges,
        np.exp(-0.5 * (ranges - 2.0) ** 2 / V) / np.sqrt(2 * np.pi * V),
        colour,
        label=f"standard deviation of the landmark {np.sqrt(variance):.2f} m",
    )
ax.set(xlabel="measured range [m]", ylabel="density of the sighting", ylim=(0, 1.9))
ax.legend()

# %% determinant
# two particles with the same residual; the second knows the landmark less well
exponentials, weights = [], []
for name, S in (("certain", 0.01 * np.eye(3)), ("uncertain", 0.5 * np.eye(3))):
    particle = textbook.Gaussian(landmark.mean, S)
    r = textbook.residual(pose, particle, z, sensor)
    V = textbook.innovation_covariance(pose, particle, z, sensor)
    exponential, weight = np.exp(-0.5 * r @ np.linalg.solve(V, r)), np.exp(textbook.log_density(r, V))
    exponentials.append(exponential)
    weights.append(weight)
    print(f"{name:10} exp(-r' V^-1 r / 2) = {exponential:.3f}, with the determinant {weight:.3f}")
assert exponentials[0] < exponentials[1]
assert weights[0] > weights[1]

# %% logarithms
# 400 sightings with a density of 0.1 each
print("product:", 0.1**400, " sum of logarithms:", round(400 * np.log(0.1), 1))
assert 0.1**400 == 0

# %% density
V = 0.05 + 0.04
right = [V, np.exp(-0.5 * 0.3**2 / V) / np.sqrt(2 * np.pi * V)]  # gap
np.testing.assert_allclose(right[1], np.exp(textbook.log_density(np.array([0.3]), np.array([[V]]))))
print(np.round(right, 4))
ask(  # noqa: F821
    right,
    {
        (
            "The factor before the exponential is missing: 1 / sqrt(2 pi V)",
            "指数関数の前の係数1 / √(2πV)がありません",
        ): [0.09, np.exp(-0.5)],
        ("V has the uncertainty of the map as well", "Vには地図の不確かさも含まれます"): [
            0.04,
            np.exp(-0.5 * 0.09 / 0.04) / np.sqrt(2 * np.pi * 0.04),
        ],
    },
)

# %% normalised
before, factors = np.array([0.25, 0.75]), np.array([0.8, 0.2])
right = before * factors / (before @ factors)  # gap
np.testing.assert_allclose(right, [4 / 7, 3 / 7])
print(np.round(right, 4))
ask(  # noqa: F821
    right,
    {
        ("Normalise: the weights have the sum 1", "和が1になるように正規化してください"): before * factors,
        ("Multiply by the weights from before", "これまでの重みをかけてください"): [0.8, 0.2],
    },
)
