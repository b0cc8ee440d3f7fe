# %% setup
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Ellipse

from graphslam import SensorModel, textbook

sensor = SensorModel()  # range_rate 0.14, bearing_std 0.05, orientation_std 0.05
x1, z1 = np.array([0.0, 0.0, 0.0]), np.array([4.0, 0.5, 0.2])
x2, z2 = np.array([3.0, -1.0, 0.8]), np.array([2.0, 0.9, 1.1])


# %% covariance
def covariance(x, z):
    """R Q R': the covariance of h^-1(x, z), caused by the noise of the sighting."""
    R = textbook.sighting_derivative(x, z)
    return R @ textbook.sighting_covariance(z, sensor) @ R.T


C1, C2 = covariance(x1, z1), covariance(x2, z2)
Omega = np.linalg.inv(C1 + C2)
print(np.round(np.sqrt(np.diag(C1)), 3), np.round(np.sqrt(np.diag(C2)), 3))
print(np.round(Omega, 1))


# %% ellipses
def draw(ax, centre, C, label, colour):
    values, vectors = np.linalg.eigh(C[:2, :2])
    angle = np.degrees(np.arctan2(*vectors[::-1, 1]))
    ax.add_patch(Ellipse(centre, *(6 * np.sqrt(values[::-1])), angle=angle, fill=False, color=colour, label=label))


fig, ax = plt.subplots()
for x, z, C, colour, name in ((x1, z1, C1, "C0", "1"), (x2, z2, C2, "C1", "2")):
    place = textbook.inverse_observation(x, z)
    ax.plot(*x[:2], "o", color=colour)
    ax.plot([x[0], place[0]], [x[1], place[1]], ":", color=colour)
    draw(ax, place[:2], C, f"sighting {name}, 3 standard deviations", colour)
ax.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
ax.legend(loc="lower right")

# %% sampled
rng = np.random.default_rng(0)
noise = rng.standard_normal((2, 200_000, 3))
samples = [
    np.array(
        [
            textbook.inverse_observation(x, z + e)
            for e in n[:20_000] * np.sqrt(np.diag(textbook.sighting_covariance(z, sensor)))
        ]
    )
    for x, z, n in ((x1, z1, noise[0]), (x2, z2, noise[1]))
]
e = samples[1] - samples[0]
print("sampled ", np.round(np.cov(e.T), 3).tolist())
print("formula ", np.round(C1 + C2, 3).tolist())
