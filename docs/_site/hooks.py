"""What MkDocs calls while it builds the site: code, results of cells and formulas are put into the pages.

A page may have these lines, indented as the text around them:

    {{ code graphslam/textbook.py virtual_motion_edge }}   the present source of functions or classes
    {{ cell NAME "alternative text" }}                     a cell's code, what it printed, and its figure
    {{ output NAME "alternative text" }}                   the same with the code folded
    {{ figure NAME "alternative text" }}                   only the figure, a slider if the cell drew several
    {{ ask NAME "what to write" }}                         fields for the numbers that a cell asks for, see `exercises`
    {{ live KIND LOG key=value "text" }}                   a figure that the reader moves, see `live`
    {{ slides }}                                           where the site explains each formula of the lectures

and the measured results of `measured`, also within a line.

The cells are described in `cells`. The alternative text describes the figure for readers who do not see it.
"""

from __future__ import annotations

import html
import json
import re
import shlex
import shutil
import sys
import tomllib
from importlib import import_module
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

import bundled
import cells
import exercises
import formulas
import labels
import listings
import literature
import live
import measured
import notebooks
import symbols
from mkdocs.exceptions import PluginError
from mkdocs.plugins import event_priority
from mkdocs.utils import get_relative_url

_MARKER = re.compile(r"^([ \t]*)\{\{ (code|cell|output|figure|ask|live|slides)(?: (.+?))? \}\}$", re.MULTILINE)
#: the words on the page, by language
WORDS = {
    "en": {
        "code": "Show the code",
        "slides": "| Section | Explained in | Function | Test |",
        "notebook": "This page as a notebook",
        "colab": "Open it in Colab",
    },
    "ja": {
        "code": "コードを表示",
        "slides": "| 節 | 説明 | 関数 | テスト |",
        "notebook": "このページのノートブック",
        "colab": "Colabで開く",
        "untranslated": "このページは英語版のみです",
    },
}
#: weights of pages in the search: a word in a chapter counts more than in the pages that name everything
BOOST = {"api/": 0.02, "json": 0.1, "index": 0.3, "method/": 2, "beyond/": 2, "tutorials/": 2, "own_robot": 2}
SEARCHED_WORDS = tomllib.loads((cells.DOCS / "_site" / "questions.toml").read_text())["words"]
#: the longest line of an output that fits beside the navigation [letters]
LONG = 80
#: what the index has of each section of the reference of names [characters]
SHOWN = 200
#: where the search divides text into words; Japanese, which has no spaces, also where the script changes and after each
#: kanji, but not before the star that the search itself adds
SEPARATOR = {
    "en": r"[\s\-,:!=\[\]()\"/]+|\.(?!\d)",
    "ja": r"[\s\-,:!=\[\]()\"/　、。，．・：「」（）]+|\.(?!\d)|(?<=[A-Za-z0-9])(?=[ぁ-んァ-ヴ一-龠])"
    r"|(?<=[ァ-ヴー])(?![ァ-ヴー*])|(?<=[一-龠々])(?!\*)|(?<=[ぁ-ん])(?![ぁ-ん*])",
}


class PageError(PluginError):
    """A page that cannot be made, with the reason."""


def on_pre_build(config: Any) -> None:
    """Run the cells of all pages, and write the page of JSON from the schema's classes."""
    sys.path.insert(0, str(cells.DOCS))
    text, page = import_module("make_json").page(), cells.DOCS / "json.md"
    if not page.exists() or page.read_text(encoding="utf-8") != text:
        page.write_text(text, encoding="utf-8")
    try:
        cells.run_all()
    except cells.CellError as error:
        raise PageError(str(error)) from None


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    """Replace the markers of a page."""
    language = "ja" if page.file.src_uri.endswith(".ja.md") else "en"
    source = cells.DOCS / re.sub(r"(\.ja)?\.md$", ".py", page.file.src_uri)
    boost = next((value for start, value in BOOST.items() if page.file.src_uri.startswith(start)), 1)
    words = SEARCHED_WORDS.get(re.sub(r"(\.ja)?\.md$", "", page.file.src_uri), "")
    # the record of experiments would be a tenth of the index, which every page loads
    search = {"exclude": True} if page.file.src_uri.startswith("decisions") else {"boost": boost}
    page.meta |= {"search": search, "tags": words.split()}

    def text(found: re.Match[str]) -> str:
        indent, kind, arguments = found[1], found[2], shlex.split(found[3] or "")
        if kind == "code":
            try:
                made = listings.listing(*arguments, language=language)
            except listings.ListingError as error:
                raise PageError(f"{page.file.src_uri}: {error}") from None
        elif kind == "live":
            try:
                made = live.figure(arguments)
            except live.LiveError as error:
                raise PageError(f"{page.file.src_uri}: {error}") from None
        elif kind == "slides":
            made = _slides(Path(page.file.src_uri).parent, language)
        else:
            made = _cell(kind, source, arguments, page, language)
        return "\n".join(indent + line if line else line for line in made.splitlines())

    try:
        markdown = measured.filled(markdown, page.file.src_uri, language)
    except measured.MeasuredError as error:
        raise PageError(str(error)) from None
    made = _MARKER.sub(text, cells.markers(markdown))
    if read := literature.section(re.sub(r"(\.ja)?\.md$", "", page.file.src_uri), language):
        made += f"\n\n{read}\n"
    if page.file.url.startswith("ja/") and language == "en":
        # below the title, which the navigation shows
        title, _, rest = made.partition("\n")
        made = f'{title}\n\n!!! note "{WORDS["ja"]["untranslated"]}"\n\n{rest}'
    if source.exists():
        url = get_relative_url(_notebook(source, language), page.file.url)
        links = f'<a href="{url}" download>{WORDS[language]["notebook"]}</a>'
        stored = [file for file, of, its in bundled.bundled() if (of, its) == (source, language)]
        if stored and notebooks.REPOSITORY:
            place = notebooks.REPOSITORY.removeprefix("https://github.com/") + "/blob/main/examples/" + stored[0].name
            links += f' · <a href="https://colab.research.google.com/github/{place}">{WORDS[language]["colab"]}</a>'
        made += f"\n\n<p>{links}</p>\n"
    return made


def on_page_content(html: str, page: Any, config: Any, files: Any) -> str:
    """Render the formulas of a page; load its pictures when they come into view; search its text, not its code.

    Every page loads the index of the search, which would be twice as large with the code.
    """
    try:
        language = "ja" if page.file.src_uri.endswith(".ja.md") else "en"
        name = re.sub(r"(\.ja)?\.md$", "", page.file.src_uri)
        made = formulas.replace(html, lambda formula: symbols.marked(formula, name))
        made += symbols.explained(
            name,
            made,
            language,
            lambda formula: formulas.render(formula, False),
            lambda place: _address(place, page, files, language),
        )
        made = re.sub(r"<img (?![^>]*loading=)", '<img loading="lazy" ', made)
        return re.sub(r'<(div|span) class="(?=[^"]*\bhighlight\b|formula")', r'<\1 data-search-exclude class="', made)
    except formulas.FormulaError as error:
        raise PageError(f"{page.file.src_uri}: {error}") from None


def _address(place: str, page: Any, files: Any, language: str) -> str:
    """The address of a page with an anchor, from another page in the same language."""
    name, _, anchor = place.partition("#")
    file = next(file for file in files if file.src_uri == (name.replace(".md", ".ja.md") if language == "ja" else name))
    return get_relative_url(file.url, page.file.url) + (f"#{anchor}" if anchor else "")


def on_post_page(output: str, page: Any, config: Any) -> str:
    """Let Japanese pages search the index in ``ja/``, which `on_post_build` writes, and take out links to translations.

    The theme takes each such link for the start of a site, and asks in vain for a sitemap below it. The sitemap has them.
    """
    output = re.sub(r'\s*<link rel="alternate" href="[^"]*" hreflang="[^"]*">', "", output)
    if page.file.url.startswith("ja/"):
        output = re.sub(r'("base": ")(?:\.\./|\.(?=\."))', r"\1", output, count=1)
    return output


@event_priority(-101)  # after the plugin of the languages, which writes the index last
def on_post_build(config: Any) -> None:
    """Copy figures and the engine into the site, write the notebooks, and give each language its index of the search."""
    live.copy_files(Path(config["site_dir"]))
    _split_index(Path(config["site_dir"]))
    for source in cells.sources():
        if cells.folder(source).exists():
            target = Path(config["site_dir"]) / _place(source)
            shutil.copytree(cells.folder(source), target, dirs_exist_ok=True, ignore=shutil.ignore_patterns("*.json"))
        for language in bundled.LANGUAGES:
            content = bundled.make(source, language, cells.results(source), cells.folder(source))
            notebooks.write(Path(config["site_dir"]) / _notebook(source, language), content)


def _split_index(site: Path) -> None:
    """Write the index of the search by language; pages without a translation are in both."""
    index = json.loads((site / "search" / "search_index.json").read_text())
    pages: dict[str, list[dict[str, str]]] = {"en": [], "ja": []}
    for section in index["docs"]:
        language = "ja" if section["location"].startswith("ja/") else "en"
        location, text = section["location"].removeprefix("ja/"), section["text"]
        # every page loads the index: names are found by their titles, so that the begin of what is said of them suffices
        if location.startswith(("api/", "json/")) and len(text) > SHOWN:
            text = text[:SHOWN].rsplit(" ", 1)[0] + " ..."
        pages[language].append({**section, "location": location, "text": text})
    translated = {section["location"].split("#")[0] for section in pages["ja"]}
    pages["ja"] += [section for section in pages["en"] if section["location"].split("#")[0] not in translated]
    for language, place in (("en", site), ("ja", site / "ja")):
        languages = ["en"] if language == "en" else ["en", "ja"]
        made = {
            "config": {**index["config"], "lang": languages, "separator": SEPARATOR[language]},
            "docs": pages[language],
        }
        (place / "search").mkdir(parents=True, exist_ok=True)
        (place / "search" / "search_index.json").write_text(json.dumps(made, ensure_ascii=False, separators=(",", ":")))


def _notebook(source: Path, language: str) -> str:
    return f"notebooks/{source.relative_to(cells.DOCS).with_suffix('').as_posix()}.{language}.ipynb"


def _place(source: Path) -> str:
    return f"figures/{source.relative_to(cells.DOCS).with_suffix('').as_posix()}"


def _slides(folder: Path, language: str) -> str:
    """Return the table of the lectures' formulas: section, heading of the page, function, test."""
    rows = [WORDS[language]["slides"], "|---|---|---|---|"]
    for slide in tomllib.loads((cells.DOCS / "_site" / "slides.toml").read_text())["slide"]:
        page = slide["page"].replace(".md", ".ja.md") if language == "ja" else slide["page"]
        text = (cells.DOCS / page).read_text()
        heading = re.search(rf"^#+ (.*?) \{{#{slide['anchor']}\}}$", text, re.MULTILINE)
        if not heading:
            raise PageError(f"{page} has no heading with the id {slide['anchor']!r}, which slides.toml names")
        title = re.match(r"# (.*)", text)
        link = f"{Path(slide['page']).relative_to(folder).as_posix()}#{slide['anchor']}"
        where = f"{title[1] if title else ''}: [{heading[1]}]({link})"
        rows.append(f"| {slide['section']} | {where} | `{slide['function'].split()[-1]}` | `tests/{slide['test']}` |")
    return "\n".join(rows)


def _cell(kind: str, source: Path, arguments: list[str], page: Any, language: str) -> str:
    """Return a cell as the marker asks for it."""
    name, alternative = arguments[0], arguments[1] if len(arguments) > 1 else ""
    results = cells.results(source)
    if name not in results:
        raise PageError(f"{page.file.src_uri}: {source.name} has no cell {name!r}; it has {', '.join(results)}")
    cell = results[name]
    if kind == "ask":
        if cell.question is None:
            if cells.HURRIED:
                return ""
            raise PageError(f"{page.file.src_uri}: the cell {name!r} asks nothing")
        return exercises.form(cell.question, alternative, language)
    if cell.figures and not alternative:
        raise PageError(f"{page.file.src_uri}: the figure of cell {name!r} needs an alternative text")
    made, code = [], ["```python", *exercises.shown(cell.code).splitlines(), "```", ""]
    if kind == "cell":
        made += code
    if kind != "figure" and cell.output:
        lines = cell.output.rstrip().splitlines()
        made += ["```{ .text .wrapped }" if _wraps(lines) else "```text", *lines, "```", ""]
    if cell.figures:
        made += [_figures(cell, source, alternative, page, language), ""]
    if kind != "cell":
        made += [f'??? note "{WORDS[language]["code"]}"', "", *(f"    {line}" for line in code)]
    return "\n".join(made)


def _wraps(lines: list[str]) -> bool:
    """Whether an output has lines that are too long for the page, and no columns."""
    return max(map(len, lines), default=0) > LONG and not any(re.search(r"\S {2,}\S", line) for line in lines)


def _figures(cell: cells.Cell, source: Path, alternative: str, page: Any, language: str) -> str:
    alternative = html.escape(alternative, quote=True)
    files = [file for _, file in cell.figures]
    if language == "ja":
        japanese = [str(Path(file).with_suffix(f".ja{Path(file).suffix}")) for file in files]
        # without a font with Japanese letters there are no such PNG figures
        files = [each if (cells.folder(source) / each).exists() else file for each, file in zip(japanese, files)]
    urls = [get_relative_url(f"{_place(source)}/{file}", page.file.url) for file in files]
    if len(urls) == 1:
        return f'<figure class="drawn"><img src="{urls[0]}" alt="{alternative}" loading="lazy"></figure>'
    named = [html.escape((language == "ja" and labels.translated(label)) or label) for label, _ in cell.figures]
    images = "".join(
        f'<img src="{url}" alt="{alternative} ({label})" data-label="{label}" loading="lazy">'
        for url, label in zip(urls, named, strict=True)
    )
    return f'<figure class="drawn slider">{images}<figcaption>{named[0]} – {named[-1]}</figcaption></figure>'
