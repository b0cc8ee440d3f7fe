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
assert np.linalg.matrix_rank(motion.A(x1, u, dt) @ motion.M(u, dt) @ motion.A(x1, u, dt).T, tol=1e-9) == 2

# %% banana
# motions with noisy controls, and the Gaussian of the edge; 4 m with wheels that turn more by chance than those of the book
rng = np.random.default_rng(0)
turning, straight, long = MotionModel(nn=0.05, on=0.25), np.array([1.0, 0.0]), 4.0
noisy = straight + np.sqrt(np.diag(turning.M(straight, long))) * rng.standard_normal((2000, 2))
ends = turning.f(np.zeros((2000, 3)), noisy, long)
mean, C = turning.f(x1, straight, long), turning.covariance(x1, straight, long)
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
ax.legend(fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0))
far = np.abs(ends[:, 1]) > 1.5
assert ends[far, 0].mean() < mean[0] - 0.4  # the strip is bent: its ends lie behind the mean of the Gaussian

# %% better
errors = {}
for edges in ("virtual", "virtual+motion"):
    solution = textbook.solve(log, edges=edges)
    steps = np.flatnonzero(solution.estimated)
    errors[edges] = ate(log.true_poses[steps], solution.poses[steps])
    print(f"{edges:15} {solution.iterations} iterations, trajectory error {errors[edges]:.3f} m")
assert errors["virtual+motion"] < 0.6 * errors["virtual"]

# %% slip
slipping = MotionModel(slip=0.1)
for name, model in (("without slip", motion), ("with slip", slipping)):
    C = model.covariance(x1, np.array([0.5, 0.0]), dt)  # 1.5 m straight on along x
    x, y, theta = np.sqrt(np.diag(C))
    print(f"{name:13} standard deviations: x {x:.3f} m, y {y:.3f} m, theta {theta:.3f} rad")
S = slipping.sideways(x1, u, dt)
print("F S F' = S:", np.allclose(motion.F(x1, u, dt) @ S @ motion.F(x1, u, dt).T, S))
assert np.allclose(motion.F(x1, u, dt) @ S @ motion.F(x1, u, dt).T, S)

# %% three
from graphslam import Graph, load, solve

three = load("examples/three_poses.txt")
x_a, x_b, _ = three.initial_poses
_, Omega_3, *_ = textbook.motion_edge(x_a, x_b, three.controls[0], three.dt[0], MotionModel())
print(np.round(np.linalg.inv(Omega_3), 4) + 0.0)
solution_3 = solve(Graph.from_log(three, edges="virtual+motion", kernel="none"))
print(f"J = {solution_3.cost:.3f} at", np.round(solution_3.poses[1:], 3).tolist())
np.testing.assert_allclose(
    np.linalg.inv(Omega_3)[[0, 1, 1, 2], [0, 1, 2, 2]], [0.0362, 0.004325, 0.00845, 0.017], rtol=1e-4
)
assert 1.7 < solution_3.cost < 1.8

# %% epsilon
for epsilon in (1e-2, 1e-4, 1e-6):
    solution = textbook.solve(log, edges="virtual+motion", motion=MotionModel(epsilon=epsilon))
    errors[epsilon] = ate(log.true_poses, solution.poses)
    print(f"epsilon = {epsilon:g}: trajectory error {errors[epsilon]:.3f} m")
assert abs(errors[1e-4] - errors[1e-6]) < 0.005 < errors[1e-2] - errors[1e-4]

# %% without
e, Omega, B1, B2 = textbook.motion_edge(x1, motion.f(x1, u, dt), u, dt, MotionModel(epsilon=1e-12))
print("largest and smallest eigenvalue of Omega:", [float(f"{v:.3g}") for v in np.linalg.eigvalsh(Omega)[[-1, 0]]])
assert np.isclose(np.linalg.eigvalsh(Omega)[-1], 1e12, rtol=0.01)  # 1 / epsilon

# %% variances
nu, omega, seconds = 0.5, 0.2, 2.0
right = np.diag(motion.M(np.array([nu, omega]), seconds))  # gap
np.testing.assert_allclose(
    right, [(0.19**2 * nu + 0.001**2 * omega) / seconds, (0.13**2 * nu + 0.2**2 * omega) / seconds]
)
print(np.round(right, 6))
ask(  # noqa: F821
    right,
    {
        ("Divide by the duration of the motion", "移動時間で割ってください"): right * seconds,
        ("Divide by the duration; do not multiply by it", "移動時間をかけるのではなく、移動時間で割ってください"): right
        * seconds**2,
        ("Square the sigmas", "σを2乗してください"): [
            (0.19 * nu + 0.001 * omega) / seconds,
            (0.13 * nu + 0.2 * omega) / seconds,
        ],
    },
)

# %% metres
u = np.array([0.5, 0.0])
once = 8.0 * np.sqrt(
    motion.M(u, 8.0)[0, 0]
)  # the standard deviation of the distance: that of the speed, times the duration
right = [once, np.sqrt(4 * (2.0**2 * motion.M(u, 2.0)[0, 0]))]
np.testing.assert_allclose(right, 2 * [0.19 * np.sqrt(4)])
print(np.round(right, 4))
ask(  # noqa: F821
    right,
    {
        ("Variances add, standard deviations do not", "足せるのは分散で、標準偏差ではありません"): [0.19 * 4, 0.19 * 4],
        ("That is the standard deviation of one metre", "それは1 m分の標準偏差です"): [0.19, 0.19],
        ("These are variances", "それは分散です"): [0.1444, 0.1444],
    },
    unit="m",
)
