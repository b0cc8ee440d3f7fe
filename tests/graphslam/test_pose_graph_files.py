import re
import warnings
from dataclasses import replace

import numpy as np
import pytest

from graphslam import (
    FormatError,
    Graph,
    GraphError,
    Log,
    OptionError,
    sample_log_path,
    simulate,
    solve,
    solve_with_gtsam,
)
from graphslam.edges import AnchorEdges, PositionEdges, RelativePoseEdges
from graphslam.graph.pose_graph import read_pose_graph
from graphslam.io import read
from graphslam.se2 import between, compose, turn_matrix, wrap

SQUARE = """VERTEX_SE2 0 0 0 0
VERTEX_SE2 1 1 0 1.5
VERTEX_SE2 2 1 1 3.0
VERTEX_XY 9 2 2
EDGE_SE2 0 1 1 0 1.57 10 1 0.5 20 0.2 30
EDGE_SE2 1 2 1 0 1.57 10 0 0 10 0 10
EDGE_SE2 2 0 1 1 3.1 10 0 0 10 0 10
EDGE_SE2_XY 0 9 2 2 5 0 5
EDGE_SE2_XY 2 9 -1 -1 5 1 5
"""
BEST = {
    "posegraph/input_INTEL_g2o.g2o": 215.830235,
    "posegraph/input_M3500_g2o.g2o": 137.912951,
    "posegraph/CSAIL.g2o": 40.555129,
    "posegraph/city10000.g2o": 511.985164,
}


def written(tmp_path, text):
    path = tmp_path / "graph.g2o"
    path.write_text(text)
    return path


def g2o_chi2(path, poses):
    """e' Omega e with g2o's e = z^-1 (x_i^-1 x_j), line by line from the file."""
    total = 0.0
    for line in path.read_text().splitlines():
        words = line.split()
        if words[0] == "EDGE_SE2":
            i, j = int(words[1]), int(words[2])
            z, entries = np.array(words[3:6], dtype=float), np.array(words[6:], dtype=float)
            omega = np.zeros((3, 3))
            omega[np.triu_indices(3)] = entries
            omega = omega + np.triu(omega, 1).T
            e = between(z, between(poses[i], poses[j]))
            total += e @ omega @ e
    return total


def test_read_gives_a_log_or_a_graph_by_the_content_of_the_file(tmp_path):
    path = written(tmp_path, SQUARE).rename(tmp_path / "square.txt")
    graph = read(path)
    assert isinstance(graph, Graph) and np.array_equal(graph.initial, Graph.from_g2o(path).initial)
    assert isinstance(read(sample_log_path()), Log)
    with pytest.raises(OptionError, match="keep_every does not apply to pose graphs"):
        read(path, keep_every=1.0)


def test_cost_is_g2os_chi2(tmp_path, shared_data):
    path = shared_data("posegraph/input_M3500_g2o.g2o")
    graph = Graph.from_g2o(path)
    rng = np.random.default_rng(0)
    for scale in (0.0, 1.0):
        state = graph.initial + scale * rng.normal(size=graph.initial.shape)
        assert graph.cost(state) == pytest.approx(g2o_chi2(path, state), rel=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("start", ["as given", "random", "nothing"])
@pytest.mark.parametrize("name", BEST)
def test_auto_reaches_the_best_known_cost_from_any_values(shared_data, name, start):
    graph = Graph.from_g2o(shared_data(name))
    initial = graph.initial.copy()
    if start == "random":
        initial = np.random.default_rng(1).normal(size=initial.shape) * [30, 30, 3]
    elif start == "nothing":
        initial = np.zeros_like(initial)
    initial[graph.fixed] = graph.initial[graph.fixed]
    solution = solve(graph.with_initial(initial), initialize="auto")
    assert solution.converged
    assert solution.cost == pytest.approx(BEST[name], rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("name", BEST)
def test_undamped_gauss_newton_from_the_given_values(shared_data, name):
    solution = solve(Graph.from_g2o(shared_data(name)), initialize="given")
    assert solution.converged
    assert solution.cost == pytest.approx(BEST[name], rel=1e-6)


def test_what_a_file_says(tmp_path):
    graph = Graph.from_g2o(written(tmp_path, SQUARE))
    assert graph.num_nodes == 4
    assert graph.num_edges == 5
    assert graph.pose_ids.tolist() == [0, 1, 2]
    assert graph.landmark_ids.tolist() == [9]
    assert graph.fixed.tolist() == [0]
    solution = solve(graph)
    assert solution.converged
    assert set(solution.landmarks) == {9}


def test_fixed_nodes_stay_where_they_are(tmp_path):
    graph = Graph.from_g2o(written(tmp_path, SQUARE + "FIX 1 2\n"))
    assert graph.fixed.tolist() == [1, 2]
    for initialize in ("given", "rotation-first", "auto"):
        solution = solve(graph, initialize=initialize)
        np.testing.assert_array_equal(solution.poses[1:, :2], graph.initial[1:3, :2])
        np.testing.assert_allclose(wrap(solution.poses[1:, 2] - graph.initial[1:3, 2]), 0, atol=1e-15)
    np.testing.assert_array_equal(solution.covariance(1), 0)
    assert np.all(np.linalg.eigvalsh(solution.covariance(0)) > 0)


def test_round_trip(tmp_path):
    graph = Graph.from_g2o(written(tmp_path, SQUARE + "FIX 2\n"))
    graph.save_g2o(tmp_path / "again.g2o")
    again = Graph.from_g2o(tmp_path / "again.g2o")
    np.testing.assert_array_equal(again.initial, graph.initial)
    assert again.fixed.tolist() == [2]
    state = np.random.default_rng(0).normal(size=graph.initial.shape)
    assert again.cost(state) == pytest.approx(graph.cost(state), rel=1e-12)
    for one, two in zip(graph.families, again.families):
        np.testing.assert_array_equal(one.measured, two.measured)
        np.testing.assert_allclose(one.information, two.information, rtol=1e-14, atol=1e-13)


def test_motion_graphs_can_be_written_and_virtual_ones_cannot(tmp_path, book_log):
    from dataclasses import replace

    graph = Graph.from_log(book_log, edges="virtual+motion", kernel="none")
    with pytest.raises(GraphError, match="g2o has no line for VirtualMotionEdges"):
        graph.save_g2o(tmp_path / "no.g2o")
    assert list(tmp_path.iterdir()) == []
    only_motion = replace(graph, families=(graph.families[0], graph.families[2]))
    only_motion.save_g2o(tmp_path / "yes.g2o")
    again = Graph.from_g2o(tmp_path / "yes.g2o")
    state = graph.initial + np.random.default_rng(0).normal(size=graph.initial.shape)
    expected = graph.families[2].cost(state, state)
    assert again.cost(state) == pytest.approx(expected, rel=1e-10)


def test_soft_anchors_are_written_as_measurements(tmp_path):
    graph = Graph.from_log(
        simulate(seed=1, steps=10, clean=True, orientation=False), edges="landmark+motion", kernel="none"
    )
    soft = AnchorEdges(np.array([4, 9]), graph.initial[[4, 9]] + 0.2, np.tile(np.diag([4.0, 9.0, 25.0]), (2, 1, 1)))
    tied = replace(graph, families=(*(f for f in graph.families if not isinstance(f, AnchorEdges)), soft))
    solution = solve(tied)
    tied.with_initial(solution.state).save_g2o(tmp_path / "soft.g2o")
    assert solve(Graph.from_g2o(tmp_path / "soft.g2o")).cost == pytest.approx(solution.cost, rel=1e-9)
    assert solution.cost > 0.01


def test_the_three_dialects_say_the_same(tmp_path):
    """One graph, its information written in each dialect's order and axes, or by its square root."""
    omega = np.array([[10.0, 1.0, 0.5], [1.0, 20.0, 0.2], [0.5, 0.2, 30.0]])
    root = np.linalg.cholesky(omega).T
    upper = np.triu_indices(3)

    def numbers(values):
        return " ".join(map(repr, np.asarray(values).tolist()))

    vertices = "VERTEX2 0 0 0 0\nVERTEX2 1 1 0 1.5\n"
    turn = turn_matrix(1.4)
    g2o = vertices.replace("VERTEX2", "VERTEX_SE2")
    g2o += f"EDGE_SE2 0 1 1 0.1 1.4 {numbers((turn.T @ omega @ turn)[upper])}\n"
    toro_order = [omega[0, 0], omega[0, 1], omega[1, 1], omega[2, 2], omega[0, 2], omega[1, 2]]
    toro = vertices + f"EDGE2 0 1 1 0.1 1.4 {numbers(toro_order)}\n"
    isam = f"EDGE2 0 1 1 0.1 1.4 {numbers(root[upper])}\n"
    graphs = [Graph.from_g2o(written(tmp_path, text)) for text in (g2o, toro, isam)]
    for graph in graphs[1:]:
        np.testing.assert_allclose(graph.families[0].information, graphs[0].families[0].information, rtol=1e-13)
    # the rule: EDGE2 is TORO's beside VERTEX2; an explicit format overrules it
    as_isam = Graph.from_g2o(written(tmp_path, toro), format="isam")
    assert not np.allclose(as_isam.families[0].information, graphs[0].families[0].information)


@pytest.mark.slow
def test_files_without_vertices_follow_their_odometry(shared_data, tmp_path):
    odometry = ["0 1 1 0 1", "1 3 1 0 1", "0 3 9 9 9"]
    lines = [f"ODOMETRY {edge} 1 0 0 1 0 1" for edge in odometry]
    text = "\n".join([*lines[:1], "LANDMARK 1 7 2 0 1 0 1", *lines[1:]]) + "\n"
    graph = Graph.from_g2o(written(tmp_path, text))
    c, s = np.cos(1), np.sin(1)
    np.testing.assert_allclose(graph.initial[:3], [[0, 0, 0], [1, 0, 1], [1 + c, s, 2]], atol=1e-15)
    np.testing.assert_allclose(graph.initial[3, :2], [1 + 2 * c, 2 * s], atol=1e-15)
    trees = Graph.from_g2o(shared_data("posegraph/cityTrees10000.txt"))
    assert (len(trees.pose_ids), len(trees.landmark_ids)) == (10000, 100)
    park = Graph.from_g2o(shared_data("victoria_park/victoriaPark_isam.txt"))
    assert (len(park.pose_ids), len(park.landmark_ids)) == (6969, 151)


def test_an_angle_of_a_billion(tmp_path):
    path = written(tmp_path, SQUARE.replace("VERTEX_SE2 1 1 0 1.5", "VERTEX_SE2 1 1 0 1e9"))
    graph = Graph.from_g2o(path)
    assert -np.pi <= graph.initial[1, 2] < np.pi
    assert solve(graph).cost == pytest.approx(solve(Graph.from_g2o(written(tmp_path, SQUARE))).cost, rel=1e-9)


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        (SQUARE + "EDGE_SE3 1 2 3\n", 10, "'EDGE_SE3' is of a graph in space"),
        (SQUARE + "EDGE_S", 10, "unknown tag 'EDGE_S'.*; the file ends within this line; perhaps it was not copied"),
        (SQUARE + "EDGE_SE2 1 2 0.5", 10, "12 columns, found 4; the file ends within this line"),
        (SQUARE + "EDGE_SE2 0 7 1 0 0 1 0 0 1 0 1\n", 10, "uses pose 7, which no vertex line gives"),
        (SQUARE + "EDGE_SE2_XY 0 8 1 0 1 0 1\n", 10, "uses landmark 8, which no vertex line gives"),
        (SQUARE + "VERTEX_SE2 1 0 0 0\n", 10, "vertex 1 is given a second time"),
        (SQUARE + "VERTEX_XY 1 0 0\n", 10, "vertex 1 is given a second time"),
        (SQUARE + "EDGE_SE2 1 1 0 0 0 1 0 0 1 0 1\n", 10, "from node 1 to itself"),
        (SQUARE + "EDGE_SE2 0 1 0 0 0 1 0 0 -1 0 1\n", 10, "not positive semi-definite"),
        (SQUARE + "EDGE_SE2 0 1 0 0 0 1 5 0 1 0 1\n", 10, "not positive semi-definite"),
        (SQUARE + "EDGE_SE2 0 1 0 0 nan 1 0 0 1 0 1\n", 10, "an entry is nan; only finite numbers"),
        (SQUARE + "EDGE_SE2 0 1 0 0 x 1 0 0 1 0 1\n", 10, "an entry should be a number, not 'x'"),
        (SQUARE + "EDGE_SE2 0 1 0 0 0 1 0 0 1 0\n", 10, "12 columns, found 11"),
        (SQUARE + "EDGE_SE2 0 1.5 0 0 0 1 0 0 1 0 1\n", 10, "should be a whole number, not '1.5'"),
        (SQUARE + "FIX 5\n", 10, "FIX names node 5"),
        ("VERTEX_SE2 0 0 0 0\n", None, "no edges"),
        ("", None, "no edges"),
        ("EDGE2 0 1 1 0 0 1 0 0 1 0 1\nEDGE2 5 6 1 0 0 1 0 0 1 0 1\n", 2, "falls into pieces"),
    ],
)
def test_damaged_files_name_the_line(tmp_path, text, line, message):
    with pytest.raises(FormatError, match=message) as caught:
        Graph.from_g2o(written(tmp_path, text))
    assert caught.value.line == line


def test_pieces_are_named(tmp_path):
    text = SQUARE + "VERTEX_SE2 5 0 0 0\nVERTEX_SE2 6 0 0 0\nEDGE_SE2 5 6 1 0 0 1 0 0 1 0 1\n"
    with pytest.raises(GraphError, match="several pieces: nothing ties poses 5 and 6 to pose 0"):
        Graph.from_g2o(written(tmp_path, text))
    assert solve(Graph.from_g2o(written(tmp_path, text + "FIX 0 5\n"))).converged


def test_unknown_tags_are_counted_on_request(tmp_path):
    path = written(tmp_path, SQUARE + "ROBOT 1\nROBOT 2\nCOLOUR red\n")
    with pytest.warns(UserWarning, match="2 x ROBOT, 1 x COLOUR"):
        graph = Graph.from_g2o(path, unknown="skip")
    assert graph.num_edges == 5
    with pytest.raises(OptionError, match="format must be one of"):
        read_pose_graph(path, "rosbag")


def test_information_of_rank_two_is_allowed(tmp_path):
    text = SQUARE.replace("1 2 1 0 1.57 10 0 0 10 0 10", "1 2 1 0 1.57 10 0 0 10 0 0")
    assert solve(Graph.from_g2o(written(tmp_path, text))).converged


# -- dialects side by side, and what cannot be told apart -------------------------------------------------------------


def test_every_tag_means_what_its_own_dialect_says(tmp_path):
    """A file with g2o's and iSAM's edges: plain information for the one, square roots for the other."""
    text = (
        "EDGE_SE2 0 1 1 0 0 4 0 0 4 0 4\n"
        "ODOMETRY 1 2 1 0 0 4 0 0 4 0 4\n"
        "LANDMARK 2 9 1 1 3 0 3\n"
        "EDGE_SE2_XY 1 9 2 1 3 0 3\n"
    )  # fmt: skip
    for named in (None, "g2o", "toro", "isam"):
        data = read_pose_graph(written(tmp_path, text), named)
        np.testing.assert_allclose(data.edges["pose"].information[0], 4 * np.eye(3))
        np.testing.assert_allclose(data.edges["pose"].information[1], 16 * np.eye(3))
        np.testing.assert_allclose(data.edges["point"].information, [9 * np.eye(2), 3 * np.eye(2)])
    entries = "EDGE_SE2 0 1 1 0 0 10 1 2 20 3 30\n"
    np.testing.assert_allclose(
        read_pose_graph(written(tmp_path, entries), "toro").edges["pose"].information,
        [[[10, 1, 2], [1, 20, 3], [2, 3, 30]]],
    )


def test_an_edge2_that_could_be_either_is_refused(tmp_path):
    text = "VERTEX2 0 0 0 0\nVERTEX2 1 1 0 0\nEDGE2 0 1 1 0 0 1 0 1 1 0 0\nODOMETRY 0 1 1 0 0 1 0 0 1 0 1\n"
    with pytest.raises(FormatError, match="name the format"):
        read_pose_graph(written(tmp_path, text))
    assert len(read_pose_graph(written(tmp_path, text), "toro").edges["pose"].ids) == 2


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("EDGE_SE2 0 9223372036854775808 1 0 0 1 0 0 1 0 1", r":4: .*64 bits"),
        ("EDGE_SE2 0 1_0 1 0 0 1 0 0 1 0 1", ":4: "),
        ("EDGE_SE2 0 1 1_0 0 0 1 0 0 1 0 1", ":4: an entry should be a number"),
        ("ODOMETRY 0 1 1 0 0 1e200 0 0 1 0 1", ":4: .*overflows"),
        ("FIX", ":4: expected 'FIX id"),
    ],
)
def test_numbers_out_of_range_are_named(tmp_path, line, message):
    text = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n" + line + "\n"
    with pytest.raises(FormatError, match=message):
        read_pose_graph(written(tmp_path, text))


def test_a_byte_order_mark_and_windows_line_ends_are_no_tags(tmp_path):
    path = tmp_path / "graph.g2o"
    path.write_bytes(b"\xef\xbb\xbf" + SQUARE.replace("\n", "\r\n").encode())
    np.testing.assert_array_equal(Graph.from_g2o(path).initial, Graph.from_g2o(written(tmp_path, SQUARE)).initial)


def test_landmarks_with_the_numbers_of_poses_are_written_under_new_ones(tmp_path):
    text = "ODOMETRY 0 1 1 0 0 1 0 0 1 0 1\nLANDMARK 0 0 1 1 1 0 1\nLANDMARK 1 0 0 1 1 0 1\nLANDMARK 1 5 2 0 1 0 1\n"
    graph = Graph.from_g2o(written(tmp_path, text))
    graph.save_g2o(tmp_path / "again.g2o")
    again = Graph.from_g2o(tmp_path / "again.g2o")
    assert again.landmark_ids.tolist() == [2, 3]
    np.testing.assert_array_equal(again.initial, graph.initial)
    assert again.cost(again.initial + 0.1) == pytest.approx(graph.cost(graph.initial + 0.1))


def test_a_state_that_is_none_is_not_written(tmp_path):
    graph = Graph.from_g2o(written(tmp_path, SQUARE))
    for state in (graph.initial[:-1], np.full_like(graph.initial, np.nan)):
        with pytest.raises(OptionError, match="state must be"):
            graph.save_g2o(tmp_path / "bad.g2o", state=state)
    assert not (tmp_path / "bad.g2o").exists()


def simulated_edges(dialect, deviations, rng):
    """A file of 160 poses with random turns, 159 odometry edges and 162 others whose noise is drawn in the first pose's axes.

    The deviations [m, m, rad] are those along the axes of the first pose; g2o's information is turned by the heading.
    """
    poses = [np.zeros(3)]
    while len(poses) < 160:
        poses.append(compose(poses[-1], np.array([1.0, 0.0, rng.uniform(-2.5, 2.5)])))
    pairs = [(k, k + 1) for k in range(159)]
    pairs += [tuple(sorted(rng.choice(160, 2, replace=False))) for _ in range(162)]
    lines = [f"{'VERTEX2' if dialect == 'toro' else 'VERTEX_SE2'} {k} {x!r} {y!r} {t!r}"
             for k, (x, y, t) in enumerate(np.array(poses).tolist()) if dialect != "isam"]  # fmt: skip
    for i, j in pairs:
        z = between(poses[i], poses[j]) + rng.normal(size=3) * deviations
        omega = np.diag(np.array(deviations) ** -2.0)
        if dialect == "g2o":
            turn = turn_matrix(z[2])
            omega = turn.T @ omega @ turn
        elif dialect == "isam":
            omega = np.linalg.cholesky(omega).T
        order = [0, 1, 3, 5, 2, 4] if dialect == "toro" else range(6)
        entries = omega[np.triu_indices(3)][list(order)]
        tag = "EDGE_SE2" if dialect == "g2o" else "EDGE2"
        lines.append(f"{tag} {i} {j} {' '.join(map(repr, [*z.tolist(), *entries.tolist()]))}")
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("dialect", ["g2o", "toro", "isam"])
def test_information_is_taken_in_the_axes_of_its_dialect(tmp_path, dialect):
    """321 edges with 0.15 m along and 0.02 m across the first pose: J is chi-square with 3 * (321 - 159) degrees."""
    text = simulated_edges(dialect, (0.15, 0.02, 0.01), np.random.default_rng(0))
    solution = solve(Graph.from_g2o(written(tmp_path, text)))
    assert solution.converged
    degrees = 3 * (321 - 159)
    assert abs(solution.cost / degrees - 1) < 3.3 * (2 / degrees) ** 0.5


@pytest.mark.slow
def test_the_public_isam_files_have_their_costs(shared_data):
    """cityTrees10000 has equal deviations in x and y, and chi2 per degree of freedom near 1; Victoria Park does not."""
    trees = Graph.from_g2o(shared_data("posegraph/cityTrees10000.txt"))
    np.testing.assert_allclose(trees.families[0].information, np.broadcast_to(np.diag([2500, 2500, 1e4]), (9999, 3, 3)))
    degrees = 3 * 9999 + 2 * 4443 - 3 * 9999 - 2 * 100
    assert solve(trees).cost / degrees == pytest.approx(1, abs=3.3 * (2 / degrees) ** 0.5)
    park = Graph.from_g2o(shared_data("victoria_park/victoriaPark_isam.txt"))
    # along the first pose the deviation is 0.01 m, across it 0.002 m, whatever the robot turned
    np.testing.assert_allclose(
        park.families[0].information, np.broadcast_to(np.diag([1e4, 250_000, 250_000]), (6968, 3, 3)), atol=1e-6
    )


@pytest.mark.parametrize("dialect", ["g2o", "toro", "isam"])
def test_covariances_in_place_of_information_are_noticed(tmp_path, dialect):
    """The same file with the covariance of every edge: 1 / deviation instead of deviation swaps the two."""
    wrong = {"isam": (0.15**-2, 0.02**-2, 0.01**-2)}.get(dialect, (1 / 0.15, 1 / 0.02, 1 / 0.01))
    rng = np.random.default_rng(0)
    right = simulated_edges(dialect, (0.15, 0.02, 0.01), rng)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert Graph.from_g2o(written(tmp_path, right)).notes == ()
    numbers = iter(simulated_edges(dialect, wrong, np.random.default_rng(0)).splitlines())
    lines = [
        " ".join(line.split()[:6] + other.split()[6:]) if line.startswith("EDGE") else line
        for line, other in zip(right.splitlines(), numbers)
    ]
    with pytest.warns(UserWarning, match="seems to hold covariances") as caught:
        graph = Graph.from_g2o(written(tmp_path, "\n".join(lines) + "\n"))
    assert len(caught) == 1
    assert "seems to hold covariances" in graph.notes[0]
    assert ("square root" in graph.notes[0]) == (dialect == "isam")


def test_a_log_in_place_of_a_pose_graph():
    with pytest.raises(FormatError, match=r"sample.npz: this is an archive of NumPy.* graphslam.load reads it"):
        Graph.from_g2o(sample_log_path())


def chain(poses, turn=0.0, scale=1.0):
    """A closed square of poses, each at ``turn`` from the one before, its angles in units of 1 / ``scale`` rad."""
    edges = [(k, (k + 1) % poses) for k in range(poses)]
    return "\n".join(f"EDGE_SE2 {a} {b} 1 0 {scale * turn:.6f} 400 0 0 400 0 10000" for a, b in edges)


def test_angles_in_degrees_and_wrong_closures_are_said(tmp_path):
    right = solve(Graph.from_g2o(written(tmp_path, chain(12, np.pi / 6)), format="g2o"))
    assert not right.notes
    degrees = written(tmp_path, chain(12, np.pi / 6, 180 / np.pi))
    with pytest.warns(UserWarning, match=r"12 edges, the first one in line 1, turn by more than 2 pi \(30 rad\)"):
        graph = Graph.from_g2o(degrees, format="g2o")
    assert any("in degrees" in note for note in graph.notes)
    closed = written(tmp_path, chain(12, np.pi / 6) + "\nEDGE_SE2 2 8 0 0 0 400 0 0 400 0 10000")
    (note,) = solve(Graph.from_g2o(closed, format="g2o")).notes
    assert re.match(r"J is [\d,]+ times what the information of the edges predicts: edges are wrong", note)


def test_bearings_in_degrees_are_said(tmp_path):
    seen = "EDGE_BEARING_SE2_XY 0 9 45 400\nEDGE_BEARING_SE2_XY 1 9 90 400\n"
    with pytest.warns(UserWarning, match=r"2 edges, the first one in line 10, turn by more than 2 pi \(45 rad\)"):
        Graph.from_g2o(written(tmp_path, SQUARE + seen))


@pytest.mark.parametrize(("turn", "said"), [(2 * np.pi, False), (90, True)])
def test_headings_of_priors_may_count_turns(tmp_path, turn, said):
    priors = "".join(f"EDGE_PRIOR_SE2 {k} 0 0 {turn * (k + 1):.6f} 4 0 0 4 0 4\n" for k in range(2))
    with warnings.catch_warnings(record=True, action="always") as caught:
        Graph.from_g2o(written(tmp_path, SQUARE + priors))
    assert ["are angles in degrees" in str(each.message) for each in caught] == [True] * said


def test_priors_without_information_on_the_heading_leave_it_to_an_anchor(tmp_path):
    graph = Graph.from_g2o(written(tmp_path, SQUARE + "EDGE_PRIOR_SE2 0 0.1 0 0.3 4 0 0 4 0 0\n"))
    np.testing.assert_allclose(solve(graph).poses[0], [0.1, 0, 0], atol=1e-9)
    with pytest.raises(GraphError, match="the position of pose 0 has information without an inverse"):
        solve_with_gtsam(graph)


@pytest.mark.parametrize("fixed", [[], [2]])
def test_an_anchor_beside_others_is_no_fixed_node(tmp_path, fixed):
    """Written as FIX, J became 14.3 for 0.23."""
    poses, one = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0.0]]), np.eye(3)
    odometry = RelativePoseEdges(
        np.arange(2), np.arange(1, 3), np.tile([1.0, 0, 0], (2, 1)), np.tile(100 * one, (2, 1, 1))
    )
    soft = AnchorEdges(np.zeros(1, int), np.array([[0.0, 0.5, 0]]), one[None])
    places = PositionEdges(np.array([1]), np.array([[1, 0.3]]), 100 * np.eye(2)[None], np.zeros((1, 2)))
    graph = Graph(
        poses, families=(soft, odometry, *([] if fixed else [places])), steps=np.arange(3), trajectory=poses,
        pose_ids=np.arange(3), fixed=np.array(fixed, int),
    )  # fmt: skip
    graph.save_g2o(tmp_path / "again.g2o")
    again = Graph.from_g2o(tmp_path / "again.g2o")
    assert solve(again).cost == pytest.approx(solve(graph).cost, rel=1e-6)


def test_an_edge_that_stands_twice_is_said(tmp_path):
    closure = "\nEDGE_SE2 2 8 0 0 0 400 0 0 400 0 10000"
    path = written(tmp_path, chain(12, np.pi / 6) + closure + closure)
    (note,) = Graph.from_g2o(path, format="g2o").notes
    assert re.match(r"edges that repeat another one, .*: 1, the first one in line 14 \(as line 13\); both count", note)
    # another measurement between the same poses is none
    other = written(tmp_path, chain(12, np.pi / 6) + closure + closure.replace("2 8 0", "2 8 0.1"))
    assert not Graph.from_g2o(other, format="g2o").notes


@pytest.mark.parametrize("reads", [read, Graph.from_g2o])
def test_graphs_in_space_are_refused_as_such(tmp_path, reads):
    path = written(tmp_path, "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\n")
    with pytest.raises(FormatError, match="in space; the graphs of this project are in the plane"):
        reads(path)


def test_poses_that_files_hold_are_no_unknowns(tmp_path):
    rng, count = np.random.default_rng(0), 40
    lines = [f"VERTEX_SE2 {k} {k} 0 0" for k in range(count)] + [f"FIX {k}" for k in range(0, count, 2)]
    for k, (x, y, turn) in enumerate(0.1 * rng.standard_normal((count - 1, 3))):
        lines.append(f"EDGE_SE2 {k} {k + 1} {1 + x} {y} {turn} 100 0 0 100 0 100")
    path = tmp_path / "held.g2o"
    path.write_text("\n".join(lines))
    graph = Graph.from_g2o(path)
    assert graph.degrees_of_freedom == 3 * (count - 1) - 3 * count // 2
    solution = solve(graph)
    assert solution.cost < 2 * graph.expected_cost
    assert not any("J is" in note for note in solution.notes)
