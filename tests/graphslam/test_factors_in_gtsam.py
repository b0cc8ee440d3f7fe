"""Our factors in the optimisers of GTSAM, among GTSAM's own factors, and what they become when made native."""

import gtsam
import numpy as np
import pytest

from graphslam import Graph, SensorModel, solve, solve_with_gtsam
from graphslam.edges.robust import Cauchy, GemanMcClure, Huber
from graphslam.factors import (
    AnchorFactor,
    LandmarkFactor,
    MotionFactor,
    ObservationFactor,
    VirtualMotionFactor,
    describe,
)
from graphslam.se2 import wrap
from graphslam.solvers.gtsam_solver import from_values, to_gtsam, to_values

sensor = SensorModel()


@pytest.fixture(scope="module")
def small(clean_log):
    graph = Graph.from_log(clean_log, edges="virtual+motion", kernel="none")
    return graph, solve(graph)


def off(graph, values, expected):
    """The largest difference of any value, headings wrapped."""
    difference = from_values(graph, values) - expected.state
    difference[:, 2] = wrap(difference[:, 2])
    return np.abs(difference).max()


OPTIMIZERS = {
    "Levenberg-Marquardt": gtsam.LevenbergMarquardtOptimizer,
    "Gauss-Newton": gtsam.GaussNewtonOptimizer,
    "Dogleg": gtsam.DoglegOptimizer,
}


@pytest.mark.slow
@pytest.mark.parametrize("factors", ["fastest", "per-edge"])
@pytest.mark.parametrize("name", OPTIMIZERS)
def test_every_optimizer_reaches_the_hand_written_solution(name, factors, small):
    graph, expected = small
    made = to_gtsam(graph, factors=factors)
    result = OPTIMIZERS[name](made, to_values(graph, graph.initial)).optimize()
    assert 2 * made.error(result) == pytest.approx(expected.cost, rel=1e-6)
    assert off(graph, result, expected) < 1e-3


def test_isam2_takes_them(small):
    graph, expected = small
    params = gtsam.ISAM2Params()
    params.relinearizeSkip = 1
    params.setRelinearizeThreshold(1e-6)
    isam = gtsam.ISAM2(params)
    isam.update(to_gtsam(graph, graph.initial), to_values(graph, graph.initial))
    for _ in range(10):
        isam.update()
    assert off(graph, isam.calculateEstimate(), expected) < 1e-5


def test_gnc_takes_native_factors_only():
    """GTSAM's GNC clones its factors, which no Python factor can be; `to_between` is the way there."""
    truth = [gtsam.Pose2(0, 0, 0), gtsam.Pose2(1, 0.2, 0.4)]
    landmarks = np.array([[2.0, 1.0, 0.3], [1.0, -2.0, 1.0], [3.0, 0.0, -1.0], [0.5, 2.0, 2.0]])
    values, ours = gtsam.Values(), []
    for key, pose in enumerate(truth):
        values.insert(key, pose)
    for k, mark in enumerate(landmarks):
        z = [sensor.h([p.x(), p.y(), p.theta()], mark) for p in truth]
        z[1] = z[1] + ([0, 1.5, 1.0] if k == 0 else 0)  # one wrong sighting
        ours.append(VirtualMotionFactor(0, 1, z[0], z[1], sensor))
    prior = gtsam.PriorFactorPose2(0, truth[0], gtsam.noiseModel.Isotropic.Sigma(3, 1e-3))
    for native in (True, False):
        graph = gtsam.NonlinearFactorGraph()
        graph.add(prior)
        for factor in ours:
            graph.add(factor.to_between() if native else factor)
        params = gtsam.GncLMParams()
        params.setVerbosityGNC(gtsam.GncLMParams.Verbosity.SILENT)
        params.setKnownInliers([0])
        if native:
            optimizer = gtsam.GncLMOptimizer(graph, values, params)
            assert optimizer.optimize().atPose2(1).equals(truth[1], 1e-3)
            np.testing.assert_allclose(optimizer.getWeights(), [1, 0, 1, 1, 1], atol=1e-6)
        else:
            with pytest.raises(RuntimeError, match="clone"):
                gtsam.GncLMOptimizer(graph, values, params).optimize()


@pytest.mark.parametrize("kernel", [Huber(0.5), Cauchy(0.7), GemanMcClure(1.1)])
def test_a_robust_kernel_is_gtsams(kernel):
    z_1, z_2 = [1.0, 0.2, 0.3], [1.5, -0.2, 0.1]
    values = gtsam.Values()
    values.insert(0, gtsam.Pose2(0, 0.1, 0.2))
    values.insert(1, gtsam.Pose2(1, 0.0, 0.3))
    values.insert(2, gtsam.Pose2(2, 0.0, 0.3))
    for make in (
        lambda **more: VirtualMotionFactor(0, 1, z_1, z_2, **more),
        lambda **more: MotionFactor(0, 1, [0.2, 0.1], 3.0, **more),
        lambda **more: ObservationFactor(0, 2, z_1, **more),
        lambda **more: AnchorFactor(0, [0, 0, 0], np.eye(3), **more),
        lambda **more: LandmarkFactor([0, 1], [z_1, z_2], **more),
    ):
        squares, robust = 2 * make().error(values), make(kernel=kernel)
        assert 2 * robust.error(values) == pytest.approx(kernel.loss(squares))
        assert isinstance(robust.noiseModel(), gtsam.noiseModel.Robust)
        plain, weighted = (f.linearize(values).augmentedJacobian() for f in (make(), robust))
        np.testing.assert_allclose(
            weighted.T @ weighted, kernel.weight(squares) * plain.T @ plain, rtol=1e-9, atol=1e-12
        )


@pytest.mark.parametrize("sensor", [SensorModel(), SensorModel(offset=(0.4, -0.2))], ids=["centred", "offset"])
def test_the_between_factor_of_two_sightings(sensor):
    """Same value, cost and Gauss-Newton matrix where e = 0, and close by as long as e is small."""
    rng = np.random.default_rng(0)
    for _ in range(50):
        x_1, x_2 = (np.append(rng.normal(size=2), rng.uniform(-np.pi, np.pi)) for _ in range(2))
        mark = np.append(rng.normal(size=2) * 3, rng.uniform(-np.pi, np.pi))
        exact = VirtualMotionFactor(0, 1, sensor.h(x_1, mark), sensor.h(x_2, mark), sensor, scale=1.7)
        between = exact.to_between()
        values = gtsam.Values()
        values.insert(0, gtsam.Pose2(*x_1))
        values.insert(1, gtsam.Pose2(*x_2))
        assert exact.error(values) == pytest.approx(0, abs=1e-12)
        assert between.error(values) == pytest.approx(0, abs=1e-12)
        a, b = (f.linearize(values).augmentedJacobian()[:, :6] for f in (exact, between))
        np.testing.assert_allclose(a.T @ a, b.T @ b, atol=1e-7 * np.abs(a.T @ a).max())
        off = values.retract(_small(1e-3, rng)) if hasattr(values, "retract") else values
        assert between.error(off) == pytest.approx(exact.error(off), rel=0.05)


def _small(scale, rng):
    delta = gtsam.VectorValues()
    for key in (0, 1):
        delta.insert(key, scale * rng.normal(size=3))
    return delta


def test_the_between_factor_of_a_motion():
    motion = MotionFactor(0, 1, [0.3, 0.2], 2.0, scale=3.0)
    between = motion.to_between()
    values = gtsam.Values()
    values.insert(0, gtsam.Pose2(1, 2, 0.7))
    values.insert(1, gtsam.Pose2(1, 2, 0.7).compose(between.measured()))
    a, b = (f.linearize(values).augmentedJacobian() for f in (motion, between))
    np.testing.assert_allclose(a.T @ a, b.T @ b, atol=1e-8 * np.abs(a.T @ a).max())
    assert len(between.serialize()) > 0


def test_a_solution_names_the_factors(book_log):
    pairs = solve_with_gtsam(Graph.from_log(book_log, edges="virtual+motion", kernel="none"))
    assert "graph: 1 AnchorFactor, 6 LandmarkFactors" in pairs.notes[-1]
    assert (
        "807 VirtualMotionFactor"
        in solve_with_gtsam(Graph.from_log(book_log, edges="virtual+motion", kernel="none"), factors="per-edge").notes[
            -1
        ]
    )
    native = solve_with_gtsam(
        Graph.from_log(book_log, edges="landmark+motion", dimensions=2, residual="polar", kernel="none")
    )
    assert "101 BearingRangeFactor2D" in native.notes[-1]


def test_what_a_graph_holds_can_be_made_native(small):
    graph, _ = small
    made = to_gtsam(graph, factors="per-edge")
    kinds = {describe(made.at(k)).kind for k in range(made.size())}
    assert kinds == {"AnchorFactor", "RelativePoseFactor", "VirtualMotionFactor"}
