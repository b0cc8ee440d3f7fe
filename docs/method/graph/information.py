# %% setup
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Ellipse

from graphslam import SensorModel, textbook

sensor = SensorModel()  # the book's: range 14 %, bearing and orientation 0.05 rad
x1, z1 = np.array([0.0, 0.0, 0.0]), np.array([4.0, 0.5, 0.2])  # pose, sighting (range, bearing, psi)
x2, z2 = np.array([3.0, -1.0, 0.8]), np.array([2.0, 0.9, 1.1])


# %% covariance
def covariance(x, z):
    """R Q R': the covariance of h^-1(x, z) that the noise of the sighting causes."""
    R = textbook.sighting_derivative(x, z)
    return R @ textbook.sighting_covariance(z, sensor) @ R.T


C1, C2 = covariance(x1, z1), covariance(x2, z2)
print("standard deviations of h^-1(x1, z1):", np.round(np.sqrt(np.diag(C1)), 3))
print("standard deviations of h^-1(x2, z2):", np.round(np.sqrt(np.diag(C2)), 3))
print("Omega of the edge:")
print(np.round(np.linalg.inv(C1 + C2), 1))
across, along = np.sqrt(np.linalg.eigvalsh(C1[:2, :2]))
np.testing.assert_allclose([along, across], [0.14 * 4.0, 0.05 * 4.0])


# %% ellipses
def draw_ellipse(ax, centre, C, **style):
    """Draw the ellipse of three standard deviations of a position."""
    values, vectors = np.linalg.eigh(C[:2, :2])
    angle = np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1]))
    ax.add_patch(Ellipse(centre, *(6 * np.sqrt(values[::-1])), angle=angle, fill=False, lw=2, **style))


fig, ax = plt.subplots()
for x, z, C, colour, name in ((x1, z1, C1, "C0", "1"), (x2, z2, C2, "C1", "2")):
    place = textbook.inverse_observation(x, z)
    ax.plot(x[0], x[1], "o", color=colour, label=f"pose {name}")
    ax.plot([x[0], place[0]], [x[1], place[1]], ":", color=colour)
    draw_ellipse(ax, place[:2], C, color=colour, label=f"landmark from pose {name}")
e = textbook.inverse_observation(x2, z2) - textbook.inverse_observation(x1, z1)
ax.annotate(
    "",
    textbook.inverse_observation(x2, z2)[:2],
    textbook.inverse_observation(x1, z1)[:2],
    arrowprops={"arrowstyle": "->"},
)
ax.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", xlim=(-0.5, 8))
ax.legend(loc="lower right")

# %% three
from graphslam import load

three = load("examples/three_poses.txt")
sum_3 = sum(covariance(three.initial_poses[t], three.sightings[t]) for t in (1, 2))
print(np.round(sum_3, 4))
np.testing.assert_allclose(np.diag(sum_3), [0.05**2 + (0.14 * 1.2) ** 2, 0.14**2 + (0.05 * 1.2) ** 2, 4 * 0.05**2])

# %% sampled
rng = np.random.default_rng(0)


def sample(x, z, count=20_000):
    """Draw sightings around z and return the landmarks that they place."""
    std = np.sqrt(np.diag(textbook.sighting_covariance(z, sensor)))
    return np.array([textbook.inverse_observation(x, z + std * n) for n in rng.standard_normal((count, 3))])


sampled = np.cov((sample(x2, z2) - sample(x1, z1)).T)
print("sampled:", np.round(np.diag(sampled), 3))
print("formula:", np.round(np.diag(C1 + C2), 3))
assert np.allclose(np.diag(sampled), np.diag(C1 + C2), rtol=5 * np.sqrt(2 / 20_000))

# %% wrong
R1, R2 = textbook.sighting_derivative(x1, z1), textbook.sighting_derivative(x2, z2)
Q1, Q2 = textbook.sighting_covariance(z1, sensor), textbook.sighting_covariance(z2, sensor)
slide = R1 @ Q1 @ R1.T + R1 @ Q2 @ R1.T  # as printed
print("variance of y, as printed:", round(slide[1, 1], 3), " right:", round((C1 + C2)[1, 1], 3))
assert slide[1, 1] < 0.9 * (C1 + C2)[1, 1]

# %% left
x, z = np.zeros(3), np.array([2.0, np.pi / 2, 0.0])
right = covariance(x, z)[:2, :2]  # gap
np.testing.assert_allclose(right, np.diag([(2 * 0.05) ** 2, (2 * 0.14) ** 2]), atol=1e-12)
print(np.round(right, 4) + 0.0)
ask(  # noqa: F821
    right,
    {
        (
            "The line of sight points along y: the error of the range acts along y",
            "ランドマークはy軸の方向にあるので、距離の誤差はy方向に現れます",
        ): right[::-1, ::-1],
        ("These are standard deviations; variances are asked", "それは標準偏差です。分散を答えてください"): np.sqrt(
            right
        ),
        ("That is Q; multiply it by R from both sides", "それはQです。両側からRをかけてください"): np.diag(
            [0.28**2, 0.05**2]
        ),
    },
)

# %% inverted
C_a = np.diag([(2 * 0.05) ** 2, (2 * 0.14) ** 2])  # the sighting of the exercise before
C_b = np.diag([0.14**2, 0.05**2])  # the other one: 1 m away, along x
right = np.diag(np.linalg.inv(C_a + C_b))  # gap
np.testing.assert_allclose(right, [1 / (0.01 + 0.0196), 1 / (0.0784 + 0.0025)])
misprint = [1 / (2 * 0.1**2), 1 / (0.28**2 + 0.14**2)]  # R_1 Q_1 R_1' + R_1 Q_2 R_1'
print(np.round(right, 2))
ask(  # noqa: F821
    right,
    {
        ("These are the covariances: invert their sum", "それは共分散の和です。逆行列を求めてください"): np.diag(
            C_a + C_b
        ),
        (
            "That has R_1 in both terms, as the slide prints it",
            "両方の項がR_1になっています（スライドの誤植）",
        ): misprint,
        (
            "Add the covariances first, and then invert the sum",
            "先に共分散を足してから、逆行列を求めてください",
        ): np.diag(np.linalg.inv(C_a) + np.linalg.inv(C_b)),
    },
)
