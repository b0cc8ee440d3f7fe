import numpy as np
import pytest

from graphslam import Graph, GraphError, Log, MotionModel, OptionError, SensorModel, load, simulate, solve
from graphslam.metrics import mean_nees


def log_of(sightings, poses=4, psi=True, controls=True):
    """A log from (step, landmark) pairs, everything else unremarkable."""
    rng = np.random.default_rng(0)
    return Log(
        dt=1.0 if controls else None,
        controls=np.tile([0.5, 0.1], (poses - 1, 1)) if controls else None,
        initial_poses=None if controls else np.zeros((poses, 3)),
        steps=[s for s, _ in sightings],
        landmarks=[j for _, j in sightings],
        sightings=rng.uniform(0.5, 2.0, (len(sightings), 3 if psi else 2)),
        name="test",
    )


def test_the_books_numbers_of_edges(book_log, shared_data):
    graph = Graph.from_log(book_log, edges="virtual+motion", kernel="none")
    assert [family.count for family in graph.families] == [1, 807, 61]
    assert graph.num_edges == 868
    assert Graph.from_log(load(shared_data("lnpr/log_for_book.txt")), edges="virtual", kernel="none").num_edges == 700


def test_repr_is_one_line_with_the_counts(book_log):
    edges = "1 AnchorEdges, 807 VirtualMotionEdges, 61 RelativePoseEdges"
    for kernel, shown in {"none": "", "cauchy": "; kernel cauchy"}.items():
        graph = Graph.from_log(book_log, edges="virtual+motion", kernel=kernel)
        assert repr(graph) == f"<Graph: 62 poses, 0 landmarks; {edges}{shown}>"


def test_poses_without_sightings_leave_the_graph_but_keep_their_numbers():
    graph = Graph.from_log(log_of([(0, 1), (1, 1), (3, 1)]), edges="virtual", kernel="none", noise="book")
    assert graph.steps.tolist() == [0, 1, 3]
    assert tuple(note for note in graph.notes if "weight pairs" not in note) == (
        "pose 2 shared no sighting with any other and stayed out of the graph",
    )
    assert Graph.from_log(log_of([(0, 1), (1, 1), (3, 1)]), edges="virtual+motion", kernel="none").steps.tolist() == [
        0,
        1,
        2,
        3,
    ]


def test_a_landmark_seen_once_is_named():
    log = log_of([(0, 1), (1, 1), (1, 5), (2, 9), (2, 9)])
    graph = Graph.from_log(log, edges="virtual+motion", kernel="none", noise="book")
    assert graph.notes == ("no edge comes from landmarks 5 and 9, seen in one step only",)
    assert graph.families[1].count == 1


def test_no_pair_within_one_step():
    assert (
        Graph.from_log(log_of([(0, 1), (0, 1), (1, 1)]), edges="virtual+motion", kernel="none").families[1].count == 2
    )


@pytest.mark.parametrize(
    ("log", "options", "message"),
    [
        (log_of([]), {}, "no sightings at all"),
        (log_of([]), {"edges": "virtual"}, "no sightings at all"),
        (log_of([(0, 1), (1, 2)]), {"edges": "virtual"}, "no landmark that was seen twice"),
        (
            log_of([(0, 1), (1, 1)], controls=False),
            {"edges": "virtual+motion"},
            "no controls for motion edges; use edges='virtual'",
        ),
        (
            log_of([(0, 1), (1, 1), (2, 2), (3, 2)]),
            {"edges": "virtual"},
            "several pieces: nothing ties poses 2 and 3 to pose 0; use edges='virtual\\+motion'",
        ),
        (
            log_of([(0, 1), (1, 1), (1, 2), (2, 2)], psi=False),
            {"edges": "virtual"},
            "without psi one landmark does not fix a pose: poses 0 and 2 share only one",
        ),
        (log_of([(0, 1), (1, 1)], psi=False), {"dimensions": 3}, "sightings without psi, but 3-D sensor values"),
    ],
)
def test_what_cannot_be_solved_is_refused_with_the_way_out(log, options, message):
    with pytest.raises(GraphError, match=message):
        Graph.from_log(log, **options)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"edges": "motion"}, "edges must be one of virtual, virtual\\+motion"),
        ({"log": "sample.npz"}, "log must be a Log, not 'sample.npz'; .*load"),
        ({"frame": "robot"}, "frame must be one of"),
        ({"weight": "all"}, "weight must be one of"),
        ({"motion_weight": 0.0}, "motion_weight must be a positive number"),
        ({"motion_weight": float("nan")}, "motion_weight must be a finite number"),
        ({"dimensions": 4}, "dimensions must be 2 or 3"),
    ],
)
def test_impossible_options(book_log, options, message):
    with pytest.raises(OptionError, match=message):
        Graph.from_log(**({"log": book_log} | options))


def test_tempered_pairs_weigh_two_over_k():
    log = log_of([(0, 1), (0, 2), (1, 1), (2, 1), (3, 1), (3, 2)])
    pairs, tempered = (
        Graph.from_log(log, weight=weight, edges="virtual+motion", kernel="none") for weight in ("pairs", "tempered")
    )
    np.testing.assert_allclose(tempered.families[1].group_weights, [0.5, 1.0])
    state = np.random.default_rng(1).normal(size=(4, 3))
    group = pairs.families[1].pairs()[2]
    expected = pairs.families[1].linearize(state, state).mahalanobis @ np.array([0.5, 1.0])[group]
    assert tempered.families[1].cost(state, state) == pytest.approx(expected)


@pytest.mark.parametrize("psi", [True, False])
def test_body_frame_costs_do_not_change_with_the_world(psi):
    log = simulate(seed=2, orientation=psi)
    graph = Graph.from_log(log, edges="virtual+motion", kernel="none")
    rng = np.random.default_rng(3)
    state = graph.initial + rng.normal(size=graph.initial.shape) * 0.3
    turn = 2.0
    c, s = np.cos(turn), np.sin(turn)
    moved = state @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + [5.0, -3.0, turn]
    for family in graph.families[1:]:
        assert family.cost(moved, moved) == pytest.approx(family.cost(state, state), rel=1e-10)


def test_a_weight_without_effect_is_a_note():
    log = simulate(steps=10)
    graph = Graph.from_log(log, edges="landmark+motion", weight="marginal", kernel="none")
    assert any("'marginal' has no effect" in note for note in graph.notes)
    assert not any("no effect" in note for note in Graph.from_log(log, edges="landmark+motion", kernel="none").notes)


@pytest.mark.parametrize(
    ("edges", "option", "value", "effect"),
    [
        ("virtual+motion", "residual", "polar", False),
        ("landmark+motion", "residual", "polar", True),
        ("virtual", "motion_weight", 10.0, False),
        ("virtual+motion", "motion_weight", 10.0, True),
    ],
)
def test_an_option_without_effect_is_a_note(edges, option, value, effect):
    graph = Graph.from_log(simulate(steps=10), edges=edges, kernel="none", **{option: value})
    assert any(f"{option}=" in note and "no effect" in note for note in graph.notes) == (not effect)


@pytest.mark.parametrize(("bearing_std", "said"), [(0.1, True), (0.03, False)])
def test_bearings_that_are_much_less_exact_than_ranges(bearing_std, said):
    """Covariances of the Cartesian residual are then too small; those of the polar one are right."""
    models = {
        "motion": MotionModel(nn=0.05, no=0.001, on=0.02, oo=0.05, epsilon=1e-6),
        "sensor": SensorModel(range_rate=0.0, range_std=0.05, bearing_std=bearing_std),
    }
    world = {"steps": 60, "clean": True, "orientation": False, "max_range": 12.0, "arena": 20.0, "landmarks": 30}
    nees = {"cartesian": [], "polar": []}
    for seed in range(6):
        log = simulate(seed=seed, **world, **models).replace(**models)
        for residual, found in nees.items():
            solution = solve(Graph.from_log(log, edges="landmark+motion", residual=residual))
            found.append(mean_nees(log.true_poses, solution.poses, solution.covariance()))
            noted = any("residual polar does not" in note for note in solution.graph.notes)
            assert noted == (said and residual == "cartesian")
    assert np.mean(nees["polar"]) < 1.3
    assert (np.mean(nees["cartesian"]) > 1.4) == said


def test_arrays_of_graphs_and_solutions_are_read_only(book_log):
    """Both keep what they computed from their arrays, so that a change from outside would make them contradict each other."""
    graph = Graph.from_log(book_log, edges="landmark+motion")
    solution = solve(graph)
    arrays = {
        name: getattr(graph, name) for name in ("initial", "steps", "trajectory", "pose_ids", "landmark_ids", "fixed")
    }
    arrays |= {name: getattr(solution, name) for name in ("poses", "estimated", "costs", "step_norms", "state")}
    arrays |= {f"landmark {j}": place for j, place in solution.landmarks.items()}
    for name, array in arrays.items():
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0
        assert not array.flags.writeable, name


def test_noise_models_that_are_given_choose_the_edges_like_those_of_the_log():
    # with the lectures' edges each of K sightings of a landmark would count up to K/2 times
    log, book = simulate(seed=1, steps=40).replace(simulated=False), {"motion": MotionModel(), "sensor": SensorModel()}
    for models in ({"motion": MotionModel(nn=0.1)}, {"sensor": SensorModel(range_rate=0.1)}):
        given, of_log = Graph.from_log(log, **{**book, **models}), Graph.from_log(log.replace(**{**book, **models}))
        assert repr(given) == repr(of_log) and len(given.landmark_ids) > 0
    assert len(Graph.from_log(log, **book).landmark_ids) == 0
