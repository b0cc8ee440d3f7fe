"""Maps and their files: what is written is read again, and what cannot be is refused with its place."""

import copy
import json
import pickle

import numpy as np
import pytest

from graphslam import FormatError, Graph, LandmarkMap, OnlineSolver, OptionError, SlamError, simulate, solve
from graphslam.maps.landmark_map import CORRELATIONS_LOST


def random_covariance(rng, n):
    A = rng.normal(size=(n, n + 2))
    return A @ A.T / n


@pytest.fixture
def mixed():
    """Landmarks with and without headings, covariances and classes."""
    rng = np.random.default_rng(1)
    means = {7: (1.0, 2.0, 0.5), -3: (0.1 + 0.2, -1e-7), 12: (4.0, 5.0, -3.0), 2**40: (0.0, 1.0)}
    covariances = {7: random_covariance(rng, 3), -3: random_covariance(rng, 2)}
    return LandmarkMap(means, covariances, classes={7: "pole, red", 12: "tree"})


def same(a, b):
    assert list(a) == list(b)
    assert all(np.array_equal(a[j], b[j]) for j in a)
    assert a.covariances.keys() == b.covariances.keys()
    assert all(np.array_equal(a.covariances[j], b.covariances[j]) for j in a.covariances)
    assert a.classes == b.classes
    assert (a.joint is None) == (b.joint is None)
    assert a.joint is None or np.array_equal(a.joint, b.joint)


@pytest.mark.parametrize("name", ["map.csv", "map.tsv", "map.txt", "map.npz", "map.yaml", "map.geojson", "map.json"])
def test_a_written_map_is_read_exactly(mixed, name, tmp_path):
    mixed.save(tmp_path / name)
    same(LandmarkMap.load(tmp_path / name), mixed)
    assert LandmarkMap.load(tmp_path / name).datum is None
    with_datum = mixed.copy()
    with_datum.datum = np.array([35.5, -139.123456789, -12.5])
    with_datum.save(tmp_path / name)
    assert np.array_equal(LandmarkMap.load(tmp_path / name).datum, with_datum.datum)


def test_a_datum_of_other_programs_is_no_obstacle(tmp_path):
    (tmp_path / "tags.yaml").write_text("tags:\n- {id: 1, x: 0.0, y: 1.0, datum: WGS84}\n")
    (tmp_path / "map.csv").write_text("id,x,y,datum_latitude,datum_longitude,datum_height\n1,0,1,47,8,\n2,0,2,47,8,\n")
    assert all(LandmarkMap.load(tmp_path / name).datum is None for name in ("tags.yaml", "map.csv"))


@pytest.mark.parametrize("name", ["map.csv", "map.npz", "map.yaml", "map.geojson"])
def test_classes_that_are_numbers_stay_numbers(name, tmp_path):
    kinds = {1: 1, 2: 1.0, 3: "1", 4: np.int64(-2), 5: "tree", 6: "1.5", 7: "007"}
    known = LandmarkMap({j: (j, 0.0) for j in kinds}, classes=kinds)
    assert known.classes == {1: 1, 2: 1, 3: 1, 4: -2, 5: "tree", 6: "1.5", 7: "007"}
    known.save(tmp_path / name)
    assert LandmarkMap.load(tmp_path / name).classes == known.classes


def test_a_joint_covariance_is_kept_by_npz_and_its_blocks_by_others(tmp_path):
    joint = random_covariance(np.random.default_rng(2), 5)
    known = LandmarkMap({1: (0, 0), 2: (1, 0), 3: (1, 1, 2)}, joint=joint, joint_ids=[3, 1])
    assert repr(known) == "<LandmarkMap of 3 landmarks: 2 with a joint covariance, 1 exact>"
    # in the order of the ids: landmark 1 has the first two rows
    assert np.array_equal(known.covariances[1], (joint[:2, :2] + joint[:2, :2].T) / 2)
    known.save(tmp_path / "map.npz")
    same(LandmarkMap.load(tmp_path / "map.npz"), known)
    same(pickle.loads(pickle.dumps(known)), known)
    known.save(tmp_path / "map.csv")
    same(LandmarkMap.load(tmp_path / "map.csv"), known.used_as("own"))
    with pytest.raises(OptionError, match="maps are not written as .parquet"):
        known.save(tmp_path / "map.parquet")
    assert not known.used_as("fixed").covariances


@pytest.mark.parametrize("ending", ["csv", "tsv", "yaml", "geojson", "npz"])
def test_a_file_that_has_lost_correlations_is_noted(tmp_path, ending):
    log = simulate(seed=0, steps=12, clean=True)
    joint, path = solve(Graph.from_log(log)).map, tmp_path / f"map.{ending}"
    independent = LandmarkMap(joint, joint.covariances)
    for known, lost in ((joint, ending != "npz"), (independent, False), (joint.used_as("fixed"), False)):
        known.save(path)
        read = LandmarkMap.load(path)
        assert read.correlated == copy.copy(read).correlated == lost
        assert (CORRELATIONS_LOST in Graph.from_log(log, map=path).notes) == lost
        assert (CORRELATIONS_LOST in OnlineSolver(map=path).notes) == lost
        read.save(tmp_path / "again.npz")
        assert LandmarkMap.load(tmp_path / "again.npz").correlated == lost


def test_parts_of_a_map_that_has_lost_correlations_have_lost_them_too():
    known = LandmarkMap({1: (0, 0), 2: (1, 0)}, {1: np.eye(2), 2: np.eye(2)}, correlated=True)
    assert known.among([1]).correlated and known.widened(0.1).correlated


def test_a_map_without_a_landmark_that_was_taken_out_is_written(tmp_path):
    """Its .npz file had the joint covariance of all landmarks, and could not be read."""
    known = LandmarkMap({1: (0, 0), 2: (1, 0), 3: (2, 2)}, joint=np.diag(np.arange(1.0, 7)))
    left = known.among([1, 3])
    del known[2]
    known.save(tmp_path / "map.npz")
    same(LandmarkMap.load(tmp_path / "map.npz"), left)


def test_the_joint_information_of_some_landmarks_is_the_schur_complement_of_the_others():
    rng = np.random.default_rng(3)
    joint = random_covariance(rng, 6)
    known = LandmarkMap({1: (0, 0), 2: (1, 0), 3: (1, 1)}, joint=joint)
    whole = np.linalg.inv(joint)
    gone, kept = whole[4:, 4:], whole[:4, :4]
    expected = kept - whole[:4, 4:] @ np.linalg.solve(gone, whole[4:, :4])
    found = known.information([1, 2], 2)
    assert np.allclose(found[np.ix_([0, 1, 3, 4], [0, 1, 3, 4])], expected, rtol=1e-12)
    assert not found[2].any() and not found[:, 5].any()


def test_tables_of_other_programs_are_read(tmp_path):
    (tmp_path / "tags.csv").write_text("tag_id;pos_x [cm];pos_y [cm];yaw [deg]\n3;100;250;90\n4;0;-50;\n")
    known = LandmarkMap.load(tmp_path / "tags.csv")
    assert np.allclose(known[3], [1.0, 2.5, np.pi / 2])
    assert np.allclose(known[4], [0.0, -0.5])
    # other columns are none of the map's, also those whose names begin like that of a variance
    for other in ("variety", "std_class", "var_z"):
        (tmp_path / "trees.csv").write_text(f"id,x,y,{other}\n1,0,2,3\n")
        assert np.array_equal(LandmarkMap.load(tmp_path / "trees.csv")[1], [0, 2])


def test_yaml_of_apriltag_bundles_and_of_tagslam_is_read(tmp_path):
    (tmp_path / "tags.yaml").write_text(
        "tag_bundles:\n  - name: wall\n    layout:\n"
        "      - {id: 3, size: 0.16, x: 1.0, y: 2.0, z: 0.3, qw: 0.7071067811865476, qx: 0, qy: 0, qz: 0.7071067811865476}\n"
        "bodies:\n- lab:\n    tags:\n    - id: 4\n      pose:\n        position: {x: 3.0, y: 1.0, z: 2.0}\n"
        "        rotation: {x: 1.5, y: 0.0, z: 0.0}\n"
    )
    known = LandmarkMap.load(tmp_path / "tags.yaml")
    assert np.allclose(known[3], [1.0, 2.0, np.pi / 2])
    assert np.allclose(known[4], [3.0, 1.0])
    (tmp_path / "named.yml").write_text("5: {x: 1, y: 2, heading: 0.25}\n6: {x: 3, y: 4}\n")
    assert np.allclose(LandmarkMap.load(tmp_path / "named.yml")[5], [1, 2, 0.25])


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("m.csv", "id,x,y\n1,0,0\n1,1,1\n", "m.csv:3: landmark 1 is in the map twice"),
        ("m.csv", "id,x,y\n1,0,\n", "m.csv:2: 'y' is empty"),
        ("m.csv", "id,x,y,var_x,cov_xy,var_y\n1,0,0,1,,1\n", "m.csv:2: the covariance of landmark 1 is not complete"),
        ("m.csv", "id,x,y,var_x,var_y\n1,0,0,1,1\n", "no column cov_xy of the covariance; give it, too, with 0 where"),
        ("m.csv", "id,x,y,var_x,cov_xy,var_y\n1,0,0,1,2,1\n", "negative eigenvalue -1"),
        ("m.csv", "id,x,y,sigma_x,sigma_y\n1,0,0,1,1\n", "the column sigma_x seems to tell errors"),
        ("m.csv", "id,x,y,x_std,y_std\n1,0,0,1,1\n", "the column x_std seems to tell errors"),
        ("m.csv", "id,x,y,sigmaX\n1,0,0,1\n", "the column sigmaX seems to tell errors"),
        ("m.csv", "id,x,y,covariance_xx\n1,0,0,1\n", "the column covariance_xx seems to tell errors"),
        ("m.csv", "id,x,y,var_x,cov_xy,var_y,var_x\n1,0,0,1,0,1,1\n", "two columns var_x"),
        ("m.csv", "id,x,y\ndoor,0,0\nwell,1,1\n", "the ids are words, such as 'door'"),
        ("m.csv", "id,x,y\n-1,0,0\n", "empty or -1, which means no id"),
        ("m.csv", "id,x,y,cov_xy\n1,0,0,1\n", "the column cov_xy seems to tell errors"),
        ("m.csv", "id,x,y,var_x,cov_xy,var_y\n1,0,0,-1,0,1\n", "m.csv: "),
        ("m.yaml", "tags:\n- {id: 1, x: 2, y: 3}\n- {id: 2, x: two, y: 3}\n", "m.yaml:3: tag 2 needs a number as x"),
        ("m.yaml", "tags:\n- {id: 1, x: 2, y: 3}\n- {id: 1, x: 2, y: 3}\n", "m.yaml:3: landmark 1 is in the map twice"),
        ("m.csv", "id,x,y,heading\n1,0,0,90\n", "m.csv:2: the heading is 90 rad: does it count many turns"),
        ("m.yaml", f"tags:\n- {{id: 1, x: 1{400 * '0'}, y: 3}}\n", "m.yaml:2: tag 1 needs a number as x"),
        ("m.yaml", "tags:\n- {id: '²', x: 2, y: 3}\n", "m.yaml:2: tag ² has the id '²'; ids are whole numbers"),
        ("m.yaml", "tags: [\n", "m.yaml:2: not YAML"),
        ("m.yaml", "tags: []\n", "there is no landmark in it"),
        ("m.yaml", "- {id: 1, x: 2, y: 3, datum: [5, 9, 0]}\n- {id: 2, x: 2, y: 3, datum: [6, 9, 0]}\n", "different datums"),
        ("m.json", "{\n,", "m.json:2: not JSON"),
        ("m.json", "[]", "a FeatureCollection"),
        ("m.txt", "", "the file is empty"),
        ("m.npz", "PK", "not a readable .npz archive"),
        ("m.xlsx", "", "a map is a file .csv, .npz, .yaml or .geojson, not '.xlsx'"),
    ],
)  # fmt: skip
def test_a_file_that_holds_no_map_is_refused_with_its_line(name, text, message, tmp_path):
    (tmp_path / name).write_text(text)
    with pytest.raises(SlamError) as caught:
        LandmarkMap.load(tmp_path / name)
    assert message in str(caught.value)


def test_degrees_of_longitude_and_latitude_are_refused(tmp_path):
    features = [
        {"type": "Feature", "geometry": {"type": "Point", "coordinates": [139.5 + k / 1e4, 35.7]}, "id": k}
        for k in range(3)
    ]
    (tmp_path / "m.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    with pytest.raises(FormatError, match="longitude and latitude"):
        LandmarkMap.load(tmp_path / "m.geojson")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (({-1: (0, 0)},), "stands for no id"),
        (({1.5: (0, 0)},), "whole numbers"),
        (({1: (0, np.nan)},), "landmark 1 of the map must be finite"),
        (({1: (0, 0)}, {2: np.eye(2)}), "landmark 2, which is not in the map"),
        (({1: (0, 0)}, {1: np.eye(3)}), r"shape \(2, 2\)"),
        (({1: (0, 0)}, {1: [[1, 2], [0, 1]]}), "symmetric"),
        (({1: (0, 0)}, np.eye(2)), "covariances of a map are {id: "),
        (({1: (0, 0)}, 0.01), "covariances of a map are {id: "),
    ],
)
def test_an_impossible_map_is_refused(arguments, message):
    with pytest.raises(OptionError, match=message):
        LandmarkMap(*arguments)


def test_a_singular_covariance_is_no_prior():
    with pytest.raises(OptionError, match="singular"):
        LandmarkMap({1: (0, 0)}, {1: np.zeros((2, 2))}).own_information(1, 2)
    # errors of 5 mm beside a common one of 100 km are lost in rounding: such a map ended the process at the first sighting
    joint = 2.5e-5 * np.eye(4) + 1e10 * np.kron(np.ones((2, 2)), np.eye(2))
    with pytest.raises(OptionError, match="the joint covariance of the map is singular"):
        OnlineSolver((0, 0, 0), map=LandmarkMap({1: (0, 0), 2: (3, 1)}, joint=joint))


def test_maps_are_equal_that_say_the_same(tmp_path):
    known = solve(Graph.from_log(simulate(seed=1, steps=40, clean=True))).map
    known.save(tmp_path / "map.npz")
    copied = known.copy()
    assert known == LandmarkMap.load(tmp_path / "map.npz") == copied
    assert not known != copied  # noqa: SIM202  # dictionaries have an operator of its own
    assert copied.joint is not None  # a plain dictionary would be a map of exact landmarks
    assert known != known.used_as("own") != known.used_as("fixed") and known != dict(known)
    copied[0][0] += 0.1
    assert known != copied


def test_ids_of_floating_point_numbers_are_ids():
    assert list(LandmarkMap({np.float64(3.0): (0, 0)})) == [3]


def test_a_log_is_no_map(tmp_path):
    from graphslam import save, simulate

    save(simulate(steps=3), tmp_path / "log.npz")
    with pytest.raises(FormatError, match="the archive is a log"):
        LandmarkMap.load(tmp_path / "log.npz")
