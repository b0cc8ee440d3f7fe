# %% setup
import matplotlib.pyplot as plt
import numpy as np

from graphslam import Graph, certify, simulate, solve

log = simulate(seed=0, clean=True)
graph = Graph.from_log(log, weight="tempered")

# %% starts
rng = np.random.default_rng(0)
ends = []
for _ in range(12):
    wild = graph.initial.copy()
    wild[1:, 2] = rng.uniform(-np.pi, np.pi, len(wild) - 1)  # random headings
    solution = solve(graph.with_initial(wild), initialize="given")
    ends.append((solution.cost, solution.converged, certify(graph, solution.state).status))
best = solve(graph)
for cost, converged, status in sorted(ends)[::3]:
    print(f"random headings: J {cost:10.2f}  {'converged' if converged else 'not converged':14} {status}")
print(f"auto:            J {best.cost:10.2f}  {best.reason}; {best.certificate.status}")
assert best.certificate.proven and best.cost < min(ends)[0]

# %% minorant
u = np.linspace(-np.pi, np.pi, 400)


def draw(star):
    """The square of an angle and the function of its cosine that supports it at one angle."""
    _, ax = plt.subplots(figsize=(6.4, 3.4))
    factor = star / np.sin(star) if star else 1.0
    ax.plot(u, u**2, label="u²")
    ax.plot(u, star**2 + 2 * factor * (np.cos(star) - np.cos(u)), "C1--", label="linear in cos u")
    ax.plot([-star, star], [star**2] * 2, "ko", label="u*")
    ax.set(xlabel="u [rad]", ylabel="", ylim=(-2, 10))
    ax.legend(loc="upper center")


slider("u*", [0.0, 0.5, 1.0, 1.5, 2.0, 2.5], draw)  # noqa: F821  # given by the site: one figure for each value

# %% shift
Omega = np.array([[4.0, 1.0, 2.0], [1.0, 3.0, -1.0], [2.0, -1.0, 5.0]])  # information of x, y and heading
beta, kappa = 1.0, 1.0
P = Omega - np.diag([beta, beta, kappa])
assert np.linalg.eigvalsh(P)[0] >= 0
least = np.inf
for _ in range(10_000):
    found, v = rng.uniform(-1, 1, 3), rng.uniform(-2, 2, 3)
    v[2] = rng.uniform(-np.pi, np.pi)
    p = (P @ found)[2]
    turned, star = v[2] + p / kappa, found[2] + p / kappa
    if abs(star) < np.pi:
        angle = star**2 + 2 * star / np.sin(star) * (np.cos(star) - np.cos(turned))  # at most turned²
        bound = beta * v[:2] @ v[:2] + 2 * (P @ found)[:2] @ v[:2] - found @ P @ found + kappa * angle - p**2 / kappa
        least = min(least, v @ Omega @ v - bound)
print("J of the edge minus the bound is never below", round(least, 6))
assert least > -1e-9

# %% proof
proof = best.certificate
print(proof.status, "-", proof.reason)
print(f"J = {best.cost:.9f}, no state below {proof.lower_bound:.9f}")
assert best.cost - proof.lower_bound < 1e-9 * best.cost

# %% shaken
for metres in (0.0, 0.001, 0.1):
    moved = best.state.copy()
    moved[1:, :2] += metres * rng.standard_normal((len(moved) - 1, 2))
    proof = certify(graph, moved)
    print(f"moved by {metres} m: J {graph.cost(moved):9.3f}, {proof.status}, lower bound {proof.lower_bound:.3f}")
    assert proof.proven == (metres == 0.0)

# %% outside
for name, options in (("world frame", {"frame": "world"}), ("Cauchy kernel", {"kernel": "cauchy"})):
    proof = solve(Graph.from_log(log, **options)).certificate
    print(f"{name}: {proof.status}: {proof.reason}")
    assert proof.status == {"world frame": "not applicable", "Cauchy kernel": "global for its weights"}[name]

# %% tangent
worst = np.inf
for star in np.linspace(0.01, 3.1, 100):
    bound = star**2 + 2 * star / np.sin(star) * (np.cos(star) - np.cos(u))
    worst = min(worst, (u**2 - bound).min())
print("smallest value of u² minus the bound:", worst)
assert worst > -1e-9

# %% wrong
wild = graph.initial.copy()
wild[1:, 2] = np.random.default_rng(3).uniform(-np.pi, np.pi, len(wild) - 1)
wrong = solve(graph.with_initial(wild), initialize="given")
proof = wrong.certificate
print(f"J {wrong.cost:.2f} against {best.cost:.2f} of the best: {proof.status}")
print("its lower bound is above the best cost:", proof.lower_bound > best.cost)
assert not proof.lower_bound > best.cost

# %% edge_by_hand
z_a, t_a, t_b, d_a = 1j, 1.0, 1.1 + 2j, 1.8  # the heading of pose a is pi/2; a motion edge: d_b = 0
e_xy = np.conj(z_a) * (t_b - t_a) - d_a
right = [e_xy.real, e_xy.imag]  # gap
np.testing.assert_allclose(right, [0.2, -0.1], atol=1e-12)
print(np.round(right, 4))
ask(  # noqa: F821
    right,
    {
        ("z_a is conjugated: its imaginary part changes the sign", "z_aは複素共役をとります"): [-3.8, 0.1],
        ("Turn t_b - t_a into the axes of pose a", "t_b − t_aを姿勢aの座標系に回転させてください"): [-1.7, 2.0],
    },
    unit="m",
)

# %% touching
star, there = 1.0, 2.0
right = star**2 + 2 * star / np.sin(star) * (np.cos(star) - np.cos(there))  # gap
assert right <= there**2
print("bound:", round(right, 4), " square:", there**2)
ask(  # noqa: F821
    right,
    {
        ("That is u squared; the bound lies below it", "それはu²です。下界はその下にあります"): 4.0,
        ("The factor is 2 u* / sin u*", "係数は2u* / sin u*です"): 1 + 2 * (np.cos(1) - np.cos(2)),
        ("The square of u* comes first", "最初の項はu*の2乗です"): right - 1,
    },
)
