# %% setup
import matplotlib.pyplot as plt
import numpy as np

from graphslam import MotionModel, SensorModel, load, sample_log_path, textbook

log = load(sample_log_path())

# %% figure
# the first 14 poses, the true ones, with their motion edges and the virtual-motion edges of the landmark seen most often
used = range(14)
early = log.steps < len(used)
landmark = np.bincount(log.landmarks[early]).argmax()
seen = log.steps[early & (log.landmarks == landmark)]
assert len(seen) == 10  # K sightings, so K (K - 1) / 2 = 45 virtual-motion edges
fig, ax = plt.subplots()
x, m = log.true_poses, log.true_landmarks[int(landmark)]
for t in used[1:]:
    ax.annotate("", x[t, :2], x[t - 1, :2], arrowprops={"arrowstyle": "->", "color": "C0"})
for k, t1 in enumerate(seen):
    for t2 in seen[k + 1 :]:
        middle = (x[t1, :2] + x[t2, :2]) / 2
        bow = middle + 0.12 * (m[:2] - middle)  # drawn towards the landmark, so that the edges do not cover each other
        ax.plot(*np.array([x[t1, :2], bow, x[t2, :2]]).T, "C1-", lw=0.8, alpha=0.6)
ax.plot(*x[seen, :2].T, "C1o", ms=9, fillstyle="none", label="poses that saw the landmark")
ax.plot(x[used, 0], x[used, 1], "C0o", ms=4, label="poses, and motion edges as arrows")
ax.plot(m[0], m[1], "k*", ms=12, label="landmark")
ax.plot([], [], "C1-", label="virtual-motion edges of the landmark")
ax.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
ax.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.15), ncols=2)

# %% motion
motion = MotionModel()
x1, u, dt = log.initial_poses[0], log.controls[0], log.dt[0]
x2 = motion.f(x1, u, dt)
for moved in (x2, x2 + [0.1, 0.0, 0.0]):
    e, Omega, B1, B2 = textbook.motion_edge(x1, moved, u, dt, motion)
    print("residual", np.round(e, 3), " cost", round(float(e @ Omega @ e), 2))

# %% residual
x1, x2 = np.array([0.0, 0.0, 0.0]), np.array([1.0, 0.0, np.pi / 2])
z1, z2 = np.array([2.0, 0.0, 0.0]), np.array([1.1, -np.pi / 2, 0.0])
e, Omega, B1, B2 = textbook.virtual_motion_edge(x1, z1, x2, z2, SensorModel())
print("from pose 1 the landmark is at", np.round(textbook.inverse_observation(x1, z1), 3))
print("from pose 2 the landmark is at", np.round(textbook.inverse_observation(x2, z2), 3))
print("residual", np.round(e, 3))

# %% wrapped
x1, z1 = np.array([0.0, 0.0, 3.1]), np.array([1.0, 0.0, 0.0])
x2, z2 = np.array([0.0, 0.0, -3.1]), np.array([1.0, 0.0, 0.0])
difference = textbook.inverse_observation(x2, z2) - textbook.inverse_observation(x1, z1)
e, *_ = textbook.virtual_motion_edge(x1, z1, x2, z2, SensorModel())
print("difference", np.round(difference[2], 3), " normalised", np.round(e[2], 3))


# %% turned
# the residual of the world frame changes when the whole world is rotated, its length does not
def rotated(x, angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * x[0] - s * x[1], s * x[0] + c * x[1], x[2] + angle])


x1, x2 = np.array([0.0, 0.0, 0.0]), np.array([1.0, 0.0, np.pi / 2])
z1, z2 = np.array([2.0, 0.0, 0.0]), np.array([1.1, -np.pi / 2, 0.0])
for angle in (0.0, 1.0):
    e, Omega, *_ = textbook.virtual_motion_edge(rotated(x1, angle), z1, rotated(x2, angle), z2, SensorModel())
    print("residual", np.round(e, 3), " cost", round(float(e @ Omega @ e), 6))
