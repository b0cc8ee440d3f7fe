from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from comparisons.comparison import compare, run
from comparisons.estimators import ESTIMATORS, Estimator, default_estimators, make_graph, pair_count
from comparisons.options import RunOptions
from comparisons.results.documents import jsonable
from comparisons.results.results import parameters_of
from comparisons.show.tables import as_text
from graphslam import Log, MotionModel, OptionError, SensorModel, SlamError, simulate, solve, textbook
from graphslam.graph.defaults import suitable_edges
from graphslam.log.rows import UNIDENTIFIED
from graphslam.models import EDGES


@pytest.fixture(scope="module")
def log() -> Log:
    return simulate(seed=2, steps=24, clean=True)


OPTIONS = RunOptions.of(particles=50, gibbs_iterations=20, gibbs_warm_up=20, motion=MotionModel(), sensor=SensorModel())


@pytest.mark.parametrize("name", ESTIMATORS)
def test_every_estimator_answers_in_the_same_form(log: Log, name: str) -> None:
    result = ESTIMATORS[name].run(log, OPTIONS)
    assert result.name == name
    assert result.poses.shape == (25, 3)
    assert result.estimated.shape == (25,)
    assert np.all((result.poses[:, 2] >= -np.pi) & (result.poses[:, 2] < np.pi))
    assert result.seconds >= 0
    # samples are drawn, not corrected
    assert len(result.step_norms) == (0 if name == "particle-gibbs" else result.iterations)
    assert result.landmarks.keys() == result.landmark_covariances.keys()
    assert bool(result.landmarks) == (name != "mcl")
    assert (result.converged is None) == (result.iterations == 0)
    # online and isam2 minimise J, too, but in one pass
    minimises = name in ("online", "isam2") or (result.iterations > 0 and name != "particle-gibbs")
    assert (result.cost is None) == (not minimises)


def _returns(**changes: object) -> Estimator:
    """An estimator that returns dead reckoning with some parts changed."""
    return Estimator(lambda log, options: replace(ESTIMATORS["dead-reckoning"].run(log, options), **changes))


@pytest.mark.parametrize(
    ("estimator", "words"),
    [
        (_returns(poses=np.zeros((24, 3))), "returned poses .*an array of numbers (25, 3).*of shape (24, 3)"),
        (_returns(poses=np.zeros((25, 2))), "returned poses .*of shape (25, 2)"),
        (_returns(poses=[[0, 0, 0]] * 25), "returned poses .*an array of numbers (25, 3)"),
        (_returns(poses=np.full((25, 3), np.nan)), "returned poses .*finite numbers wherever estimated is true"),
        (_returns(estimated=np.ones(25)), "returned estimated .*an array of bool (25,).*type float64"),
        (
            _returns(landmarks={3: np.array([np.nan, 1.0])}, named=False),
            "returned landmarks[3] .*expected finite numbers",
        ),
        (_returns(landmarks={3: np.zeros(4)}), "returned landmarks[3] .*of shape (4,)"),
        (_returns(landmark_covariances={3: np.zeros((2, 3))}), "returned landmark_covariances[3] .*of shape (2, 3)"),
        (_returns(association=np.zeros(2)), "returned association .*an id for each of the"),
        (Estimator(lambda log, _: log.initial_poses), "returned a result .*expected an EstimatorResult"),  # type: ignore[arg-type,return-value]
    ],
)
def test_a_result_of_a_wrong_shape_is_named(
    log: Log, monkeypatch: pytest.MonkeyPatch, estimator: Estimator, words: str
) -> None:
    monkeypatch.setitem(ESTIMATORS, "mine", estimator)
    outcome = compare(log, OPTIONS, estimators=["mine", "dead-reckoning"])
    assert [result.name for result in outcome.results] == ["dead-reckoning"]
    ((skipped),) = outcome.skipped
    assert skipped.name == "mine" and skipped.outcome == "failed"
    for part in words.split(".*"):
        assert part in skipped.reason


def test_the_row_of_an_estimator_has_the_name_it_is_registered_by(log: Log, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(ESTIMATORS, "mine", _returns())
    outcome = compare(log, OPTIONS, estimators=["mine", "dead-reckoning"])
    assert [row.name for row in outcome.table] == ["dead-reckoning", "mine"]


def test_graph_is_what_the_library_solves(log: Log) -> None:
    options = replace(OPTIONS, edges="virtual+motion", frame="world", weight="tempered", motion_weight=3.0)
    result = ESTIMATORS["graph"].run(log, options)
    expected = solve(make_graph(log, options), initialize="auto")
    np.testing.assert_array_equal(result.poses, expected.poses)
    assert (result.cost, result.iterations) == (expected.cost, expected.iterations)
    recorded = {"edges": "virtual+motion", "frame": "world", "weight": "tempered", "motion_weight": 3.0}
    assert result.options == recorded | {
        "initialize": "auto", "kernel": "none", "residual": "cartesian", "estimate": None, "range_noise": "measured",
    }  # fmt: skip
    given = ESTIMATORS["graph"].run(log, replace(options, initialize="given"))
    np.testing.assert_array_equal(given.poses, solve(make_graph(log, options), initialize="given").poses)


def test_graph_marginal_counts_each_sighting_once(log: Log) -> None:
    """The landmark eliminated exactly and the landmark as a node are two ways to one answer where the noise is small."""
    part = {
        "motion": MotionModel(nn=0.019, no=0.0001, on=0.013, oo=0.02, epsilon=1e-6),
        "sensor": SensorModel(range_rate=0.014, bearing_std=0.005, orientation_std=0.005),
    }
    precise = simulate(seed=2, steps=24, clean=True, **part)
    once = ESTIMATORS["graph-marginal"].run(precise, replace(OPTIONS, **part))
    nodes = ESTIMATORS["graph"].run(precise, replace(OPTIONS, **part, edges="landmark+motion"))
    assert once.options["weight"] == "marginal"
    np.testing.assert_allclose(once.poses, nodes.poses, atol=2e-3)
    np.testing.assert_allclose(once.pose_covariances[5:], nodes.pose_covariances[5:], rtol=0.1)  # type: ignore[index]
    # about 1 for all of them, although J of the pairs is several times that of the others
    pairs = ESTIMATORS["graph"].run(precise, replace(OPTIONS, **part))
    assert pairs.cost is not None and once.cost is not None
    assert pairs.cost > 2 * once.cost
    for result in (pairs, once, nodes):
        assert result.cost_per_dof == pytest.approx(1.0, abs=0.3)


def test_real_data_have_a_kernel_by_default(log: Log) -> None:
    real, few = log.replace(simulated=False), ["graph"]
    (simulated,) = compare(log, OPTIONS, estimators=few).results
    (default,) = compare(real, OPTIONS, estimators=few).results
    (cauchy,) = compare(log, replace(OPTIONS, kernel="cauchy"), estimators=few).results
    (asked,) = compare(real, OPTIONS, estimators=["graph-no-kernel"]).results
    assert (simulated.options["kernel"], default.options["kernel"]) == ("none", "cauchy")
    np.testing.assert_array_equal(default.poses, cauchy.poses)
    np.testing.assert_array_equal(asked.poses, simulated.poses)
    assert simulated.weighed_down is None
    # every other estimator of the graph follows; with a kernel GTSAM has a factor for each pair
    forecast = ESTIMATORS["gtsam"].seconds_per_iteration
    assert forecast is not None
    assert forecast(real, OPTIONS) > 10 * forecast(log, OPTIONS)
    assert ESTIMATORS["gtsam"].run(real, OPTIONS).cost == pytest.approx(default.cost, rel=1e-9)
    assert make_graph(real, OPTIONS).verdict[0] == make_graph(log, replace(OPTIONS, kernel="cauchy")).verdict[0]
    assert "graph-no-kernel" not in default_estimators()


def test_a_kernel_says_how_many_sightings_it_weighs_down(log: Log) -> None:
    wrong = log.sightings.copy()
    wrong[[5, 15, 25], 0] += 40.0
    for edges in ("virtual+motion", "landmark+motion"):
        options = replace(OPTIONS, kernel="cauchy", edges=edges)
        before, after = (ESTIMATORS["graph"].run(each, options) for each in (log, log.replace(sightings=wrong)))
        assert before.weighed_down is not None and after.weighed_down is not None
        assert after.graph is not None and after.state is not None
        weights = np.empty(len(log.steps))
        weights[after.graph.sighting_rows] = after.graph.sighting_weights(after.state)
        assert np.all(weights[[5, 15, 25]] < 0.5)
        assert after.weighed_down == np.count_nonzero(weights < 0.5)
        # Gaussian noise: chi-square with 3 degrees of freedom above the square of the width, 2.666
        assert any(f"gives {after.weighed_down} of {len(log.steps)} sightings" in note for note in after.notes)
        assert any("6.9% would be usual" in note for note in after.notes)


@pytest.mark.slow
@pytest.mark.parametrize("kernel", ["huber", "cauchy", "geman-mcclure"])
def test_j_per_degree_of_freedom_is_about_one_with_every_kernel(kernel: str) -> None:
    ratios = []
    for seed in range(5):
        clean = simulate(seed=seed, clean=True)
        for edges, weight in (
            ("virtual+motion", "pairs"),
            ("virtual+motion", "marginal"),
            ("landmark+motion", "pairs"),
        ):
            options = replace(OPTIONS, kernel=kernel, edges=edges, weight=weight)
            ratios.append(ESTIMATORS["graph"].run(clean, options).cost_per_dof)
    assert np.median(ratios) == pytest.approx(1.0, abs=0.12)  # type: ignore[arg-type]


def test_graph_marginal_is_left_out_where_it_repeats_the_graph(log: Log) -> None:
    reason = ESTIMATORS["graph-marginal"].reason_to_omit
    assert reason(log, OPTIONS) is None
    assert "marginal weights" in str(reason(log, replace(OPTIONS, weight="marginal")))
    assert "nodes" in str(reason(log.without_orientation(), OPTIONS))
    outcome = compare(log.without_orientation(), OPTIONS)
    assert "nodes" in str(outcome.table["graph-marginal"].skipped)


def test_gtsam_solves_the_same_graph(log: Log) -> None:
    ours, theirs = (ESTIMATORS[name].run(log, OPTIONS) for name in ("graph", "gtsam"))
    np.testing.assert_allclose(theirs.poses, ours.poses, atol=1e-6)
    assert theirs.cost == pytest.approx(ours.cost, rel=1e-9)


def test_graph_and_gtsam_take_the_noise_at_the_estimated_ranges(log: Log) -> None:
    options = RunOptions.of(**vars(OPTIONS) | {"range_noise": "estimated"})
    ours, theirs = (ESTIMATORS[name].run(log, options) for name in ("graph", "gtsam"))
    np.testing.assert_allclose(theirs.poses, ours.poses, atol=1e-6)
    assert ours.options is not None and ours.options["range_noise"] == "estimated"
    assert np.abs(ours.poses - ESTIMATORS["graph"].run(log, OPTIONS).poses).max() > 1e-3


def test_textbook_is_the_books_program(log: Log) -> None:
    result = ESTIMATORS["textbook"].run(log, OPTIONS)
    expected = textbook.solve(log, edges="virtual+motion")
    np.testing.assert_allclose(result.step_norms, expected.step_norms)
    np.testing.assert_allclose(result.poses[:, :2], expected.poses[:, :2])
    assert ESTIMATORS["textbook"].run(log, replace(OPTIONS, edges="virtual")).options["threshold"] == 0.01


def test_models_reach_every_estimator(log: Log) -> None:
    sensor, motion = SensorModel(range_rate=0.5), MotionModel(nn=0.9)
    other = replace(OPTIONS, sensor=sensor, motion=motion)
    for name in ("textbook", "graph", "gtsam", "mcl", "fastslam1", "fastslam2"):
        run = ESTIMATORS[name].run
        assert not np.allclose(run(log, OPTIONS).poses, run(log, other).poses), name


def test_the_row_of_a_filter_is_the_median_of_five_seeds(log: Log) -> None:
    default = compare(log, OPTIONS, estimators=["fastslam1", "mcl"])
    alone = {seed: compare(log, replace_seed(seed), estimators=["fastslam1"]) for seed in range(5)}
    errors = {seed: one.table["fastslam1"].ate_m for seed, one in alone.items()}
    result = default["fastslam1"]
    assert dict(result.seed_errors or {}) == errors
    median = next(seed for seed, error in errors.items() if error == np.median(list(errors.values())))
    # naming the seed gives the same run, and one run only
    assert np.array_equal(result.poses, alone[median]["fastslam1"].poses) and result.options["seed"] == median
    assert alone[median]["fastslam1"].seed_errors is None
    low, high = min(errors.values()), max(errors.values())
    assert any(f"{low:.3f} to {high:.3f} m" in note and f"--seed {median}" in note for note in result.notes)
    assert default.to_json()["estimators"][1]["seed_errors"] == {str(seed): error for seed, error in errors.items()}


def replace_seed(seed: int) -> RunOptions:
    return OPTIONS.with_numbers(seed=seed)


def test_a_filter_runs_once_without_truth_and_on_large_logs(log: Log) -> None:
    assert compare(log.replace(true_poses=None), OPTIONS, estimators=["fastslam1"])["fastslam1"].seed_errors is None
    many = OPTIONS.with_numbers(particles=1_000_000 // len(log.steps))
    assert compare(log, many, estimators=["mcl"])["mcl"].seed_errors is None


def test_the_table_says_that_mcl_knows_the_true_map(log: Log) -> None:
    outcome = compare(log, OPTIONS, estimators=["mcl", "fastslam1"])
    names = [line.split("  ")[0] for line in as_text(outcome).splitlines()]
    assert "mcl (true map)" in names and "fastslam1" in names
    assert [row["knows"] for row in outcome.to_json()["estimators"]] == ["true map", ""]


def test_the_seed_decides(log: Log) -> None:
    run = ESTIMATORS["fastslam1"].run
    again, other = run(log, OPTIONS), run(log, OPTIONS.with_numbers(seed=1))
    np.testing.assert_array_equal(run(log, OPTIONS).poses, again.poses)
    assert not np.allclose(again.poses, other.poses)


def test_without_controls_there_are_no_motion_edges(log: Log) -> None:
    bare = log.replace(dt=None, controls=None)
    assert (suitable_edges(log), suitable_edges(bare)) == ("virtual+motion", "virtual")
    reckoned = ESTIMATORS["dead-reckoning"].run(bare, OPTIONS)
    np.testing.assert_allclose(reckoned.poses[:, :2], log.initial_poses[:, :2])
    assert "no controls" in reckoned.notes[0]
    with pytest.raises(SlamError):
        ESTIMATORS["fastslam1"].run(bare, OPTIONS)


def test_without_psi_landmarks_are_nodes_where_the_graph_can(log: Log) -> None:
    flat = log.without_orientation()
    assert suitable_edges(flat) == ("landmark+motion" if "landmark+motion" in EDGES else "virtual+motion")
    assert ESTIMATORS["textbook"].run(flat, OPTIONS).options["edges"] == "virtual+motion"
    assert ESTIMATORS["graph"].run(flat, OPTIONS).converged


def test_a_log_in_which_nothing_is_seen_twice_still_runs_the_filters(log: Log) -> None:
    first = np.unique(log.landmarks, return_index=True)[1]
    once = log.replace(steps=log.steps[sorted(first)], landmarks=log.landmarks[sorted(first)],
                       sightings=log.sightings[sorted(first)])  # fmt: skip
    assert ESTIMATORS["fastslam1"].run(once, OPTIONS).landmarks.keys() == set(log.landmarks.tolist())


def test_pairs_are_counted() -> None:
    log = Log(
        steps=[0, 1, 2, 2, 3], landmarks=[5, 5, 5, 6, 6], sightings=np.ones((5, 3)), initial_poses=np.zeros((4, 3))
    )
    assert pair_count(log) == 3 + 1


def test_slow_estimators_say_so(log: Log) -> None:
    entry = Estimator(ESTIMATORS["graph"].run, seconds_per_iteration=lambda *_: 30.0)
    reason = entry.too_slow(log, OPTIONS)
    assert reason is not None
    assert "30 s" in reason
    assert all(estimator.too_slow(log, OPTIONS) is None for estimator in ESTIMATORS.values())
    crowded = log.replace(steps=np.full(2000, 3), landmarks=np.zeros(2000, int), sightings=np.ones((2000, 3)))
    assert ESTIMATORS["gtsam"].too_slow(crowded, OPTIONS)
    assert ESTIMATORS["textbook"].too_slow(crowded, OPTIONS)
    # one edge for each sighting of a landmark node, in place of one for each pair
    assert not ESTIMATORS["gtsam"].too_slow(crowded, replace(OPTIONS, edges="landmark+motion"))
    assert not ESTIMATORS["gtsam"].too_slow(crowded.without_orientation(), OPTIONS)


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"edges": "pairs"}, "edges"),
        ({"frame": "map"}, "frame"),
        ({"weight": "heavy"}, "weight"),
        ({"motion_weight": 0.0}, "motion_weight"),
        ({"motion_weight": float("nan")}, "motion_weight"),
        ({"particles": 0}, "particles"),
        ({"seed": -1}, "seed"),
        ({"initialize": "somewhere"}, "initialize"),
    ],
)
def test_impossible_options(options: dict[str, object], word: str) -> None:
    with pytest.raises(OptionError, match=word):
        RunOptions.of(**options)


@pytest.mark.parametrize("name", ["fastslam1", "fastslam2"])
def test_filters_that_ignore_the_ids_number_their_map_and_are_judged_by_place(name):
    part = {
        "motion": MotionModel(nn=0.095, no=0.0005, on=0.065, oo=0.1, epsilon=2.5e-5),
        "sensor": SensorModel(range_rate=0.07, bearing_std=0.025, orientation_std=0.025),
    }
    log = simulate(seed=1, clean=True, **part)
    options = RunOptions.of(particles=100, association="maximum-likelihood", resampling="residual", **part)
    outcome = compare(log, options, estimators=[name])
    result = outcome[name]
    assert len(result.landmarks) == len(log.landmark_ids)
    assert result.options["association"] == "maximum-likelihood"
    assert not result.named
    assert "numbered by discovery" in result.notes[0]
    nearest = [min(np.hypot(*(m - t)[:2]) for m in result.landmarks.values()) for t in log.true_landmarks.values()]
    # both are errors of the same pairs, before and after the trajectory is aligned
    assert outcome.metrics[name].landmark_rmse_m == pytest.approx(np.sqrt(np.mean(np.square(nearest))), abs=0.15)
    assert outcome.metrics[name].landmark_rmse_m < 0.5


def test_what_mcl_needs(log: Log) -> None:
    blind = log.replace(true_landmarks=None, name="attic")
    with pytest.raises(
        OptionError, match="true map of the landmarks, which attic does not have; name a map with --map"
    ):
        ESTIMATORS["mcl"].run(blind, OPTIONS)


@pytest.mark.parametrize("options", [{"resampling": "wheel"}, {"association": "guess"}, {"initialize": "zero"}])
def test_impossible_options_of_the_filters(options):
    with pytest.raises(OptionError, match="must be one of"):
        RunOptions.of(**options)


def test_parameters_are_estimated_and_told(log: Log) -> None:
    options = replace(OPTIONS, edges="landmark+motion", estimate=("turn-scale", "bearing_bias:0.1"))
    result = ESTIMATORS["graph"].run(log, options)
    expected = solve(make_graph(log, options)).parameters
    assert result.parameters is not None and expected is not None
    np.testing.assert_array_equal(result.parameters.values, expected.values)
    assert any(expected.sentence in note for note in result.notes)
    told = jsonable(parameters_of(result.parameters))
    assert told is not None and told["turn_scale"]["prior"] is None and told["bearing_bias"]["prior"] == 0.1
    assert told["turn_scale"]["deviation"] == expected.deviations["turn_scale"]
    assert ESTIMATORS["isam2"].run(log, options).parameters is None
    with pytest.raises(OptionError, match="no parameter 'turn'"):
        replace(OPTIONS, estimate=("turn",))


def test_online_with_a_lag(log: Log) -> None:
    whole, lagged = (ESTIMATORS["online"].run(log, replace(OPTIONS, lag=lag)) for lag in (None, 12))
    assert lagged.poses.shape == whole.poses.shape
    assert 0 < np.abs(lagged.poses - whole.poses).max() < 0.5
    assert whole.cost_per_dof is not None and lagged.cost is None and lagged.cost_per_dof is None
    with pytest.raises(OptionError, match="lag"):
        replace(OPTIONS, lag=0)


def test_options_that_a_row_does_not_use_are_said(log: Log) -> None:
    compared = run(log, estimators=["textbook", "graph", "online"], residual="polar", edges="landmark+motion")
    assert compared["graph"].options["residual"] == "polar"
    assert compared["online"].options["residual"] == "cartesian"
    notes = {name: [each for each in compared[name].notes if "does not use" in each] for name in ("graph", "online")}
    assert notes["graph"] == []
    assert notes["online"] == [
        "does not use --residual: it has landmark nodes with Cartesian residuals, and estimates no parameters"
    ]
    assert any(each.startswith("does not use --residual:") for each in compared["textbook"].notes)
    assert compared.findings == ()


def test_rows_that_take_the_noise_at_measured_ranges_say_so(log: Log) -> None:
    rows = ("textbook", "graph", "gtsam", "online", "isam2")
    compared = run(log, estimators=rows, range_noise="estimated", edges="landmark+motion")
    said = {row: any(each.startswith("does not use --range-noise:") for each in compared[row].notes) for row in rows}
    assert said == {"textbook": True, "graph": False, "gtsam": False, "online": True, "isam2": True}


def test_options_that_no_row_uses_are_said(log: Log) -> None:
    unused = [each.message for each in run(log, estimators="graph", lag=5, particles=10, association="auto").findings]
    assert unused == [
        "no estimator of this run uses --lag; online would",
        "no estimator of this run uses --particles; mcl, fastslam1, fastslam2 would",
    ]
    without_ids = log.replace(landmarks=np.full(len(log.steps), UNIDENTIFIED))
    # the front end finds the ids of the graph by a filter
    found = run(without_ids, estimators="graph", resampling="stratified").findings
    assert "unused option" not in [each.check for each in found]


@pytest.mark.slow
def test_modules_are_loaded_before_the_time_is_measured() -> None:
    """On real data the time of graph was that of importing SciPy's functions: 570 ms, and 15 ms in a second run."""
    script = (
        "import sys; from comparisons.estimators import ESTIMATORS, warm_up; from comparisons.options import RunOptions;"
        "from graphslam import MotionModel, SensorModel, simulate; warm_up('graph', simulated=False); known = {*sys.modules};"
        "log = simulate(seed=1).replace(simulated=False);"
        "ESTIMATORS['graph'].run(log, RunOptions.of(motion=MotionModel(), sensor=SensorModel()));"
        "sys.exit(', '.join({*sys.modules} - known) or 0)"
    )
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
