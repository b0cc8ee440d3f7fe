# %% setup
import matplotlib.pyplot as plt
import numpy as np

from graphslam import MotionModel, SensorModel, load, sample_log_path, textbook

log = load(sample_log_path())

# %% figure
# true poses with their motion edges, and the virtual-motion edges of one landmark
used, landmark = range(16, 30), 7
seen = [t for t in log.steps[log.landmarks == landmark] if t in used]
x, m = log.true_poses, log.true_landmarks[landmark]
fig, ax = plt.subplots()
for t in used[1:]:
    ax.annotate("", x[t, :2], x[t - 1, :2], arrowprops={"arrowstyle": "->", "color": "C0"})
pairs = [(t1, t2) for k, t1 in enumerate(seen) for t2 in seen[k + 1 :]]
assert len(pairs) == 28 == len(seen) * (len(seen) - 1) / 2
for t1, t2 in pairs:
    ax.plot(x[[t1, t2], 0], x[[t1, t2], 1], "C1-", lw=0.8)
for t in seen:
    ax.plot([x[t, 0], m[0]], [x[t, 1], m[1]], "k:", lw=0.5)
ax.plot(x[used, 0], x[used, 1], "C0o", ms=4, label="poses, and motion edges as arrows")
ax.plot(m[0], m[1], "k*", ms=12, label="landmark, with its eight sightings")
ax.plot([], [], "C1-", label="its 28 virtual-motion edges")
ax.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
ax.legend(fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0))

# %% motion
motion = MotionModel()
x1, u, dt = log.initial_poses[0], log.controls[0], log.dt[0]
x2 = motion.f(x1, u, dt)
for moved in (x2, x2 + [0.1, 0.0, 0.0]):
    e, Omega, B1, B2 = textbook.motion_edge(x1, moved, u, dt, motion)
    print("residual", np.round(e, 3) + 0.0, " cost", round(float(e @ Omega @ e), 2))
    np.testing.assert_allclose(e, moved - x2, atol=1e-12)

# %% residual
x1, x2 = np.array([0.0, 0.0, 0.0]), np.array([1.0, 0.0, np.pi / 2])
z1, z2 = np.array([2.0, 0.0, 0.0]), np.array([1.1, -np.pi / 2, 0.0])
e, Omega, B1, B2 = textbook.virtual_motion_edge(x1, z1, x2, z2, SensorModel())
print("from pose 1 the landmark is at", np.round(textbook.inverse_observation(x1, z1), 3))
print("from pose 2 the landmark is at", np.round(textbook.inverse_observation(x2, z2), 3))
print("residual", np.round(e, 3))
assert np.allclose(e, [0.1, 0, 0])

# %% three
three = load("examples/three_poses.txt")
for a_3, b_3 in ((0, 1), (0, 2), (1, 2)):
    (x_a, x_b), (z_a, z_b) = three.initial_poses[[a_3, b_3]], three.sightings[[a_3, b_3]]
    e_3, *_ = textbook.virtual_motion_edge(x_a, z_a, x_b, z_b, SensorModel())
    print(f"e_{a_3}{b_3} =", np.round(e_3, 4))
np.testing.assert_allclose(e_3, [-0.2, 0, 0.1], atol=1e-12)

# %% wrapped
x1, z1 = np.array([0.0, 0.0, 3.1]), np.array([1.0, 0.0, 0.0])
x2, z2 = np.array([0.0, 0.0, -3.1]), np.array([1.0, 0.0, 0.0])
difference = textbook.inverse_observation(x2, z2) - textbook.inverse_observation(x1, z1)
e, *_ = textbook.virtual_motion_edge(x1, z1, x2, z2, SensorModel())
print("difference", np.round(difference[2], 3), " normalised", np.round(e[2], 3))
assert abs(difference[2]) > np.pi > abs(e[2])


# %% turned
# the residual of the world frame changes when the whole world is rotated, its length does not
def rotated(x, angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * x[0] - s * x[1], s * x[0] + c * x[1], x[2] + angle])


x1, x2 = np.array([0.0, 0.0, 0.0]), np.array([1.0, 0.0, np.pi / 2])
z1, z2 = np.array([2.0, 0.0, 0.0]), np.array([1.1, -np.pi / 2, 0.0])
costs = []
for angle in (0.0, 1.0):
    e, Omega, *_ = textbook.virtual_motion_edge(rotated(x1, angle), z1, rotated(x2, angle), z2, SensorModel())
    costs.append(float(e @ Omega @ e))
    print("residual", np.round(e, 3), " cost", round(costs[-1], 6))
assert np.isclose(*costs)

# %% arc
x, nu, omega, duration = np.array([1.0, 2.0, np.pi / 2]), 1.0, -np.pi / 2, 1.0
theta = x[2] + omega * duration
right = [
    x[0] + nu / omega * (np.sin(theta) - np.sin(x[2])),
    x[1] + nu / omega * (np.cos(x[2]) - np.cos(theta)),
    theta,
]  # gap
np.testing.assert_allclose(right, MotionModel().f(x, np.array([nu, omega]), duration), atol=1e-9)
print(np.round(right, 3))
ask(  # noqa: F821
    right,
    {
        (
            "That is the end of a straight line; with a turn rate the robot drives an arc",
            "それは直進した場合です。角速度があるので円弧を描きます",
        ): [1, 3, 0],
        ("The turn rate is negative: the robot turns to the right", "角速度が負なので、右に曲がります"): [
            1 - 2 / np.pi,
            2 + 2 / np.pi,
            np.pi,
        ],
    },
    unit="m, m, rad",
)

# %% pencil
x_a, z_a = np.array([0.0, 0.0, 0.0]), np.array([2.0, np.pi / 2, 0.0])
x_b, z_b = np.array([1.0, 2.0, np.pi]), np.array([1.1, 0.0, np.pi / 2 + 0.1])
right = textbook.inverse_observation(x_b, z_b) - textbook.inverse_observation(x_a, z_a)  # gap
np.testing.assert_allclose(right, [-0.1, 0, -0.1], atol=1e-12)
np.testing.assert_allclose(right, textbook.virtual_motion_edge(x_a, z_a, x_b, z_b, SensorModel())[0], atol=1e-12)
print(np.round(right, 4) + 0.0)
ask(  # noqa: F821
    right,
    {
        (
            "The residual is the place from the second pose minus that from the first",
            "残差は、2番目の姿勢から見た位置から1番目のものを引きます",
        ): -right,
        ("The heading of the landmark is theta + phi - psi", "ランドマークの向きはθ + φ − ψです"): [-0.1, 0, np.pi / 2],
    },
    unit="m, m, rad",
)
