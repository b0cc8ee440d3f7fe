# %% setup
import matplotlib.pyplot as plt
import numpy as np

from graphslam import SensorModel, textbook

# three poses and one landmark, seen from all of them: three virtual-motion edges
sensor = SensorModel()
x = np.array([[0.0, 0.0, 0.0], [1.0, 0.1, 0.3], [1.8, 0.6, 0.8]])
landmark = np.array([2.0, 2.0, 0.5])
z = np.array([[*(np.hypot(*(landmark - p)[:2]), np.arctan2(*(landmark - p)[1::-1]) - p[2]), 0.0] for p in x])
z[:, 2] = x[:, 2] + z[:, 1] - landmark[2]
z += [[0.1, 0.0, 0.02], [-0.05, 0.03, 0.0], [0.0, -0.02, 0.05]]  # the noise of the sensor
edges = [(0, 1), (0, 2), (1, 2)]

# %% sum
Omega, xi, J = np.zeros((9, 9)), np.zeros(9), 0.0
Omega[:3, :3] += textbook.OMEGA_0
for a, b in edges:
    e, Omega_e, B1, B2 = textbook.virtual_motion_edge(x[a], z[a], x[b], z[b], sensor)
    textbook._add(Omega, xi, 3 * a, 3 * b, e, Omega_e, B1, B2)
    J += e @ Omega_e @ e
Delta = np.linalg.solve(Omega, xi)
print("J before the step:", round(J, 4))
print("Delta of pose 1:", np.round(Delta[3:6], 4))
print("Delta of pose 2:", np.round(Delta[6:], 4))
np.testing.assert_allclose(Omega @ Delta, xi, atol=1e-9)
assert np.abs(Delta[:3]).max() < 1e-6  # the anchor holds pose 0

# %% figure
# the blocks of one edge between the poses 3 and 7 of ten, and Omega of the sample log
from graphslam import load, sample_log_path

log = load(sample_log_path())
fig, axes = plt.subplots(1, 2, figsize=(7.5, 3.8))
pattern = np.zeros((10, 10))
pattern[np.ix_([3, 7], [3, 7])] = 1
axes[0].imshow(pattern, cmap="Greens", vmax=1.5)
for i, j, name in ((3, 3, "1,1"), (3, 7, "1,2"), (7, 3, "2,1"), (7, 7, "2,2")):
    axes[0].text(j, i, name, ha="center", va="center", fontsize=7)
axes[0].set_title("edge between poses 3 and 7")
steps = np.unique(log.steps)
row = {t: k for k, t in enumerate(steps)}
seen = np.zeros((len(steps), len(steps)))
for j in log.landmark_ids:
    rows = [row[t] for t in log.steps[log.landmarks == j]]
    seen[np.ix_(rows, rows)] = 1
axes[1].imshow(seen, cmap="Greens", vmax=1.5)
axes[1].set_title(f"Omega of the sample log: {seen.mean():.0%} filled")
for ax in axes:
    ax.grid(False)
    ax.set(xlabel="pose", ylabel="pose")

# %% three
from graphslam import load

three = load("examples/three_poses.txt")
Omega_3, xi_3 = np.zeros((9, 9)), np.zeros(9)
Omega_3[:3, :3] += textbook.OMEGA_0
for a_3, b_3 in edges:
    (x_a, x_b), (z_a, z_b) = three.initial_poses[[a_3, b_3]], three.sightings[[a_3, b_3]]
    textbook._add(Omega_3, xi_3, 3 * a_3, 3 * b_3, *textbook.virtual_motion_edge(x_a, z_a, x_b, z_b, sensor))
Delta_3 = np.linalg.solve(Omega_3, xi_3).reshape(3, 3)
print(np.round(Delta_3, 4) + 0.0)
np.testing.assert_allclose(Delta_3[1], [0.0475, 0.0225, -0.05], atol=1e-4)


# %% gaussian
# J along the line through the minimum of the quadratic function: exact, and as the polynomial in Delta
def cost(poses):
    total = (poses[0] - x[0]) @ textbook.OMEGA_0 @ (poses[0] - x[0])
    for a, b in edges:
        e, Omega_e, *_ = textbook.virtual_motion_edge(poses[a], z[a], poses[b], z[b], sensor)
        total += e @ Omega_e @ e
    return total


for s in (0.0, 0.5, 1.0, 1.5):
    polynomial = s**2 * Delta @ Omega @ Delta - 2 * s * Delta @ xi + J
    print(f"{s:3} Delta: J = {cost(x + s * Delta.reshape(3, 3)):.5f}, polynomial {polynomial:.5f}")
assert abs(cost(x + Delta.reshape(3, 3))) < 1e-3 * J  # not quite zero, the minimum of the polynomial

# %% minimum
change = np.random.default_rng(0).normal(0, 1e-3, 9)
best = Delta @ Omega @ Delta - 2 * Delta @ xi
other = (Delta + change) @ Omega @ (Delta + change) - 2 * (Delta + change) @ xi
print("higher after any change:", other > best)
print("by change' Omega change:", np.isclose(other - best, change @ Omega @ change))
assert np.isclose(other - best, change @ Omega @ change)

# %% eigenvalues
print("without the anchor:", np.round(np.linalg.eigvalsh(Omega - np.diag([1e6] * 3 + [0] * 6))[:4], 6))
print("with the anchor:   ", np.round(np.linalg.eigvalsh(Omega)[:4], 1))
assert np.sum(np.linalg.eigvalsh(Omega - np.diag([1e6] * 3 + [0] * 6)) < 1e-6) == 3

# %% line
# x_0 = 0 is known; e = x_1 - 1 with the information 4, and e = x_1 - 1.3 with the information 1; x_1 is 0 at first
Omega_x, xi_x = 4 + 1, 4 * 1 + 1 * 1.3
right = [Omega_x, xi_x, xi_x / Omega_x]  # gap
np.testing.assert_allclose(right[2], np.average([1, 1.3], weights=[4, 1]))
print(np.round(right, 4))
ask(  # noqa: F821
    right,
    {
        (
            "xi has a minus sign: xi is - sum B' Omega_e e, and e is negative here",
            "ξ = −ΣB'Ω_e e です。ここではeが負なので、ξは正になります",
        ): [5, -5.3, -1.06],
        ("Each edge counts with its information", "エッジごとの情報で重みをつけてください"): [2, 2.3, 1.15],
    },
)

# %% block
B_0, B_1, information, e_01 = -1.0, 1.0, 4.0, 0.5
B = np.array([[B_0, B_1]])
right = np.column_stack([B.T * information @ B, -B.T[:, 0] * information * e_01])  # gap
np.testing.assert_allclose(right, [[4, -4, 2], [-4, 4, -2]])
print(right)
ask(  # noqa: F821
    right,
    {
        ("xi has a minus sign", "ξには負の符号がつきます"): right * [1, 1, -1],
        (
            "B_1 and B_2 have opposite signs, so the blocks beside the diagonal are negative",
            "B_1とB_2は符号が逆なので、非対角の成分は負になります",
        ): [[4, 4, 2], [4, 4, -2]],
    },
)
