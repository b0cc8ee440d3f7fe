"""Hints below results: what to do next where a message names options that another verb has."""

from __future__ import annotations

import re
from collections.abc import Collection

from graphslam.tables.options import TableOptions

from ..option import options_of


def hint_of_import(text: str, known: Collection[str] = ()) -> str | None:
    """Where options of ``import`` that a sentence advises stand for a verb that does not have them; None where it names none.

    Args:
        text: the sentence.
        known: names of the options of the verb.
    """
    names = [f"--{name.replace('_', '-')}" for name in options_of(TableOptions) if name not in known]
    named = [name for name in names if re.search(rf"{name}\b", text)]
    if not named:
        return None
    are, them = ("are options", "them") if len(named) > 1 else ("is an option", "it")
    return (
        f"{', '.join(named)} {are} of slam-compare import; other verbs read {them} from import.toml in the folder of the "
        "tables, or from the TOML file of the bag's name (docs/own_robot.md)"
    )
