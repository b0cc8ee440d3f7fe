# %% setup
import matplotlib.pyplot as plt
import numpy as np

from graphslam import SensorModel, textbook

x1, z1 = np.array([0.0, 0.0, 0.2]), np.array([3.0, 0.4, 0.3])
x2, z2 = np.array([1.0, 0.5, 0.9]), np.array([2.2, -0.1, 0.5])
e, Omega, B1, B2 = textbook.virtual_motion_edge(x1, z1, x2, z2, SensorModel())

# %% jacobians
print("B_1 =\n", np.round(B1, 3))
print("B_2 =\n", np.round(B2, 3))
for B, sign, x, (length, bearing, _) in ((B1, -1, x1, z1), (B2, 1, x2, z2)):
    along = x[2] + bearing
    np.testing.assert_allclose(B[:, 2], sign * np.array([-length * np.sin(along), length * np.cos(along), 1]))

# %% figure
# the first component of e while pose 2 turns, and its tangent
turns = np.linspace(-1.2, 1.2, 121)
exact = [textbook.virtual_motion_edge(x1, z1, x2 + [0, 0, turn], z2, SensorModel())[0][0] for turn in turns]
fig, ax = plt.subplots()
ax.plot(turns, exact, label="e_x")
ax.plot(turns, e[0] + B2[0, 2] * turns, "--", label="linearised: e_x + B_2 Delta x_2")
ax.axvline(0, color="k", lw=0.5)
ax.set(xlabel="turn of pose 2 [rad]", ylabel="residual in x [m]")
ax.legend()

# %% three
from graphslam import load

three = load("examples/three_poses.txt")
(_, x_a, x_b), (_, z_a, z_b) = three.initial_poses, three.sightings
_, _, B_a, B_b = textbook.virtual_motion_edge(x_a, z_a, x_b, z_b, SensorModel())
print("B_1 =\n", np.round(B_a, 3) + 0.0)
print("B_2 =\n", np.round(B_b, 3) + 0.0)
np.testing.assert_allclose([B_a[:, 2], B_b[:, 2]], [[1, 0, -1], [0, -1.2, 1]], atol=1e-12)


# %% differences
# central differences of the residual, one column for each component of a pose
def numerical(which, step=1e-6):
    columns = []
    for k in range(3):
        d = np.zeros(3)
        d[k] = step
        poses = [(x1 + s * d, x2) if which == 1 else (x1, x2 + s * d) for s in (1, -1)]
        plus, minus = (textbook.virtual_motion_edge(a, z1, b, z2, SensorModel())[0] for a, b in poses)
        columns.append((plus - minus) / (2 * step))
    return np.column_stack(columns)


print("agrees with B_1:", np.abs(numerical(1) - B1).max() < 1e-8)
print("agrees with B_2:", np.abs(numerical(2) - B2).max() < 1e-8)
assert np.abs(numerical(1) - B1).max() < 1e-8 and np.abs(numerical(2) - B2).max() < 1e-8

# %% range
wrong = []
for turn in (0.01, 0.1, 1.0):
    exact = textbook.virtual_motion_edge(x1, z1, x2 + [0, 0, turn], z2, SensorModel())[0]
    linear = e + B2 @ [0, 0, turn]
    wrong.append(np.linalg.norm((exact - linear)[:2]))
    print(f"turn {turn:4g} rad: error of the linear formula {wrong[-1]:.4f} m")
assert 80 < wrong[1] / wrong[0] < 120
assert 80 < wrong[2] / wrong[1] < 120

# %% lever
x, z = np.array([1.0, 2.0, np.pi / 6]), np.array([2.0, np.pi / 3, 0.0])
right = np.array([[1, 0, -z[0] * np.sin(x[2] + z[1])], [0, 1, z[0] * np.cos(x[2] + z[1])], [0, 0, 1]])  # gap
np.testing.assert_allclose(right, textbook.pose_derivative(x, z), atol=1e-12)
print(np.round(right, 3) + 0.0)
ask(  # noqa: F821
    right,
    {
        (
            "That is R, the derivative by the sensor values; B_2 is the derivative by the pose",
            "それはセンサ値による微分Rです。B_2は姿勢による微分です",
        ): textbook.sighting_derivative(x, z),
        ("The direction is theta + phi, not phi alone", "方向はφではなくθ + φです"): [
            [1, 0, -2 * np.sin(np.pi / 3)],
            [0, 1, 2 * np.cos(np.pi / 3)],
            [0, 0, 1],
        ],
    },
)

# %% predicted
Delta = np.array([0.05, 0.0, 0.1])
right = textbook.pose_derivative(x, z) @ Delta  # gap
np.testing.assert_allclose(right, [0.05 - 2 * 0.1, 0, 0.1], atol=1e-12)
print(np.round(right, 4) + 0.0)
ask(  # noqa: F821
    right,
    {
        ("The turn moves the landmark, too", "回転によってもランドマークは動きます"): Delta,
    },
    unit="m, m, rad",
)
