"""What is shown, in another language: a finished sentence is looked up by its English template.

English is the source. Code below this module makes English sentences and knows of no other language; where text is
printed or drawn, `translated` looks for the template of the catalogue (the files of `japanese/`) that the sentence has, and
translates what stands in its places likewise. What has no template stays English. JSON, files and names of estimators are
not translated.
"""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from importlib.resources import files
from typing import Any

from rich.table import Table
from rich.text import Text

from graphslam.errors import OptionError

#: code of a language -> the folder of its catalogue
CATALOGUES = {"ja": "japanese"}
LANGUAGES = ("en", *CATALOGUES)
#: a place for a value in a template, one for a number, and one for a name or value that stays as it is
PLACE, NUMBER, VERBATIM = "{}", "{#}", "{=}"


def language_of(given: str | None = None, environment: Mapping[str, str] = os.environ) -> str:
    """The language that is asked for, else that of the first variable that is set: LC_ALL, LC_MESSAGES, LANG; else English.

    Raises:
        OptionError: there is no catalogue of the language that is asked for.
    """
    if given is not None:
        if given not in LANGUAGES:
            raise OptionError(f"lang must be one of {', '.join(LANGUAGES)}, not {given!r}")
        return given
    local = next((value for name in ("LC_ALL", "LC_MESSAGES", "LANG") if (value := environment.get(name))), "")
    return local[:2] if local[:2] in CATALOGUES else "en"


def key_of(template: str) -> str:
    """A template as the catalogue has it: without the space around it, and without its full stop."""
    key = " ".join(template.split())
    return key if key.endswith("..") else key.removesuffix(".")


@cache
def catalogue(language: str) -> dict[str, str]:
    """{English template: translation}; the places of a translation may have numbers, {0}, {1}."""
    parts = files("comparisons.show").joinpath(CATALOGUES[language]).iterdir()
    groups = [group for part in parts for group in tomllib.loads(part.read_text(encoding="utf-8")).values()]
    return {key_of(template): text for group in groups for template, text in group.items()}


@cache
def _patterns(language: str) -> list[tuple[re.Pattern[str], str, list[bool]]]:
    """The templates with places as patterns, with their translations, and which of the places stay as they are."""
    found = []
    for template, translation in catalogue(language).items():
        if places := re.findall(r"\{[#=]?\}", template):
            pattern = re.escape(template).replace(r"\{\#\}", r"([-+\d.,e]+)")
            # '1 landmark' and '2 landmarks' have one template
            pattern = re.sub(r"(\\d\.,e\]\+\)\\ [a-z]{2,})s\b", r"\1s?", pattern)
            pattern = pattern.replace(r"\{\}", "(.*?)").replace(r"\{=\}", "(.*?)")
            found.append((re.compile(pattern, re.IGNORECASE), translation, [place == VERBATIM for place in places]))
    return found


def translated(text: str, language: str) -> str:
    """The text in a language, unchanged where the catalogue has no template for it."""
    if language not in CATALOGUES:
        return text
    found = _translated(text, language)[0]
    # headings of tables are broken into lines; elsewhere the same words are not
    return found if "\n" in text else found.replace("\n", "")


#: what is between sentences, and between a name and a sentence, in English and in the other language
_BETWEEN = (
    (re.compile(r"(?:(?<=[a-z)\]%'])|(?<=[A-Z]{2}))\. "), "。"),
    (re.compile("; "), "。"),
    (re.compile(": "), ": "),
)


@cache
def _translated(text: str, language: str) -> tuple[str, int]:
    """The translation that covers the most letters of the text, and how many these are.

    Short templates may match by chance: "{} of {}" has a place for half of all sentences. Nothing is translated by half:
    where English prose without a translation would stand in a place, the whole sentence stays English.
    """
    key, stop, best = key_of(text), "。" if text.rstrip().endswith(".") else "", (text, 0)
    for candidate in (key, key[:1].lower() + key[1:]):
        if candidate in catalogue(language):
            return catalogue(language)[candidate] + stop, len(key)
    specific = 0
    for pattern, translation, verbatim in _patterns(language):
        if (match := pattern.fullmatch(key)) is not None:
            places = zip(match.groups(), verbatim)
            values = [(part, len(part)) if kept else _translated(part, language) for part, kept in places]
            letters = len(key) - sum(map(len, match.groups()))
            covered = letters + sum(score for _, score in values)
            if (covered, letters) > (best[1], specific) and not any(map(_is_english, values)):
                specific, best = letters, (_filled(translation, [value for value, _ in values]) + stop, covered)
    for separator, between in _BETWEEN:
        if len(parts := separator.split(text, maxsplit=1)) > 1:
            values = [_translated(part, language) for part in parts]
            # before a colon there may be the name of a log, in a few words
            prose = values[1:] if len(parts[0].split()) <= _WORDS_OF_NAME else values
            whole = between == "。" or not any(map(_is_english, prose))
            if whole and (covered := sum(score for _, score in values)) >= max(best[1], 1):
                best = between.join(value for value, _ in values), covered
    return best


#: the most words of the name of a log
_WORDS_OF_NAME = 5
#: three words that are no command, path or name, and a list of names, such as those of estimators
_NAMES = re.compile(r"[\w-]+(, [\w-]+)+")
_PROSE = re.compile(r"(?<![\w./-])[A-Za-z][a-z]+,? [a-z]{2,},? [a-z]{2,}(?![\w./-])")


def _is_english(translation: tuple[str, int]) -> bool:
    """Whether a text of which nothing was translated is English prose."""
    text, covered = translation
    return covered == 0 and _PROSE.search(text) is not None and _NAMES.fullmatch(text) is None


def _filled(translation: str, values: list[str]) -> str:
    """A translation with values in its places, by their numbers or one after another."""
    following = iter(values)
    return re.sub(r"\{(\d*)\}", lambda m: values[int(m[1])] if m[1] else next(following), translation)


#: the heading of columns of names that stay as they are: one of the noise models is called "no"
VERBATIM_COLUMN = "parameter"


def translated_table(table: Table, language: str) -> Table:
    """The table with its title, headings and cells in a language; it is changed in place."""
    if language not in CATALOGUES:
        return table
    table.title = None if table.title is None else _cell(table.title, language)
    table.columns = [
        replace(
            column,
            header=_cell(column.header, language),
            _cells=[cell if str(column.header) == VERBATIM_COLUMN else _cell(cell, language) for cell in column.cells],
        )
        for column in table.columns
    ]
    return table


def _cell(cell: Any, language: str) -> Any:
    """A cell whose texts are translated; a text of several styles is translated part by part."""
    if not isinstance(cell, Text):
        return translated(cell, language) if isinstance(cell, str) else cell
    ends = {end for span in cell.spans for end in (span.start, span.end)} - {0, len(cell)}
    made = Text(justify=cell.justify, style=cell.style)
    for part in cell.divide(sorted(ends)):
        made.append(translated(part.plain, language), part.spans[0].style if part.spans else None)
    return made
