"""Tables of what was matched to what: the landmarks of an estimator that gave sightings their ids itself."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from rich.table import Table

from graphslam.log import UNIDENTIFIED

from ..sightings import sightings_of
from .cells import NOTHING, LeanTable, number, word

if TYPE_CHECKING:
    from rich.console import RenderableType

    from ..comparison import Comparison
    from ..results import EstimatorResult


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
