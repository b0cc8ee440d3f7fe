"""The restricted likelihood of noise and biases: its derivatives, its value by dense matrices, and its maximum."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from error_rates import bound

from graphslam import Drive, SensorModel, estimate_robot
from graphslam.identification import restricted_likelihood
from graphslam.identification import unknowns as unknowns_module
from graphslam.identification.declared import KINDS, PLACE
from graphslam.identification.restricted_likelihood import improve_variances, log_likelihood
from graphslam.identification.unknowns import (
    DEGREES_MOTIONS,
    DEGREES_SIGHTINGS,
    OF_GAUSSIAN_MOTIONS,
    OF_GAUSSIAN_SIGHTINGS,
    PRIORS,
    Linear,
    Unknowns,
)
from graphslam.simulation.worlds import SENSORS


def test_the_jacobians_are_those_of_finite_differences() -> None:
    log, _ = Drive(seed=7, duration=60.0, orientation=True, misread=0.0).simulate()
    unknowns = Unknowns(log, log.landmarks, SensorModel())
    rng, h = np.random.default_rng(0), 1e-5
    start = unknowns.parameters.at(unknowns.parameters.values + 0.02 * rng.standard_normal(len(unknowns.parameters)))
    for edges_of, names in ((unknowns.motions, start.names[:4]), (unknowns.sighted, start.names[4:])):
        for name in names:
            k, sides = start.names.index(name), []
            for sign in (1, -1):
                values = start.values.copy()
                values[k] += sign * h
                unknowns.parameters = start.at(values)
                sides.append(edges_of().residuals)
            unknowns.parameters = start
            assert edges_of().by_parameters[:, :, k] == pytest.approx((sides[0] - sides[1]) / (2 * h), abs=1e-6), name
        edges, state = edges_of(), unknowns.state.copy()
        for node in (5, 40, int(edges.second.max())):
            for c in range(3):
                sides = []
                for sign in (1, -1):
                    unknowns.state = state.copy()
                    unknowns.state[node, c] += sign * h
                    sides.append(edges_of().residuals)
                unknowns.state = state
                numeric = (sides[0] - sides[1]) / (2 * h)
                for ends, jacobian in ((edges.first, edges.by_first), (edges.second, edges.by_second)):
                    rows = ends == node
                    assert jacobian[rows, :, c] == pytest.approx(numeric[rows], abs=1e-6)


@pytest.mark.parametrize("orientation", [False, True])
def test_the_normal_equations_are_those_of_dense_matrices(orientation) -> None:
    """(B, J)' W (B, J) with the first pose held, and the step that solves them together with the priors."""
    log, _ = Drive(seed=8, duration=12.0, orientation=orientation, landmarks=8, misread=0.0).simulate()
    unknowns = Unknowns(log, log.landmarks, SensorModel())
    linear, K = unknowns.linearized(), len(unknowns.parameters)
    n = len(unknowns.state)
    total, right = np.zeros((3 * n + K, 3 * n + K)), np.zeros(3 * n + K)
    for edges in linear.edges:
        for e in range(len(edges.residuals)):
            jacobian = np.zeros((edges.residuals.shape[1], 3 * n + K))
            for node, by in ((edges.first[e], edges.by_first[e]), (edges.second[e], edges.by_second[e])):
                jacobian[:, 3 * node : 3 * node + 3] = by
            jacobian[:, 3 * n :] = edges.by_parameters[e]
            total += jacobian.T @ edges.information[e] @ jacobian
            right -= jacobian.T @ edges.information[e] @ edges.residuals[e]
    parameters = unknowns.parameters
    total[3 * n :, 3 * n :] += np.diag(parameters.weights)
    right[3 * n :] -= parameters.weights * (parameters.values - parameters.means)
    free = np.ones(3 * n + K, dtype=bool)
    free[:3] = False
    if not orientation:
        free[3 * unknowns.poses + 2 : 3 * n : 3] = False
    expected = np.zeros(3 * n + K)
    expected[free] = np.linalg.solve(total[np.ix_(free, free)], right[free])
    nodes, values = linear.step()
    assert values == pytest.approx(expected[3 * n :], rel=1e-6, abs=1e-9)
    assert nodes.ravel() == pytest.approx(expected[: 3 * n], rel=1e-6, abs=1e-7)
    turned = [
        replace(edges, first=edges.second, second=edges.first, by_first=edges.by_second, by_second=edges.by_first)
        for edges in linear.edges
    ]
    assert Linear(unknowns, turned).schur == pytest.approx(linear.schur, rel=1e-9)


def test_variances_that_are_ten_times_too_large_come_down_to_the_truth() -> None:
    """From ten times the true standard deviation of the bearing, as from a tenth of it."""
    log, truth = Drive(seed=8, duration=60.0, landmarks=12, misread=0.0).simulate()
    for factor in (0.1, 10.0):
        unknowns = Unknowns(log, log.landmarks, SensorModel())
        unknowns.logarithms["bearing_std"] = 2 * np.log(factor * truth.sensor.bearing_std)
        for _ in range(10):
            unknowns.iterate(3)
            improve_variances(unknowns)
        assert unknowns.variances["bearing_std"] ** 0.5 == pytest.approx(truth.sensor.bearing_std, rel=0.3)


def test_the_likelihood_is_that_of_dense_matrices() -> None:
    """Its differences between variances, where Student's t has so many degrees of freedom that it is Gaussian."""
    log = Drive(seed=8, duration=12.0, landmarks=8, misread=0.0).simulate()[0]
    unknowns = Unknowns(log, log.landmarks, SensorModel())
    with pytest.MonkeyPatch.context() as patch:
        for module in (restricted_likelihood, unknowns_module):
            patch.setattr(module, "DEGREES_MOTIONS", 1e9)
            patch.setattr(module, "DEGREES_SIGHTINGS", 1e9)
        values = []
        for factor in (1.0, 3.0):
            unknowns.logarithms["bearing_std"] += np.log(factor)
            linear, p = unknowns.linearized(), unknowns.parameters
            n, K = len(unknowns.state), len(p)
            free = np.array([c for c in range(3, 3 * n) if c < 3 * unknowns.poses or c % 3 < 2])
            information, determinants, quadratic = np.diag(np.r_[np.zeros(len(free)), p.weights]), 0.0, 0.0
            for edges in linear.edges:
                unit = np.eye(3 * n + K)
                A = edges.moved(unit[: 3 * n].reshape(n, 3, -1), unit[3 * n :])[:, :, np.r_[free, 3 * n : 3 * n + K]]
                C = unknowns.covariances(edges)
                information += np.einsum("eij,eik,ekl->jl", A, np.linalg.inv(C), A)
                determinants += np.linalg.slogdet(C)[1].sum()
                quadratic += np.sum(edges.residuals * np.linalg.solve(C, edges.residuals[:, :, None])[:, :, 0])
            dense = -0.5 * (determinants + quadratic + np.linalg.slogdet(information)[1])
            values.append((dense, log_likelihood(unknowns)))
    (dense, own), (dense_after, own_after) = values
    assert own_after - own == pytest.approx(dense_after - dense, abs=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("d", "degrees"),
    [(2, DEGREES_SIGHTINGS), (3, DEGREES_MOTIONS), pytest.param(3, DEGREES_SIGHTINGS, marks=pytest.mark.nightly)],
)
def test_weights_of_student_t_overstate_the_information_of_gaussian_errors(d, degrees) -> None:
    """10,000 estimates of a place and of a variance, each from 60 errors N(0, I) of d numbers."""
    of_motions = degrees == DEGREES_MOTIONS
    part = OF_GAUSSIAN_MOTIONS if of_motions else OF_GAUSSIAN_SIGHTINGS[d]
    places = unknowns_module.OVERSTATED_MOTIONS if of_motions else unknowns_module.OVERSTATED_SIGHTINGS[d]
    variances = (
        restricted_likelihood.OVERSTATED_BY_MOTIONS if of_motions else restricted_likelihood.OVERSTATED_BY_SIGHTINGS[d]
    )
    e = np.random.default_rng(0).standard_normal((10_000, 60, d))
    place, variance = np.zeros((10_000, 1, d)), np.full((10_000, 1), part)
    # about the true place: an estimated one takes degrees of freedom
    lengths = np.sum(e**2, axis=2)
    for _ in range(30):
        squares = np.sum((e - place) ** 2, axis=2)
        weights = (degrees + d) / (degrees + squares / part)
        place = np.sum(weights[:, :, None] * e, axis=1, keepdims=True) / weights.sum(axis=1)[:, None, None]
        variance = np.mean((degrees + d) * lengths / (degrees + lengths / variance), axis=1, keepdims=True) / d
    claimed = weights.sum(axis=1).mean() / part
    # 60 errors are few, which adds some 3 %
    assert claimed * np.mean(place**2) == pytest.approx(places, rel=0.05)
    assert 60 * d / 2 * np.var(np.log(variance)) == pytest.approx(variances, rel=0.05)


def test_standard_errors_are_those_of_gaussian_errors() -> None:
    """Without priors, the covariance of the biases is larger by what motions and by what sightings overstate."""
    log, _ = Drive(seed=8, duration=60.0, landmarks=12, misread=0.0).simulate()
    unknowns = Unknowns(log, log.landmarks, SensorModel())
    unknowns.iterate(5)
    p = unknowns.parameters
    unknowns.parameters = replace(p, deviations=np.full(len(p), 1e3))
    claimed, honest = unknowns.linearized().covariance, unknowns.parameter_covariance()
    ratios = np.linalg.eigvals(np.linalg.solve(claimed, honest)).real
    assert ratios.min() > unknowns_module.OVERSTATED_MOTIONS - 1e-3
    assert ratios.max() < unknowns_module.OVERSTATED_SIGHTINGS[2] + 1e-3
    assert np.ptp(ratios) > 0.1


def test_biases_that_the_log_does_not_tell_stay_uncertain(monkeypatch: pytest.MonkeyPatch) -> None:
    """Right ranges, bearings and times hold the place of the sensor at its ideal value, too, and say little about it."""
    names = KINDS["sensor"]
    priors = np.array([PRIORS[name] for name in names])
    told = np.isin(names, PLACE, invert=True)
    deviations = np.where(told, 0.02, 0.9) * priors
    parameters = SimpleNamespace(names=names, values=np.zeros(5), means=np.zeros(5), deviations=priors)

    def evidence_against(some: list[str]) -> float:
        # independent estimates at the ideal values: the quotients of the densities are those of the deviations
        return float(sum(np.log(priors / deviations)[names.index(name)] for name in some))

    fitted = SimpleNamespace(
        parameters=parameters, evidence_against=evidence_against, hold=lambda _: None,
        linearized=lambda: SimpleNamespace(covariance=np.diag(deviations**2)),
    )  # fmt: skip
    monkeypatch.setattr(restricted_likelihood, "KINDS", {"sensor": names})
    monkeypatch.setattr(restricted_likelihood, "fit", lambda *_: None)
    held = np.array(list(restricted_likelihood.hold_needless(fitted, 1).values()))
    # with the probability sigma / (s + sigma) of a bias, s its prior
    expected = np.sqrt(deviations / (priors + deviations)) * deviations
    assert np.all(held[~told] > expected[~told]) and np.all(held[~told] < 1.01 * expected[~told])
    assert np.all(held[told] < 0.02 * priors[told])


def test_drawn_errors_leave_the_residuals_of_the_solution() -> None:
    """Their covariance is that of the errors minus that of the fitted part, here in one sum for all sightings."""
    log, _ = Drive(seed=8, duration=30.0, landmarks=12, misread=0.0).simulate()
    unknowns = Unknowns(log, log.landmarks, SensorModel())
    unknowns.iterate(3)
    linear, count = unknowns.linearized(), 2000
    nodes, values, errors = linear.drawn(count, np.random.default_rng(0))
    edges = linear.edges[1]
    left = errors - edges.moved(nodes, values)
    sampled = np.einsum("eik,eij,ejk->", left, edges.information, left) / count
    expected = errors.shape[0] * errors.shape[1] - np.sum(edges.information * linear.fitted(edges))
    # a sample has the variance 2 tr(M²) <= 2 tr(M) at most
    assert abs(sampled - expected) < bound(2) * (2 * expected / count) ** 0.5


@pytest.mark.parametrize("seed", [1, 5, 21])
def test_independent_errors_of_few_sightings_do_not_seem_to_last(seed: int) -> None:
    robot = Drive(
        seed=seed,
        duration=100.0,
        landmarks=40,
        misread=0.0,
        sensor_rate=2.0,
        odometry_rate=20.0,
        sensor=SENSORS["laser"],
    )
    # by the covariances of predictions from few of them, 4.5 to 6.9 sightings counted as one
    assert estimate_robot(robot.simulate()[0]).inflation == 1.0
