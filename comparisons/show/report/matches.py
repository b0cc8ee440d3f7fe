"""Matches in the report: the details of a landmark and a table of all of them, with the true landmark of its sightings."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from rich.table import Table

from graphslam.log import UNIDENTIFIED

from ...comparison import Comparison
from ...results import EstimatorResult
from ...sightings import sightings_of
from ..cells import NOTHING, LeanTable, number, word

if TYPE_CHECKING:
    from rich.console import RenderableType

#: in longer logs a click shows nothing: the page has to stay small
MOST_SIGHTINGS = 100_000


def matches_of(comparison: Comparison) -> dict[str, Any]:
    """``of``: the number of the association that each estimator has; ``associations``: {landmark: what is known of it} each.

    Of a landmark are known the ``steps`` of its sightings, those of them that are ``doubtful``, the ``true`` landmark and
    the ``share`` of its sightings that are of it, and its ``class``. Estimators with the same ids share an association.
    """
    log = comparison.log
    known: dict[tuple[bytes, bytes], int] = {}
    of: dict[str, int] = {}
    associations: list[dict[str, Any]] = []
    if len(log.steps) > MOST_SIGHTINGS:
        return {"of": {}, "associations": []}
    for result in comparison.results:
        ids = log.landmarks if result.association is None else result.association
        key = ids.tobytes(), b"" if result.unconfirmed is None else result.unconfirmed.tobytes()
        if key not in known:
            known[key] = len(associations)
            associations.append(_landmarks(comparison, result, ids))
        of[result.name] = known[key]
    return {"of": of, "associations": associations}


def _landmarks(comparison: Comparison, result: EstimatorResult, ids: np.ndarray) -> dict[str, Any]:
    log, scores = comparison.log, comparison.associations[result.name]
    found = {}
    for each in sightings_of(log, ids):
        steps = log.steps[each.rows]
        doubtful = steps[:0] if result.unconfirmed is None else steps[result.unconfirmed[each.rows]]
        entry: dict[str, Any] = {"steps": steps.tolist(), "doubtful": doubtful.tolist(), "class": each.of_class}
        if scores is not None:
            true = scores.matches.get(each.landmark, UNIDENTIFIED)
            entry["true"] = None if true == UNIDENTIFIED else true
            entry["share"] = round(float(np.mean(log.landmarks[each.rows] == true)), 3)
        found[str(each.landmark)] = entry
    return found


def association_table(comparison: Comparison, result: EstimatorResult) -> Table | None:
    """The landmarks of a result with ids of its own, with the true ones that they are matched with; None where it has none.

    The share is that of the sightings that truly are of the matched landmark.
    """
    if result.association is None:
        return None
    log, scores = comparison.log, comparison.associations[result.name]
    headings = ["sightings", "unconfirmed", "steps"]
    if log.classes is not None:
        headings += ["class", "share of\nthe class"]
    if scores is not None:
        headings += ["true\nlandmark", "correct\nshare"]
    table = LeanTable(f"Landmarks of {result.name}, and what was matched to them", ["landmark"], headings)
    for each in sightings_of(log, result.association):
        steps = log.steps[each.rows]
        doubtful = 0 if result.unconfirmed is None else int(np.sum(result.unconfirmed[each.rows]))
        cells: list[RenderableType] = [str(len(each.rows)), str(doubtful), f"{steps.min()}-{steps.max()}"]
        if log.classes is not None:
            cells += [word(each.of_class), number(each.share, 2)]
        if scores is not None:
            true = scores.matches.get(each.landmark, UNIDENTIFIED)
            share = float(np.mean(log.landmarks[each.rows] == true))
            cells += [NOTHING, NOTHING] if true == UNIDENTIFIED else [str(true), f"{share:.2f}"]
        table.add_row(str(each.landmark), *cells)
    return table
