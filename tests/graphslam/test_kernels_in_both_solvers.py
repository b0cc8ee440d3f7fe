"""Every kernel, weight, frame and sensor dimension: the hand-written solver and GTSAM end in the same place."""

from itertools import product

import numpy as np
import pytest

from graphslam import Graph, OptionError, simulate, solve, solve_with_gtsam
from graphslam.edges.robust import Cauchy, GemanMcClure, Huber, kernel_of
from graphslam.metrics import ate
from graphslam.se2 import wrap
from graphslam.solvers.initialize import starting_state

KERNELS = [None, Huber(), Cauchy(), GemanMcClure()]
VARIANTS = [
    *product(["virtual+motion"], ["pairs", "tempered", "marginal"], ["body", "world"], [3, 2], KERNELS),
    *product(["landmark+motion"], ["cartesian", "polar"], ["body", "world"], [3, 2], KERNELS),
]


@pytest.fixture(scope="module")
def log():
    """Short, since GTSAM's factors with a kernel on every pair are slow; with wrong sightings in it."""
    log = simulate(seed=11, steps=24, clean=True)
    rng = np.random.default_rng(5)
    sightings = log.sightings.copy()
    wrong = rng.choice(len(sightings), 2, replace=False)
    sightings[wrong, 1] += 0.3
    return log.replace(sightings=sightings)


KINDS = ["pairs", "marginal", "cartesian", "polar"]


def is_nightly(variant):
    """All but a quarter, in which any two values of two options occur; tempered edges are pairs times a number."""
    _, kind, frame, dimensions, kernel = variant
    if kind == "tempered":
        return True
    i, k = KINDS.index(kind), KERNELS.index(kernel)
    return (frame, dimensions) != (["body", "world"][(i + k) % 2], [3, 2][(i // 2 + k) % 2])


def name(variant):
    return " ".join(str(getattr(part, "name", part)) for part in variant)


@pytest.mark.slow
@pytest.mark.parametrize(
    "variant",
    [pytest.param(each, marks=[pytest.mark.nightly] * is_nightly(each)) for each in VARIANTS],
    ids=name,
)
def test_both_solvers_agree(variant, log):
    edges, kind, frame, dimensions, kernel = variant
    options = {"edges": edges, "frame": frame, "dimensions": dimensions}
    options["weight" if edges.startswith("virtual") else "residual"] = kind
    graph = Graph.from_log(log, **options, kernel=kernel)
    start = starting_state(graph, "auto")
    if isinstance(kernel, Cauchy | GemanMcClure):
        # these have more than one minimum: both solvers start at Huber's, which is near one of them
        start = solve(
            Graph.from_log(log, **options, kernel="huber").with_initial(start), tolerance=1e-3, initialize="given"
        ).state
    graph = graph.with_initial(start)
    ours, theirs = (
        s(graph, tolerance=1e-10, max_iterations=500, initialize="given") for s in (solve, solve_with_gtsam)
    )
    assert ours.converged and theirs.converged
    off = ours.poses - theirs.poses
    off[:, 2] = wrap(off[:, 2])
    assert np.abs(off).max() < 1e-6
    assert ours.cost == pytest.approx(theirs.cost, rel=1e-9)


def test_kernels_by_name_and_formula():
    assert kernel_of("huber") == Huber() and kernel_of(None) is kernel_of("none") is None
    r = np.array([0.0, 0.5, 1.0, 2.0, 10.0])
    np.testing.assert_allclose(Huber(1.0).loss(r * r), [0, 0.25, 1, 3, 19])
    np.testing.assert_allclose(Cauchy(2.0).loss(r * r), 4 * np.log1p(r * r / 4))
    np.testing.assert_allclose(GemanMcClure(2.0).loss(r * r), 4 * r * r / (4 + r * r))
    for kernel in (k.of_dimension(2) for k in KERNELS[1:]):
        # w = rho'(r) / r
        slope = (kernel.loss((r + 1e-6) ** 2) - kernel.loss((r - 1e-6) ** 2)) / 4e-6
        np.testing.assert_allclose(slope, kernel.weight(r * r) * r, atol=1e-8)
    for bad in (Huber, Cauchy, GemanMcClure):
        with pytest.raises(OptionError, match="width must be a positive"):
            bad(0.0)
    with pytest.raises(OptionError, match="kernel must be"):
        kernel_of(3)


@pytest.mark.slow
def test_a_kernel_lessens_what_wrong_sightings_do():
    error = []
    for seed in range(8):
        log = simulate(seed=seed, clean=True)
        rng = np.random.default_rng(seed)
        sightings = log.sightings.copy()
        wrong = rng.choice(len(sightings), len(sightings) // 12, replace=False)
        sightings[wrong, 1:] += rng.choice([-1.0, 1.0], (len(wrong), 2))
        bad = log.replace(sightings=sightings)
        graphs = (
            Graph.from_log(bad, weight="tempered", kernel=kernel, edges="virtual+motion")
            for kernel in ("none", "huber", "cauchy")
        )
        error.append([ate(log.true_poses, solve(graph, initialize="auto").poses) for graph in graphs])
    plain, huber, cauchy = np.median(error, axis=0)
    assert cauchy < huber < plain


def test_levenberg_marquardt_with_a_kernel(log):
    graph = Graph.from_log(log, kernel="geman-mcclure", edges="virtual+motion")
    # one start for both: the cost has several minima
    options = {"initialize": "rotation-first", "max_iterations": 500}
    gn, lm = (solve(graph, method=m, **options) for m in ("gauss-newton", "levenberg-marquardt"))
    assert lm.converged and lm.cost == pytest.approx(gn.cost, rel=1e-9)


@pytest.mark.parametrize("solver", [solve, solve_with_gtsam])
def test_a_run_with_a_kernel_that_does_not_converge_says_what_to_do(solver):
    log = simulate(seed=1, steps=30)
    graphs = {kernel: Graph.from_log(log, edges="landmark+motion", kernel=kernel) for kernel in ("huber", "none")}
    short = {kernel: solver(graph, max_iterations=1, initialize="given") for kernel, graph in graphs.items()}
    assert not short["huber"].converged and not short["none"].converged
    advice = "raise max_iterations of solve, or use its method gnc"
    assert any("the kernel huber" in note and advice in note for note in short["huber"].notes)
    assert not any(advice in note for note in (*short["none"].notes, *solver(graphs["huber"]).notes))
