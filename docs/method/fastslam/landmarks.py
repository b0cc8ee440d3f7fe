# %% setup
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Ellipse

from fastslam import textbook
from graphslam import SensorModel

sensor = SensorModel()
pose, landmark = np.zeros(3), np.array([2.0, 1.0, 0.5])
rng = np.random.default_rng(0)


def sighting(pose):
    """A sighting of the landmark with the noise of the sensor."""
    z = sensor.h(pose, landmark)
    return z + np.sqrt(np.diag(sensor.Q(z))) * rng.standard_normal(3)


# %% update
estimate = textbook.initialize_landmark(pose, sighting(pose), sensor)
for k in range(1, 6):
    z = sighting(pose)
    estimate = textbook.update_landmark(pose, estimate, z, sensor)
    std = np.sqrt(np.diag(estimate.covariance))
    print(f"after {k + 1} sightings: mean {np.round(estimate.mean, 2)}, standard deviations {np.round(std, 3)}")
    assert np.all(std > 0.025)

# %% figure
fig, ax = plt.subplots()
rng = np.random.default_rng(1)
poses = [np.array([0.0, 0.0, 0.3]), np.array([1.0, -0.8, 1.2]), np.array([2.6, -0.6, 1.8]), np.array([3.6, 0.6, 2.9])]
estimate = None
for k, x in enumerate(poses):
    z = sighting(x)
    estimate = (
        textbook.initialize_landmark(x, z, sensor)
        if estimate is None
        else textbook.update_landmark(x, estimate, z, sensor)
    )
    values, vectors = np.linalg.eigh(estimate.covariance[:2, :2])
    angle = np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1]))
    ax.add_patch(
        Ellipse(
            estimate.mean[:2],
            *(4 * np.sqrt(values[::-1])),
            angle=angle,
            fill=False,
            color=f"C{k}",
            lw=2,
            label=f"after sighting {k + 1}",
        )
    )
    ax.plot(*x[:2], "o", color=f"C{k}")
ax.plot(*landmark[:2], "k*", ms=12, label="landmark")
ax.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", xlim=(-0.5, 5))
ax.legend(fontsize=8)

# %% gain
moved = []
for scale in (0.01, 1.0, 100.0):
    prior = textbook.Gaussian(np.array([2.3, 1.0, 0.5]), scale * 0.05 * np.eye(3))
    after = textbook.update_landmark(pose, prior, sensor.h(pose, landmark), sensor)
    print(f"prior variance {scale * 0.05:7.4f}: x moves from 2.3 to {after.mean[0]:.3f} (sighting: {landmark[0]})")
    moved.append((after.mean[0] - 2.3) / (landmark[0] - 2.3))
assert moved[0] < 0.1 and moved[2] > 0.9

# %% information
# the information form of the same update: Sigma^-1 grows by H' Q^-1 H
prior = textbook.Gaussian(np.array([2.1, 0.9, 0.4]), np.diag([0.1, 0.2, 0.05]))
z = sensor.h(pose, landmark)
after, H = textbook.update_landmark(pose, prior, z, sensor), sensor.H(pose, prior.mean)
information = np.linalg.inv(prior.covariance) + H.T @ np.linalg.inv(sensor.Q(z)) @ H
print("equal:", np.allclose(np.linalg.inv(after.covariance), information))
assert np.allclose(np.linalg.inv(after.covariance), information)

# %% derivative
x, m = np.zeros(3), np.array([3.0, 4.0])
right = sensor.H(x, m)  # gap
np.testing.assert_allclose(right, [[3 / 5, 4 / 5], [-4 / 25, 3 / 25]], atol=1e-12)
print(np.round(right, 3))
ask(  # noqa: F821
    right,
    {
        ("The second row is divided by the square of the range", "2行目は距離の2乗で割ります"): [
            [0.6, 0.8],
            [-0.8, 0.6],
        ],
    },
)

# %% scalar
Sigma, H, Q, surprise = 0.04, 1.0, 0.01, 0.5
K = Sigma * H / (Q + H * Sigma * H)
right = [K, K * surprise, (1 - K * H) * Sigma]  # gap
np.testing.assert_allclose(right, [0.8, 0.4, 0.008])
np.testing.assert_allclose(1 / right[2], 1 / Sigma + 1 / Q)
print(np.round(right, 4))
ask(  # noqa: F821
    right,
    {
        (
            "The gain is near 1 where the sensor is more certain than the map",
            "センサのほうが地図より確かなら、ゲインは1に近くなります",
        ): [0.2, 0.1, 0.032],
        ("The covariance becomes (1 - K H) Sigma", "共分散は(1 − KH)Σになります"): [0.8, 0.4, 0.032],
    },
)
