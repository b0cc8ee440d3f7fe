"""A singular graph is refused with the names of what nothing holds, by both methods."""

import numpy as np
import pytest

from graphslam import Graph, GraphError, solve
from graphslam.edges import RelativePoseEdges


def chain(information, tmp_path, extra=""):
    lines = [f"VERTEX_SE2 {k} {k} 0 0" for k in range(5)]
    lines += [f"EDGE_SE2 {k} {k + 1} 1 0 0 {information[k]}" for k in range(4)]
    path = tmp_path / "graph.g2o"
    path.write_text("\n".join(lines) + "\n" + extra)
    return Graph.from_g2o(path)


FULL, NO_HEADING, NO_X = "1 0 0 1 0 1", "1 0 0 1 0 0", "0 0 0 1 0 1"


@pytest.mark.parametrize(
    ("information", "message"),
    [
        (
            [FULL, FULL, FULL, NO_HEADING],
            "do not determine pose 4: nothing holds its heading; the edges there are between poses 3 and 4",
        ),
        ([FULL, FULL, FULL, NO_X], "do not determine pose 4: nothing holds its x"),
        (
            [FULL, NO_X, FULL, FULL],
            "poses 2, 3 and 4: nothing holds the whole piece, which can shift; the edges there are between poses 1 and 2",
        ),
        (
            [FULL, NO_HEADING, FULL, FULL],
            "do not determine poses 2, 3 and 4: nothing holds the whole piece, which can turn",
        ),
    ],
)
def test_what_is_loose_is_named(tmp_path, information, message):
    with pytest.raises(GraphError, match=message):
        solve(chain(information, tmp_path))


def test_edges_of_one_node_are_at_it(tmp_path):
    with pytest.raises(GraphError, match="which can shift; the edges there are at pose 0; between poses 0 and 1;"):
        solve(chain([FULL] * 4, tmp_path, "EDGE_PRIOR_SE2_XY 0 0 0 4 0 0\n"))


def test_an_unseen_landmark_coordinate(tmp_path):
    extra = "VERTEX_XY 77 3 3\nEDGE_SE2_XY 4 77 1 1 1 0 0\n"
    with pytest.raises(GraphError, match="do not determine landmark 77: nothing holds its y"):
        solve(chain([FULL] * 4, tmp_path, extra))


def test_a_hinge_of_two_dimensional_sightings():
    """Two groups of poses that share one landmark only: the pattern looks fine, the second group turns about it."""
    from graphslam import Log, SensorModel

    rng = np.random.default_rng(0)
    places = {0: (5.0, 0.0), 1: (5.0, 3.0), 2: (9.0, 1.0), 3: (8.0, 6.0)}
    poses = np.array([[0, 0, 0.1], [1, 0.5, 0.3], [11, 5, 3.0], [12, 4, 2.8]])
    groups = [(0, (0, 1)), (1, (0, 1)), (2, (1, 2, 3)), (3, (1, 2, 3))]
    sensor = SensorModel()
    seen = [(t, j, sensor.h(poses[t], np.array(places[j]))) for t, ids in groups for j in ids]
    log = Log(
        initial_poses=poses + 0.0 * rng.normal(size=poses.shape),
        steps=[t for t, _, _ in seen],
        landmarks=[j for _, j, _ in seen],
        sightings=[z for _, _, z in seen],
    )
    with pytest.raises(GraphError, match="poses 2 and 3: nothing holds the whole piece, which can turn"):
        solve(Graph.from_log(log, edges="virtual", kernel="none"))
    # a log has rows, and no edges that somebody could add
    with pytest.raises(GraphError, match=r"The log has no odometry to hold them: add it, or remove the sightings"):
        solve(Graph.from_log(log, edges="virtual"))


def test_levenberg_marquardt_and_edges_without_information(tmp_path):
    graph = chain([FULL] * 4, tmp_path)
    family = graph.families[0]
    empty = RelativePoseEdges(family.first, family.second, family.measured, np.zeros((4, 3, 3)))
    from dataclasses import replace

    with pytest.raises(GraphError, match="do not determine"):
        solve(replace(graph, families=(empty,)))
