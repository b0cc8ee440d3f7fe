"""The commands on the pages and in the README exist, with their options."""

import re
import shlex
from pathlib import Path

import pytest
from typer.main import get_command

from comparisons.cli import app

ROOT = Path(__file__).parents[2]
VERBS = get_command(app).commands
PAGES = [*sorted(ROOT.glob("README*.md")), *sorted((ROOT / "docs").rglob("*.md"))]


def commands(page):
    """The commands in blocks of code and in backquotes, without their comments."""
    text = page.read_text().replace("\\\n", " ")
    found = re.findall(r"^ *((?:\S*python -m comparisons|slam-compare) [a-z].*)$", text, re.MULTILINE)
    found += re.findall(r"`(slam-compare [a-z][^`]*)`", text)
    return [line.split("  ")[0].split(" #")[0].rstrip(":") for line in found]


@pytest.mark.parametrize(
    "page", [page for page in PAGES if commands(page)], ids=lambda page: str(page.relative_to(ROOT))
)
def test_commands_exist(page):
    for command in commands(page):
        verb, *arguments = re.sub(r"^.*?(comparisons|slam-compare) ", "", command).split(" ")
        # `run` and `report` share options: "slam-compare run|report", or a sentence about several
        assert verb.strip(",;") in VERBS, command
        known = {option for parameter in VERBS[verb].params for option in parameter.opts + parameter.secondary_opts}
        for argument in arguments:
            if argument.startswith("--") and len(argument) > 2:
                assert shlex.split(argument.replace("'", ""))[0].split("=")[0] in known | {"--help"}, command
