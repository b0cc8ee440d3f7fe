"""Files of maps: tables, NumPy archives, YAML of tags and GeoJSON.

* Tables (.csv, .tsv, .txt; .parquet is only read): one landmark per row, with the columns id, x, y and, where they are known,
  heading, class and the covariance: var_x, cov_xy, var_y, cov_x_heading, cov_y_heading, var_heading. Other common names of
  the first ones are recognised (`graphslam.log.table`). Empty cells say that something is not known. In the column correlated
  1 says that the errors of the landmark are correlated with those of others, and the file does not say how. The columns
  datum_latitude, datum_longitude [degrees] and datum_height [m] hold the datum of the map (`LandmarkMap`), in all rows.
* .npz, which keeps everything without rounding: ``format`` ("graphslam-map-1"), ``ids`` (L,), ``places`` (L, 3) with NaN for
  a heading that is not known, ``covariances`` (L, 3, 3) with NaN for what is not known, ``classes`` (L,) words,
  ``joint`` (N, N) where the covariances are those of the landmarks together, and ``datum`` (3,).
* YAML of tags (.yaml, .yml): mappings with an id, anywhere in the file, such as the layouts of AprilTag bundles and of
  TagSLAM: x and y, themselves or in ``position``, ``translation`` or ``pose``; and heading (theta, yaw) or a quaternion
  (qx, qy, qz, qw) about the vertical. A quaternion that is tilted gives no heading: which axis a tag faces by is not known.
* GeoJSON (.geojson, .json): a collection of points in metres of the map's plane, with the properties id, heading, class,
  covariance, correlated and datum. (RFC 7946 means degrees of longitude and latitude by coordinates; these are refused.)

Positions are in metres, headings in radians.
"""

from __future__ import annotations

import io
import json
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import FormatError, OptionError, quoted, reason_of
from ..files import check_file, read_archive, read_text, write_whole
from ..log.join import map_of
from ..log.measurements import symmetric
from ..log.rows import TableOptions
from ..log.table import Table, plain
from ..log.text_table import PARQUET, TEXT, table_of
from ..se2 import Array

if TYPE_CHECKING:
    from .landmark_map import LandmarkMap

VERSION = "graphslam-map-1"
#: the columns of covariances, in the order of the upper triangle of (3, 3), column by column
COVARIANCE = ("var_x", "cov_xy", "var_y", "cov_x_heading", "cov_y_heading", "var_heading")
DIFFERENT_DATUMS = "have different datums: make one file of each map"
DATUM = ("datum_latitude", "datum_longitude", "datum_height")
#: words in other names of errors, and what they are errors of
_OF_ERRORS = {"var", "variance", "cov", "covariance", "std", "stdev", "stddev", "sd", "sigma", "err", "error"}
_ERRORS_OF = {"x", "y", "xx", "xy", "yy", "heading", "theta", "yaw", "pos", "position", "range"}
UPPER = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))

#: means, covariances, classes and joint covariance: the arguments of `LandmarkMap`
Parts = dict[str, Any]


#: a mapping with id, x, y and more, its line in the file, and what messages call it
_Entry = tuple[dict[str, Any], int | None, str]


def read_map(path: Path) -> Parts:
    """The arguments of the `LandmarkMap` that a file holds.

    Raises:
        FormatError: the file cannot be read, or holds no map.
    """
    reader, _ = _format(path)
    check_file(path)
    parts = reader(path)
    if not parts["means"]:
        raise FormatError(path, None, "there is no landmark in it; a map needs at least one, with id, x and y")
    return parts


def write_map(path: Path, landmarks: LandmarkMap) -> None:
    """Write a map, see `LandmarkMap.save`."""
    _, writer = _format(path)
    if writer is None:
        raise OptionError(f"{path}: maps are not written as {path.suffix}; use .csv, .npz, .yaml or .geojson")
    with write_whole(path) as temporary:
        temporary.write_bytes(writer(landmarks))


def map_text(
    means: Mapping[int, Array],
    covariances: Mapping[int, Array],
    classes: Mapping[int, Any] | None = None,
    comma: str = ",",
    correlated: bool = False,
    datum: Array | None = None,
) -> str:
    """A map as a table with commas, or another separator; what is not known stays empty."""
    classes, of_all = classes or {}, [] if datum is None else [repr(float(number)) for number in datum]
    further = [*["correlated"] * correlated, *DATUM[: len(of_all)], *["class"] * bool(classes)]
    lines = [comma.join(("id", "x", "y", "heading", *COVARIANCE, *further))]
    for j in sorted(means):
        mean = np.asarray(means[j], dtype=float).tolist()
        cells: list[float | None] = [*mean, *[None] * (3 - len(mean))]
        C = covariances.get(j)
        cells += [None if C is None or max(place) >= len(C) else C[place] for place in UPPER]
        row = [str(j), *("" if c is None or np.isnan(c) else repr(float(c)) for c in cells)]
        row += ["" if C is None else "1"] * correlated + of_all
        lines.append(comma.join(row + [_quoted_cell(str(classes.get(j, "")))] * bool(classes)))
    return "\n".join(lines) + "\n"


def _quoted_cell(word: str) -> str:
    return '"' + word.replace('"', '""') + '"' if set(word) & set(',";\t\n') else word


def _table(path: Path) -> Parts:
    table = table_of(path, "map")
    means = map_of(table, TableOptions())
    columns = {plain(name)[0]: k for k, name in enumerate(table.names)}
    ids = list(means)
    parts: Parts = {"means": means}
    _check_errors(table)
    if all(name in columns for name in DATUM):
        datums = table.numbers([columns[name] for name in DATUM])
        datums = np.unique(datums[np.isfinite(datums).all(axis=1)], axis=0)
        if len(datums) > 1:
            raise table.error(None, f"its rows {DIFFERENT_DATUMS}")
        parts["datum"] = next(iter(datums), None)
    if "var_x" in columns:
        missing = [name for name in COVARIANCE[:3] if name not in columns]
        if missing:
            advice = "give it, too, with 0 where errors along x and y are independent"
            raise table.error(None, f"there is a column var_x, but no column {missing[0]} of the covariance; {advice}")
        used = [name for name in COVARIANCE if name in columns]
        values = np.full((len(ids), len(COVARIANCE)), np.nan)
        values[:, [COVARIANCE.index(name) for name in used]] = table.numbers([columns[name] for name in used])
        covariances = {}
        for row, (j, whole) in enumerate(zip(ids, symmetric(values, UPPER))):
            C = whole[: len(means[j]), : len(means[j])]
            if np.isfinite(C).all():
                covariances[j] = C
            elif np.isfinite(whole).any():
                raise table.error(row, f"the covariance of landmark {j} is not complete; fill in all of it, or nothing")
        parts["covariances"] = covariances
        marked = [str(word).strip() for word in table.words(columns["correlated"])] if "correlated" in columns else []
        parts["correlated"] = "1" in marked or "1.0" in marked
    if "class" in columns:
        words = [str(word).strip() for word in table.words(columns["class"])]
        parts["classes"] = {j: word for j, word in zip(ids, words) if word}
    return parts


def _check_errors(table: Table) -> None:
    """Refuse columns that seem to be errors and cannot be used, because landmarks without a covariance count as exact."""
    names = [plain(name)[0] for name in table.names]
    for name in COVARIANCE:
        if names.count(name) > 1:
            raise table.error(None, f"there are two columns {name}; a map has one")
    for title, name in zip(table.names, names):
        words = set(plain(re.sub(r"(?<=[a-z])(?=[A-Z])", "_", title.strip()))[0].split("_"))
        of_errors = words & _OF_ERRORS and words - _OF_ERRORS <= _ERRORS_OF
        if (of_errors and name not in COVARIANCE) or (name in COVARIANCE and "var_x" not in names):
            seems = f"the column {title.strip()} seems to tell errors; those of a map are var_x, cov_xy and var_y [m²]"
            advice = "If it is a standard deviation, square it and name it so; otherwise rename or remove it"
            raise table.error(None, f"{seems}. {advice}: without a covariance a landmark counts as exact")


def _archive(path: Path) -> Parts:
    content = read_archive(path, "a map")
    if str(content.get("format")) != VERSION:
        kind = "a log" if str(content.get("format", "")).startswith("graphslam-log") else "no map"
        raise FormatError(path, None, f"the archive is {kind}: the entry 'format' of a map is {VERSION!r}")
    try:
        ids, places, C = content["ids"].tolist(), content["places"], content["covariances"]
        if places.shape != (len(ids), 3) or C.shape != (len(ids), 3, 3) or len(set(ids)) < len(ids):
            raise ValueError("its ids, places and covariances do not fit together")
        sizes = np.isfinite(places).sum(axis=1).tolist()
        means = {j: place[:d] for j, place, d in zip(ids, places, sizes)}
        known = {j: c[:d, :d] for j, c, d in zip(ids, C, sizes) if np.isfinite(c[:d, :d]).all()}
        parts: Parts = {"means": means, "covariances": known, "correlated": "correlated" in content}
        if "classes" in content:
            parts["classes"] = {j: word for j, word in zip(ids, content["classes"].tolist()) if word}
        if "datum" in content:
            parts["datum"] = content["datum"]
        if "joint" in content:
            parts |= {"covariances": None, "joint": content["joint"], "joint_ids": list(known)}
    except (KeyError, ValueError, TypeError, AttributeError, IndexError) as error:
        raise FormatError(path, None, f"the archive is no whole map: {reason_of(error)}") from None
    return parts


def _archived(landmarks: LandmarkMap) -> bytes:
    places, C = landmarks.arrays(landmarks)
    exact = np.array([j not in landmarks.covariances for j in landmarks], dtype=bool)
    unknown = exact[:, None] | np.isnan(places)
    C[unknown[:, :, None] | unknown[:, None, :]] = np.nan
    ids = np.array(list(landmarks), dtype=np.int64)
    arrays: dict[str, Any] = {"format": VERSION, "ids": ids, "places": places, "covariances": C}
    if landmarks.classes:
        arrays["classes"] = np.array([str(landmarks.classes.get(j, "")) for j in landmarks])
    if landmarks.joint is not None:
        arrays["joint"] = landmarks.joint
    if landmarks.correlated:
        arrays["correlated"] = True
    if landmarks.datum is not None:
        arrays["datum"] = landmarks.datum
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    return stream.getvalue()


def _geojson(path: Path) -> Parts:
    try:
        content = json.loads(read_text(path))
    except json.JSONDecodeError as error:
        raise FormatError(path, error.lineno, f"not JSON: {error.msg}") from None
    except RecursionError:
        raise FormatError(path, None, "not GeoJSON: its brackets are nested too deeply") from None
    if not isinstance(content, dict) or not isinstance(content.get("features"), list):
        raise FormatError(path, None, "not GeoJSON: a FeatureCollection with a list of features is needed here")
    entries: list[_Entry] = []
    for k, feature in enumerate(content["features"]):
        where = f"feature {k}"
        geometry = feature.get("geometry") if isinstance(feature, dict) else None
        if not isinstance(geometry, dict) or geometry.get("type") != "Point":
            raise FormatError(path, None, f"{where} is no Point; each landmark of a map is one")
        at, own = geometry.get("coordinates"), feature.get("properties") or {}
        if not isinstance(at, list) or len(at) < 2 or not isinstance(own, dict):
            raise FormatError(path, None, f"{where} needs coordinates [x, y], not {quoted(at)}")
        entries.append(({"id": feature.get("id"), **own, "x": at[0], "y": at[1]}, None, where))
    parts = _of_entries(path, entries)
    places = np.array([place[:2] for place in parts["means"].values()]).reshape(-1, 2)
    small = len(places) > 1 and np.ptp(places, axis=0).max() < 0.02
    if small and np.abs(places).max() > 1 and np.all(np.abs(places) <= (180, 90)):
        message = "the coordinates look like degrees of longitude and latitude; convert them to metres of a local plane"
        raise FormatError(path, None, message)
    return parts


def _as_geojson(landmarks: LandmarkMap) -> bytes:
    features = [
        {"type": "Feature", "id": entry["id"],
         "geometry": {"type": "Point", "coordinates": [entry.pop("x"), entry.pop("y")]}, "properties": entry}
        for entry in _entries(landmarks)
    ]  # fmt: skip
    text = ",\n".join(json.dumps(feature) for feature in features)
    head = '{"type": "FeatureCollection", "coordinates": "metres of the plane of the map", "features": [\n'
    return f"{head}{text}\n]}}\n".encode()


def _entries(landmarks: LandmarkMap) -> Iterator[dict[str, Any]]:
    covariances, classes = landmarks.covariances, landmarks.classes
    for j, place in landmarks.items():
        entry: dict[str, Any] = {"id": j, "x": float(place[0]), "y": float(place[1])}
        entry |= {"heading": float(place[2])} if len(place) == 3 else {}
        entry |= {"class": str(classes[j])} if j in classes else {}
        entry |= {"covariance": covariances[j].tolist()} if j in covariances else {}
        entry |= {} if landmarks.datum is None else {"datum": landmarks.datum.tolist()}
        yield entry | ({"correlated": True} if j in covariances and _loses_correlations(landmarks) else {})


def _loses_correlations(landmarks: LandmarkMap) -> bool:
    return landmarks.correlated or landmarks.joint is not None


def _as_yaml(landmarks: LandmarkMap) -> bytes:
    # JSON within YAML: no package is needed to write it
    rows = "\n".join(f"- {json.dumps(entry)}" for entry in _entries(landmarks))
    # YAML 1.1 takes 1e-07, without a point, for a word
    rows = re.sub(r"(?<=[ \[])(-?\d)e(?=[-+]?\d)", r"\1.0e", rows)
    return f"# metres and radians\ntags:\n{rows}\n".encode()


def _yaml(path: Path) -> Parts:
    try:
        import yaml
    except ImportError:
        raise FormatError(path, None, "YAML files are read by PyYAML: pip install pyyaml") from None

    class Loader(yaml.SafeLoader):
        """Mappings that know their line."""

        def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
            return {**super().construct_mapping(node, deep=deep), _LINE: node.start_mark.line + 1}

    try:
        content = yaml.load(read_text(path), Loader)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = None if mark is None else mark.line + 1
        raise FormatError(path, line, f"not YAML: {getattr(error, 'problem', None) or reason_of(error)}") from None
    except (RecursionError, ValueError, TypeError) as error:
        raise FormatError(path, None, f"not YAML of tags: {reason_of(error)}") from None
    return _of_entries(path, [(tag, tag.get(_LINE), f"tag {tag['id']}") for tag in _tags(content)])


_LINE = "line of the file"
#: names of the id, of nested positions and rotations, and of headings, in YAML
_IDS = ("id", "ID", "tag_id", "marker_id")
_INSIDE = ("pose", "position", "translation", "rotation", "orientation", "quaternion")
_HEADINGS = ("heading", "theta", "yaw")


def _tags(content: Any) -> Iterator[dict[str, Any]]:
    """The mappings with an id, with what is nested in them by the names x, y, qx, qy, qz and qw."""
    if isinstance(content, list):
        for each in content:
            yield from _tags(each)
    elif isinstance(content, dict):
        named = next((name for name in _IDS if name in content), None)
        if named is not None:
            yield {**_flat(content, ""), "id": content[named]}
            return
        for key, value in content.items():
            if isinstance(key, int) and isinstance(value, dict):
                yield {**_flat(value, ""), "id": key}
            else:
                yield from _tags(value)


def _flat(content: Mapping[Any, Any], prefix: str) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in content.items():
        turned = name in ("rotation", "orientation", "quaternion")
        if name in _INSIDE and isinstance(value, dict):
            found |= {k: v for k, v in _flat(value, "q" if turned else prefix).items() if k != _LINE}
        elif name in ("position", "translation") and isinstance(value, list):
            found |= dict(zip("xyz", value))
        else:
            key = str(name)
            found[prefix + key.lower() if prefix and key.lower() in ("x", "y", "z", "w") else key] = value
    return found


def _of_entries(path: Path, entries: list[_Entry]) -> Parts:
    """The map of mappings with id, x, y and more."""
    means: dict[int, Array] = {}
    covariances: dict[int, Array] = {}
    classes: dict[int, Any] = {}
    for entry, line, where in entries:
        j = entry.get("id")
        if isinstance(j, str) and j.strip().isdecimal():
            j = int(j)
        if not isinstance(j, int) or isinstance(j, bool):
            raise FormatError(path, line, f"{where} has the id {quoted(j)}; ids are whole numbers")
        if j in means:
            raise FormatError(path, line, f"landmark {j} is in the map twice; each landmark has one place")
        place = [_number(path, line, where, entry, name) for name in ("x", "y")]
        named = next((name for name in _HEADINGS if entry.get(name) is not None), None)
        if named is not None:
            place.append(_number(path, line, where, entry, named))
        elif "qz" in entry and "qw" in entry:
            x, y, z, w = (_number(path, line, where, {name: 0.0} | entry, name) for name in ("qx", "qy", "qz", "qw"))
            if abs(x) + abs(y) <= 1e-3 * (abs(z) + abs(w)):
                place.append(2 * float(np.arctan2(z, w)))
        means[j] = np.array(place)
        if entry.get("class") is not None:
            classes[j] = entry["class"]
        if entry.get("covariance") is not None:
            try:
                covariances[j] = np.array(entry["covariance"], dtype=float)
            except (TypeError, ValueError):
                raise FormatError(path, line, f"{where} has a covariance that is no matrix of numbers") from None
    # in other programs a datum is the name of an ellipsoid
    datums = [entry["datum"] for entry, *_ in entries if isinstance(entry.get("datum"), list)]
    if any(datum != datums[0] for datum in datums):
        raise FormatError(path, None, f"its landmarks {DIFFERENT_DATUMS}")
    return {
        "means": dict(sorted(means.items())),
        "covariances": covariances,
        "classes": classes,
        "correlated": any(entry.get("correlated") is True for entry, *_ in entries),
        "datum": next(iter(datums), None),
    }


def _number(path: Path, line: int | None, where: str, entry: Mapping[str, Any], name: str) -> float:
    value, number = entry.get(name), np.nan
    # YAML 1.1 takes 1e-07, without a point, for a word
    if isinstance(value, (int, float, str)) and not isinstance(value, bool):
        with suppress(ValueError, OverflowError):
            number = float(value)
    if not np.isfinite(number):
        raise FormatError(path, line, f"{where} needs a number as {name}, not {quoted(value)}")
    return number


def _as_table(landmarks: LandmarkMap, comma: str = ",") -> bytes:
    lost = _loses_correlations(landmarks)
    return map_text(landmarks, landmarks.covariances, landmarks.classes, comma, lost, landmarks.datum).encode()


_Writer = Callable[["LandmarkMap"], bytes]
#: readers and writers by the ending of the file
_FORMATS: dict[str, tuple[Callable[[Path], Parts], _Writer | None]] = {
    **dict.fromkeys((*TEXT, *PARQUET), (_table, None)),
    **dict.fromkeys((".tsv", ".txt"), (_table, partial(_as_table, comma="\t"))),
    ".csv": (_table, _as_table), ".npz": (_archive, _archived), ".yaml": (_yaml, _as_yaml), ".yml": (_yaml, _as_yaml),
    ".geojson": (_geojson, _as_geojson), ".json": (_geojson, _as_geojson),
}  # fmt: skip


def _format(path: Path) -> tuple[Callable[[Path], Parts], _Writer | None]:
    suffix = path.suffix.lower()
    if suffix not in _FORMATS:
        given = quoted(suffix) if suffix else "a file without an ending"
        raise OptionError(f"{path}: a map is a file .csv, .npz, .yaml or .geojson, not {given}")
    return _FORMATS[suffix]
