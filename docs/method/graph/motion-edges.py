# %% setup
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Ellipse

from graphslam import MotionModel, simulate, textbook
from graphslam.metrics import ate

log = simulate(seed=3, clean=True)
motion = MotionModel()  # nn 0.19, no 0.001, on 0.13, oo 0.2

# %% covariance
x1, u, dt = np.zeros(3), np.array([0.5, 0.3]), 3.0
print("A M A' (its rank is 2):")
print(np.round(motion.A(x1, u, dt) @ motion.M(u, dt) @ motion.A(x1, u, dt).T, 4))
print("eigenvalues:", np.round(np.linalg.eigvalsh(motion.A(x1, u, dt) @ motion.M(u, dt) @ motion.A(x1, u, dt).T), 6))

# %% banana
# motions with noisy controls, and the Gaussian of the edge
rng = np.random.default_rng(0)
noisy = u + np.sqrt(np.diag(motion.M(u, dt))) * rng.standard_normal((2000, 2))
ends = motion.f(np.zeros((2000, 3)), noisy, dt)
mean, C = motion.f(x1, u, dt), motion.covariance(x1, u, dt)
values, vectors = np.linalg.eigh(C[:2, :2])
angle = np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1]))
fig, ax = plt.subplots()
ax.plot(ends[:, 0], ends[:, 1], "C0.", ms=2, alpha=0.5, label="motions with noisy controls")
ax.add_patch(
    Ellipse(
        mean[:2],
        *(6 * np.sqrt(values[::-1])),
        angle=angle,
        fill=False,
        color="C1",
        lw=2,
        label="A M A' + epsilon I, 3 standard deviations",
    )
)
ax.plot(0, 0, "ko", label="start")
ax.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
ax.legend(fontsize=8)

# %% better
for edges in ("virtual", "virtual+motion"):
    solution = textbook.solve(log, edges=edges)
    steps = np.flatnonzero(solution.estimated)
    error = ate(log.true_poses[steps], solution.poses[steps])
    print(f"{edges:15} {solution.iterations} iterations, trajectory error {error:.3f} m")

# %% slip
slipping = MotionModel(slip=0.1)
for name, model in (("without slip", motion), ("with slip", slipping)):
    C = model.covariance(x1, np.array([0.5, 0.0]), dt)  # 1.5 m straight on along x
    x, y, theta = np.sqrt(np.diag(C))
    print(f"{name:13} standard deviations: x {x:.3f} m, y {y:.3f} m, theta {theta:.3f} rad")
S = slipping.sideways(x1, u, dt)
print("F S F' = S:", np.allclose(motion.F(x1, u, dt) @ S @ motion.F(x1, u, dt).T, S))

# %% epsilon
for epsilon in (1e-2, 1e-4, 1e-6):
    solution = textbook.solve(log, edges="virtual+motion", motion=MotionModel(epsilon=epsilon))
    print(f"epsilon = {epsilon:g}: trajectory error {ate(log.true_poses, solution.poses):.3f} m")

# %% without
e, Omega, B1, B2 = textbook.motion_edge(x1, motion.f(x1, u, dt), u, dt, MotionModel(epsilon=1e-12))
print("largest and smallest eigenvalue of Omega:", [float(f"{v:.3g}") for v in np.linalg.eigvalsh(Omega)[[-1, 0]]])
