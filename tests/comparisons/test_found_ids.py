"""Estimators on logs whose sightings have no ids: the graph finds them, and they are compared with the true ones."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest

from comparisons import run
from comparisons.estimators import ESTIMATORS, pair_count
from comparisons.results.files import texts
from comparisons.show.films import animate
from comparisons.show.report import association_table
from comparisons.show.tables import landmark_table
from fastslam import FastSLAM2
from graphslam import Graph, GraphError, OptionError, load, sample_log_path
from graphslam.association import score
from graphslam.log import UNIDENTIFIED


@pytest.fixture(scope="module")
def log():
    return load(sample_log_path())


def test_the_graph_finds_ids_that_the_log_lacks(log):
    hidden = log.replace(landmarks=np.full(len(log.steps), UNIDENTIFIED))
    comparison = run(hidden, estimators=["graph", "gtsam"])
    known = run(log, estimators="graph")
    for name in ("graph", "gtsam"):
        result = comparison[name]
        assert score(result.association, log.landmarks).precision == 1.0
        assert not result.named and "found 13 landmarks" in result.notes[0]
        assert comparison.metrics[name].ate_m < 1.1 * known.metrics["graph"].ate_m
        assert comparison.metrics[name].landmark_rmse_m < 1.1 * known.metrics["graph"].landmark_rmse_m
    assert "283 sightings of unidentified landmarks" in comparison.table.title
    # the forecast of how long GTSAM takes counts the landmarks that were found
    forecast = ESTIMATORS["gtsam"].seconds_per_iteration
    assert forecast(hidden, comparison.options) == pytest.approx(forecast(log, known.options))
    assert pair_count(hidden) == 0 < pair_count(log)
    entry = comparison.to_json()["estimators"][0]
    assert entry["cost_per_dof"] < 1.1 and entry["certificate"]["status"] in ("global", "not applicable", "not proven")
    assert comparison.table["graph"].certificate is not None
    with pytest.raises(GraphError, match=r"fastslam\.associate"):
        Graph.from_log(hidden)
    # without true ids there is nothing to compare with
    assert comparison.associations["graph"] is None
    assert comparison.to_json()["estimators"][0]["association"]["landmarks"] == 13
    assert known["graph"].association is None


@pytest.mark.slow
def test_a_map_that_cannot_be_relied_on_is_a_warning(log):
    hidden = log.replace(landmarks=np.full(len(log.steps), UNIDENTIFIED))
    for front_end, warned in (("fastslam2", True), ("auto", False)):
        comparison = run(hidden, estimators=["graph", "gtsam"], front_end=front_end)
        found = [finding.message for finding in comparison.findings if finding.check == "unreliable ids"]
        # one start tells nothing; it is said once, for both estimators
        assert len(found) == warned and all("do not rely on the map without a check" in each for each in found)
        assert not [note for note in comparison["graph"].notes if "do not rely" in note]


@pytest.mark.slow
@pytest.mark.parametrize("front_end", ["auto", "fastslam2", "batch", "best"])
def test_ignored_ids_are_compared_with_those_found(log, front_end):
    comparison = run(log, estimators="graph", association="maximum-likelihood", front_end=front_end)
    row = comparison.table["graph"]
    assert (row.association.precision, row.association.recall, row.association.found) == (1.0, 1.0, 13)
    assert "1.000, 1.000" in str(comparison) and "13 0 0 0" in str(comparison)
    entry = json.loads(json.dumps(comparison.to_json()))["estimators"][0]["association"]
    matches, evidence, verdict = (entry.pop(name) for name in ("matches", "evidence", "verdict"))
    starts = {"auto": 2, "fastslam2": 1, "batch": 1, "best": 4}[front_end]
    assert (verdict["starts"], verdict["agreeing"], verdict["reliable"]) == (starts, starts, starts > 1)
    assert verdict["lead"] is None or verdict["lead"] > 40
    options = comparison["graph"].options
    assert (options["front_end"], options["front_particles"], options["class_confusion"]) == (front_end, 30, 0.05)
    assert entry == {
        "landmarks": 13, "clutter": 0, "precision": 1.0, "recall": 1.0, "found": 13, "missed": 0, "doubled": 0, "invented": 0,
        "classes": None, "unconfirmed": 0, "ambiguities": [],
    }  # fmt: skip
    assert any("of 4 starts the best by evidence" in note for note in comparison["graph"].notes) == (
        front_end == "best"
    )
    assert sorted(matches.values()) == log.landmark_ids.tolist() and np.isfinite(evidence)
    for j, true in matches.items():
        np.testing.assert_array_equal(comparison["graph"].association == int(j), log.landmarks == true)


@pytest.mark.slow
def test_classes_and_matches_are_in_tables_files_and_film(log):
    names = np.array(["big, [red]", "green", "blue", ""])
    shown = names[np.where(np.arange(len(log.steps)) % 10 == 0, 3, log.landmarks % 3)]
    clutter = np.append(log.landmarks[:-1], UNIDENTIFIED)
    with_classes = log.replace(landmarks=clutter, classes=shown)
    comparison = run(with_classes, estimators=["graph", "fastslam1"], association="maximum-likelihood", particles=30)
    entry = comparison.to_json()["estimators"][0]["association"]
    assert all(entry["classes"][j] == names[true % 3] for j, true in entry["matches"].items())
    assert comparison.to_json()["log"]["classes"]["green"] == int(np.sum(shown == "green"))
    column = association_table(comparison, comparison["graph"]).columns[-4]
    assert "class" in str(column.header) and names[0] in [each.plain for each in column.cells]
    assert landmark_table(comparison).columns[1].header.plain == "class"
    # the last sighting has no true id
    assert "Sightings without a true id count as clutter." in str(comparison)
    for name, text in texts(comparison):
        if name == "graph-sightings.csv":
            rows = list(csv.reader(text().splitlines()))
    assert rows[0] == ["step", "range", "bearing", "orientation", "class", "landmark", "status", "true_id"]
    assert len(rows) == len(log.steps) + 1 and rows[-1][-1] == "" and rows[1][-1] == str(log.landmarks[0])
    assert [row[4] for row in rows[1:]] == shown.tolist()
    found = comparison["graph"].association
    assert [row[5] for row in rows[1:]] == ["" if j == UNIDENTIFIED else str(j) for j in found]
    with pytest.raises(OptionError, match="^class_confusion must lie between 0 and 1, not 2.0"):
        run(with_classes, estimators="graph", association="maximum-likelihood", class_confusion=2.0)
    assert {row[6] for row in rows[1:]} <= {"confirmed", "unconfirmed", "clutter"}
    film = animate(with_classes, estimator="association", association="maximum-likelihood", max_frames=5)
    for frame in film.frames:
        at = np.flatnonzero(log.steps == frame.number)
        assert len(frame.lines) == len(frame.values) == len(at)
        for k, (begin, end) in zip(at, frame.lines):
            np.testing.assert_array_equal(begin, frame.poses[-1, :2])
            if found[k] != UNIDENTIFIED:
                np.testing.assert_allclose(end, comparison["graph"].landmarks[found[k]][:2], atol=1e-6)
    # drawn, and different where the robot is elsewhere
    assert np.any(film.pictures[0] != film.pictures[-1])
    assert "the ids of the log are not used" in film.notes


def test_a_filter_gives_the_association_of_each_sighting(log):
    result = FastSLAM2(log, particles=50, seed=0, association="maximum-likelihood").run()
    assert result.association.shape == result.unconfirmed.shape == log.steps.shape
    assert score(result.association, log.landmarks).precision > 0.95
    assert set(result.association[~result.unconfirmed]) - {UNIDENTIFIED} == set(result.landmarks)
    assert FastSLAM2(log, particles=50, seed=0).run().association is None


@pytest.mark.slow
def test_filters_find_the_landmarks_of_a_log_without_ids(log):
    """By default, and they say so; localisation, which needs ids, is left out with advice."""
    hidden = log.replace(landmarks=np.full(len(log.steps), UNIDENTIFIED))
    comparison = run(hidden, particles=30, estimators=["fastslam1", "fastslam2"])
    for name in ("fastslam1", "fastslam2"):
        result = comparison[name]
        assert not result.named and result.options["association"] == "maximum-likelihood"
        assert result.notes[0] == "the sightings have no ids: maximum-likelihood association finds the landmarks"
        assert result.association.shape == log.steps.shape
    for name in ("mcl", "particle-gibbs"):
        with pytest.raises(OptionError, match=r"without ids, .* FastSLAM, .* fastslam.associate"):
            run(hidden, estimators=name)
    with pytest.raises(OptionError, match="the association is known: leave it out"):
        run(hidden, estimators="fastslam2", association="known")
    with pytest.raises(OptionError, match="smoothing 50 needs the association known, so ids of all sightings"):
        run(hidden, estimators="fastslam2", smoothing=50)
    assert run(log, particles=30, estimators="fastslam2")["fastslam2"].named


def test_graphs_find_ids_with_options_that_fastslam_has_with_known_ids_only(log):
    hidden = log.replace(landmarks=np.full(len(log.steps), UNIDENTIFIED))
    for bare, ways in ((hidden, {}), (log, {"association": "maximum-likelihood"})):
        outcome = run(bare, estimators=["graph", "fastslam2"], range_noise="estimated", smoothing=50, **ways)
        assert outcome["graph"].options["range_noise"] == "estimated"
        (left_out,) = outcome.skipped
        assert left_out.reason.endswith("leave out range_noise and smoothing")


def test_all_clutter_is_refused(log):
    rng = np.random.default_rng(0)
    steps = np.arange(8) * 20
    far = np.column_stack([np.linspace(1, 6, 8), rng.uniform(-3, 3, 8), rng.uniform(-3, 3, 8)])
    clutter = log.replace(steps=steps, landmarks=np.full(8, UNIDENTIFIED), sightings=far)
    with pytest.raises(GraphError, match="may be clutter"):
        run(clutter, estimators="graph")


def test_where_no_ids_can_be_found_the_filters_go_on(log):
    rng = np.random.default_rng(0)
    steps = np.arange(8) * 20
    far = np.column_stack([np.linspace(1, 6, 8), rng.uniform(-3, 3, 8), rng.uniform(-3, 3, 8)])
    clutter = log.replace(steps=steps, landmarks=np.full(8, UNIDENTIFIED), sightings=far)
    comparison = run(clutter, particles=30)
    assert {"dead-reckoning", "fastslam1", "fastslam2"} == {result.name for result in comparison.results}
    reasons = {entry.name: entry.reason for entry in comparison.skipped}
    assert all("all its 8 sightings may be clutter" in reasons[name] for name in ("graph", "gtsam"))
    with pytest.raises(GraphError, match="may be clutter"):
        run(clutter, estimate=["turn_scale"], estimators=["graph"])


@pytest.mark.slow
def test_whatever_uses_the_ids_all_the_same_says_so_and_has_no_association(log):
    log = log.at_steps(np.arange(40))
    comparison = run(
        log,
        estimators=["textbook", "graph", "online", "isam2"],
        association="maximum-likelihood",
        edges="virtual+motion",
    )
    used = "the ids of the log were used all the same"
    assert [r.name for r in comparison.results if used in r.notes] == ["textbook", "online", "isam2"]
    assert [r.name for r in comparison.results if r.association is not None] == ["graph"]
    # what cannot run on a log is not offered to whoever waits
    hidden = log.replace(landmarks=np.full(len(log.steps), UNIDENTIFIED))
    options = replace(comparison.options, estimate=("turn_scale",))
    assert [ESTIMATORS[name].too_slow(hidden, options) for name in ("textbook", "isam2")] == [None, None]


def test_ids_are_found_anew_with_other_options(log):
    given = {"estimators": "graph", "association": "maximum-likelihood"}
    first = run(log, **given)["graph"].found
    assert run(log, **given)["graph"].found is first
    assert run(log, **given, new_landmark_threshold=1e-3)["graph"].found is not first


@pytest.mark.slow
def test_ids_that_cannot_be_used_are_told(log):
    partly = log.replace(landmarks=np.where(np.arange(len(log.steps)) == 5, UNIDENTIFIED, log.landmarks))
    comparison = run(partly, estimators=["graph", "fastslam2"], particles=30)
    kept = comparison["graph"].notes
    assert "282 of 283 sightings kept the ids that they have" in kept and not any("not use" in note for note in kept)
    assert np.sum(comparison["graph"].association != log.landmarks) <= 1
    assert comparison.associations["graph"] is None and comparison.associations["fastslam2"] is not None
    note = "1 of 283 sightings has no id, so filters do not use the ids of the others either"
    assert comparison["fastslam2"].notes[0].startswith(note)
    asked = run(partly, estimators="graph", association="maximum-likelihood")
    assert not any("not used" in note for note in asked["graph"].notes)
