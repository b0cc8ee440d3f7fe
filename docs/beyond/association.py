# %% setup
import matplotlib.pyplot as plt
import numpy as np
from scipy.stats import chi2

from fastslam import associate
from graphslam import Graph, SensorModel, simulate, solve
from graphslam.association import score
from graphslam.log import UNIDENTIFIED
from graphslam.metrics import ate

sensor = SensorModel(range_rate=0.05, bearing_std=0.02, orientation_std=0.05)
log = simulate(seed=2, clean=True, sensor=sensor)
hidden = log.replace(landmarks=np.full(len(log.landmarks), UNIDENTIFIED))  # the same log without ids

# %% distance
S = np.array([[0.50, 0.00], [0.00, 0.01]])  # covariance of a predicted landmark minus its sighting: long in x
for name, nu in (("candidate A", np.array([0.9, 0.0])), ("candidate B", np.array([0.0, 0.4]))):
    d2 = nu @ np.linalg.solve(S, nu)
    print(f"{name}: {np.hypot(*nu):.1f} m away, squared Mahalanobis distance {d2:5.1f}")
print("gate of 99.9 % in two dimensions:", chi2.ppf(0.999, 2).round(1))
assert 0.9**2 / 0.50 < chi2.ppf(0.999, 2) < 0.4**2 / 0.01  # A is a candidate, although it is farther away

# %% joint
cross = 0.48  # both residuals share the error of the pose
joint = np.array([[0.50, cross], [cross, 0.50]])
for nu in (np.array([0.9, 0.9]), np.array([0.9, -0.9])):
    one_by_one = (nu**2 / 0.50).sum()
    print(f"residuals {nu}: one by one {one_by_one:.1f}, jointly {nu @ np.linalg.solve(joint, nu):5.1f}")
print("gate of 99.9 % for two residuals:", chi2.ppf(0.999, 2).round(1))
assert nu @ np.linalg.solve(joint, nu) > chi2.ppf(0.999, 2) > one_by_one  # plausible one by one, not jointly

# %% associate
found = associate(hidden, sensor=sensor)
print(found)
print(score(found.ids, log.landmarks))
assert score(found.ids, log.landmarks).recall == 1

# %% figure
fig, axes = plt.subplots(1, 2, figsize=(9, 4))
for ax, poses, title in (
    (axes[0], log.dead_reckoning(), "from dead reckoning"),
    (axes[1], found.poses, "after association"),
):
    places = sensor.h_inverse(poses[log.steps], log.sightings)
    ax.scatter(places[:, 0], places[:, 1], c=np.where(found.ids < 0, -1, found.ids), cmap="tab10", s=12)
    ax.plot(*np.array([m[:2] for m in log.true_landmarks.values()]).T, "k+", ms=12)
    ax.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", title=title)

# %% same
errors = []
for name, used in (("true ids", log), ("ids found", found.log)):
    solution = solve(Graph.from_log(used, edges="landmark+motion", sensor=sensor))
    errors.append(ate(log.true_poses, solution.poses))
    print(f"{name:9} ATE {errors[-1]:.3f} m")
assert errors[1] < 1.02 * errors[0]

# %% gate
for share in (0.9, 0.99, 0.999):
    lost = 1000 * (1 - share)
    print(
        f"gate {share:.1%}: squared distance below {chi2.ppf(share, 3):.1f}, {lost:.0f} of 1000 correct sightings lost"
    )
assert round(lost) == 1

# %% clutter
rng = np.random.default_rng(0)
for part in (0.0, 0.1, 0.3):
    wrong = rng.random(len(log.steps)) < part  # sightings of nothing
    sightings = log.sightings.copy()
    sightings[wrong] = rng.uniform([0.5, -1, -3], [6, 1, 3], (wrong.sum(), 3))
    result = associate(hidden.replace(sightings=sightings), sensor=sensor)
    judged = score(result.ids, np.where(wrong, UNIDENTIFIED, log.landmarks))
    print(
        f"{part:.0%} clutter: {result.landmarks} landmarks, precision {judged.precision:.2f}, recall {judged.recall:.2f},"
        f" {result.clutter} of {wrong.sum()} called clutter"
    )
    assert judged.recall > 0.99 and result.clutter >= 0.9 * wrong.sum()

# %% nearer
S_inv = np.linalg.inv(np.diag([0.36, 0.01]))
right = [nu @ S_inv @ nu for nu in (np.array([0.6, 0.3]), np.array([0.9, 0.1]))]  # gap
np.testing.assert_allclose(right, [10, 3.25])
print("squared distances:", np.round(right, 3))
ask(  # noqa: F821
    right,
    {
        ("These are distances; the squares are asked", "それは距離です。2乗を答えてください"): np.sqrt([10, 3.25]),
        ("Divide by the variances", "分散で割ってください"): [0.6**2 + 0.3**2, 0.9**2 + 0.1**2],
        (
            "0.36 and 0.01 are variances already: do not square them",
            "0.36と0.01はすでに分散です。2乗しないでください",
        ): [0.6**2 / 0.36**2 + 0.3**2 / 0.01**2, 0.9**2 / 0.36**2 + 0.1**2 / 0.01**2],
    },
)

# %% jointly
S_hh = np.array([[0.5, 0.4], [0.4, 0.5]])
right = [nu @ np.linalg.solve(S_hh, nu) for nu in (np.array([0.6, 0.6]), np.array([0.6, -0.6]))]  # gap
np.testing.assert_allclose(right, [0.8, 7.2])
print("jointly:", np.round(right, 3))
ask(  # noqa: F821
    right,
    {
        ("That takes the two residuals as independent", "それは2つの残差が独立な場合です"): [1.44, 1.44],
        ("The two cases are exchanged", "2つの場合が逆です"): [7.2, 0.8],
    },
)
