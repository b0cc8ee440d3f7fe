"""Robust kernels: what they cost where the noise is Gaussian, and whether the covariances say so."""

from itertools import product

import gtsam
import numpy as np
import pytest
from scipy.special import gammaln
from scipy.stats import chi2

from comparisons.studies.consistency import band, models
from graphslam import (
    Graph,
    GraphError,
    Log,
    MotionModel,
    OptionError,
    SensorModel,
    World,
    certify,
    estimate_map,
    load,
    simulate,
    solve,
)
from graphslam.edges import SightingEdges, VirtualMotionEdges
from graphslam.edges.robust import EFFICIENCY, KERNELS, Cauchy, GemanMcClure, Huber
from graphslam.factors import ResidualFactor
from graphslam.solvers.initialize import place_landmarks

cases = pytest.mark.parametrize(("kernel", "d"), list(product(KERNELS.values(), (2, 3))), ids=str)


def test_widths_of_the_literature_and_of_the_definition():
    # Huber 1.345 and Cauchy 2.385 are the well-known widths for one dimension
    assert Huber().of_dimension(1).width == pytest.approx(1.345, abs=1e-3)
    assert Cauchy().of_dimension(1).width == pytest.approx(2.385, abs=1e-3)
    for d in (2, 3):
        # Huber in closed form: E[r²; r < c] is d P(chi² with d + 2 degrees < c²), E[r; r > c] an incomplete gamma
        c = Huber().of_dimension(d).width
        inside = chi2.cdf(c * c, d + 2)
        ratio = np.sqrt(2) * np.exp(gammaln((d + 1) / 2) - gammaln(d / 2))
        slope = inside + c * ratio * chi2.sf(c * c, d + 1) / d
        square = inside + c * c * chi2.sf(c * c, d) / d
        assert slope**2 / square == pytest.approx(EFFICIENCY, abs=1e-6)


@pytest.mark.slow
@cases
def test_efficiency_against_simulation(kernel, d):
    """The variance of the plain mean over that of the robust mean of 100 residuals, over 3,000 repetitions."""
    rng = np.random.default_rng(d)
    x = rng.normal(size=(3000, 100, d))
    kernel = kernel.of_dimension(d)
    plain = x.mean(axis=1)
    mean = plain.copy()
    weigh = {
        Huber: lambda q, c: np.minimum(1, c / np.sqrt(q)),
        Cauchy: lambda q, c: 1 / (1 + q / c**2),
        GemanMcClure: lambda q, c: 1 / (1 + q / c**2) ** 2,
    }[type(kernel)]
    for _ in range(25):
        w = weigh(np.sum((x - mean[:, None]) ** 2, axis=2), kernel.width)
        mean = np.einsum("rk,rkd->rd", w, x) / w.sum(axis=1)[:, None]
    assert np.mean(plain**2) / np.mean(mean**2) == pytest.approx(EFFICIENCY, abs=0.01)
    assert kernel.efficiency(d) == pytest.approx(EFFICIENCY, abs=1e-9)


@cases
def test_the_covariance_of_a_map_is_that_of_the_robust_mean(kernel, d):
    """Each of 400 landmarks seen 60 times from known poses: NEES per degree of freedom inside its 95 % band."""
    rng, sensor = np.random.default_rng(7), SensorModel(range_rate=0.01, bearing_std=0.01, orientation_std=0.01)
    poses = np.column_stack([rng.uniform(-5, 5, (50, 2)), rng.uniform(-3, 3, 50)])
    places = np.column_stack([rng.uniform(-5, 5, (400, 2)), np.zeros(400)])[:, :d]
    steps, ids = rng.integers(0, 50, 24_000), np.repeat(np.arange(400), 60)
    true = sensor.h(poses[steps], places[ids])
    noise = np.sqrt(np.diagonal(sensor.Q(true), axis1=1, axis2=2)) * rng.normal(size=true.shape)
    order = np.argsort(steps, kind="stable")
    log = Log(
        initial_poses=poses, steps=steps[order], landmarks=ids[order], sightings=(true + noise)[order], sensor=sensor
    )
    robust = estimate_map(log, poses, kernel=kernel)
    errors = np.array([robust[j] - places[j] for j in range(400)])
    covariances = np.array([robust.covariances[j] for j in range(400)])
    nees = np.einsum("ei,eij,ej->e", errors, np.linalg.inv(covariances), errors)
    low, high = band(400 * d)
    assert low <= np.mean(nees) / d <= high


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kernel", "options"),
    [
        ("cauchy", {"edges": "landmark+motion"}),
        pytest.param("geman-mcclure", {"weight": "marginal"}, marks=pytest.mark.nightly),
    ],
)
def test_the_covariance_of_a_trajectory(kernel, options):
    """The joint NEES of 96 clean logs lies in its band, close to that of least squares."""
    motion, sensor = models(0.1)
    nees = []
    for seed in range(96):
        log = simulate(World(clean=True), seed=seed, motion=motion, sensor=sensor)
        graphs = (Graph.from_log(log, motion=motion, sensor=sensor, kernel=k, **options) for k in ("none", kernel))
        nees.append([solve(graph, max_iterations=300).joint_nees(log.true_poses) for graph in graphs])
    plain, robust = np.mean(nees, axis=0)
    low, high = band(3 * 62 * 96)
    assert low <= robust <= high and robust == pytest.approx(plain, abs=0.05)


@pytest.mark.parametrize("dimensions", [2, 3])
def test_the_default_width_follows_the_sightings(dimensions, book_log):
    graph = Graph.from_log(book_log, kernel="cauchy", edges="virtual+motion", dimensions=dimensions)
    assert graph.verdict[0] == Cauchy().of_dimension(dimensions) != Cauchy().of_dimension(5 - dimensions)
    # a width that is given stays
    assert Graph.from_log(book_log, kernel=Huber(2.0), dimensions=dimensions, edges="virtual+motion").verdict[
        0
    ] == Huber(2.0)


def test_the_width_of_a_factor_follows_its_rows():
    for rows in (1, 2, 4):
        factor = ResidualFactor([0], lambda _, rows=rows: np.zeros(rows), np.eye(rows), kernel=Huber())
        assert isinstance(factor.noiseModel(), gtsam.noiseModel.Robust)
        assert factor.description.arguments["kernel"] == Huber().of_dimension(rows)


def test_no_width_follows_from_many_dimensions():
    """From 10 dimensions on the spatial median, the limit of Huber's kernel, has the efficiency of the default widths."""
    widths = [Huber().of_dimension(d).width for d in range(1, 10)]
    assert min(widths) > 1
    with pytest.raises(OptionError, match="no default width for residuals of 10 numbers"):
        Huber().of_dimension(10)
    assert Huber(2.0).of_dimension(10) == Huber(2.0)


@pytest.mark.parametrize("trust", [np.ones(1), np.full(4, np.nan), "all"], ids=["too few", "nan", "a word"])
@pytest.mark.parametrize("options", [{"edges": "virtual"}, {"edges": "virtual", "weight": "marginal"}, {}], ids=str)
def test_a_trust_of_another_shape_is_refused(trust, options):
    """The engine would read beyond it: with one number for three sightings J was 1e-320."""
    log = Log(
        dt=[1.0], controls=[[1, 0]], steps=[0, 0, 1, 1], landmarks=[1, 2] * 2, sightings=[[2, 0.5, 0], [3, -0.5, 0]] * 2
    )
    (family,) = (f for f in Graph.from_log(log, noise="book", **options).families if isinstance(f, SightingEdges))
    with pytest.raises(GraphError, match="trust"):
        family.with_trust(trust)


def test_a_kernel_without_a_width_has_no_weights():
    with pytest.raises(OptionError, match="of_dimension"):
        Cauchy().weight([1.0])


@pytest.mark.parametrize("kernel", ["huber", "cauchy", "geman-mcclure"])
def test_a_kernel_acts_before_tempering(kernel, book_log):
    """A tempered pair costs 2/K of what it costs among plain pairs, so wrong sightings are told apart as well."""
    plain, tempered = (
        next(f for f in graph.families if isinstance(f, VirtualMotionEdges))
        for graph in (
            Graph.from_log(book_log, weight=w, kernel=kernel, edges="virtual+motion") for w in ("pairs", "tempered")
        )
    )
    state = np.random.default_rng(0).normal(size=(book_log.num_poses, 3))
    squares = plain.linearize(state, state).mahalanobis
    factor = tempered.group_weights[tempered.pairs()[2]]
    assert np.ptp(factor) > 0
    expected = factor @ plain.kernel.loss(squares)
    assert tempered.cost(state, state) == pytest.approx(expected, rel=1e-10)
    np.testing.assert_allclose(tempered.kernel_weights(state), plain.kernel_weights(state), rtol=1e-9)


@pytest.mark.parametrize("dimension", [1, 2, 3])
def test_means_for_gaussian_noise(dimension: int) -> None:
    squares = np.sum(np.random.default_rng(0).standard_normal((400_000, dimension)) ** 2, axis=1)
    for kernel in KERNELS.values():
        of_dimension = kernel.of_dimension(dimension)
        assert kernel.mean_loss(dimension) == pytest.approx(np.mean(of_dimension.loss(squares)), rel=0.01)
        assert kernel.share_below(0.5, dimension) == pytest.approx(
            np.mean(of_dimension.weight(squares) < 0.5), abs=2e-3
        )
    assert Huber(width=1e6).mean_loss(dimension) == pytest.approx(dimension, rel=1e-3)


@pytest.mark.parametrize("name", KERNELS)
def test_kernels_are_concave_in_the_squares(name):
    """So they lie below their tangents, whose slope is the weight: what the certificate of a kernel rests on."""
    kernel = KERNELS[name].of_dimension(2)
    squares = np.concatenate([[0.0], np.logspace(-3, 6, 200)])
    loss, weight = kernel.loss(squares), kernel.weight(squares)
    tangents = loss[:, None] + weight[:, None] * (squares - squares[:, None])
    assert np.all(loss <= tangents + 1e-9 * (1 + np.abs(tangents)))


@pytest.mark.parametrize(
    "options",
    [{}, {"weight": "tempered"}, {"weight": "marginal"}, {"edges": "landmark+motion", "dimensions": 2}],
    ids=str,
)
def test_the_end_of_a_kernel_is_proven_for_its_weights(book_log, options):
    graph = Graph.from_log(book_log, kernel="cauchy", **options)
    solution = solve(graph)
    proof = solution.certificate
    assert proof.status == "global for its weights" and proof.proven and proof.lower_bound == 0
    assert 0 <= proof.relative_gap <= 1e-6 and "weights" in proof.reason
    # the cost with the weights held lies above J, and touches it at the end
    weighted = sum(family.weighted_cost(solution.state) for family in graph.families)
    assert weighted < solution.cost
    rng = np.random.default_rng(0)
    for _ in range(5):
        state = solution.state + rng.normal(0, 0.05, solution.state.shape)
        if len(graph.landmark_ids):
            assert graph.cost(state) <= solution.cost + _weighted_cost(graph, solution.state, state) - weighted + 1e-6
    shaken = solution.state + rng.normal(0, 0.3, solution.state.shape)
    assert certify(graph, shaken).status == "not proven"


def _weighted_cost(graph, held, state):
    """The cost at a state with the weights of another one, edge by edge."""
    total = 0.0
    for family in graph.families:
        if isinstance(family, SightingEdges):
            total += family.linearize(state, state).mahalanobis @ family.kernel_weights(held)
        else:
            total += family.cost(state, state)
    return total


@pytest.mark.slow
def test_no_kernel_ends_above_the_plain_optimum_or_the_end_from_the_truth(shared_data):
    """Robot 3 of MR.CLAM 6 with noise by hand, its first half: from the virtual motions J ends 1e-4 too high."""
    motion, sensor = MotionModel.constant(0.1, 0.3, epsilon=1e-8), SensorModel.constant(0.12, 0.02)
    log = load(shared_data("mrclam6"), robot=3)
    log = log.at_steps(np.arange(log.num_poses // 2 + 1))
    graph = Graph.from_log(log, edges="landmark+motion", kernel="cauchy", motion=motion, sensor=sensor)
    solution = solve(graph)
    truth = place_landmarks(graph, log.robot_truth[graph.steps])
    ends = [solve(graph.with_initial(s), initialize="given", max_iterations=300) for s in (truth, graph.initial)]
    assert solution.cost <= min(end.cost for end in ends if end.converged) * (1 + 1e-6)
    assert solution.cost <= solve(graph.without_kernel).cost
    assert solution.certificate.status == "global for its weights"
