"""The sources of the site: every formula of the lectures has its place, and both languages have the same content."""

import ast
import re
import sys
import tomllib
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
sys.path.insert(0, str(DOCS / "_site"))
SLIDES = tomllib.loads((DOCS / "_site" / "slides.toml").read_text())["slide"]
FORMULAS = tomllib.loads((DOCS / "_site" / "formulas.toml").read_text())
LECTURES = ROOT.parent / "shared" / "slides"
PAGES = sorted(
    page
    for folder in ("method", "beyond", "tutorials")
    for page in (DOCS / folder).rglob("*.md")
    if not page.name.endswith(".ja.md")
)
#: pages of which both languages exist, besides those above
TRANSLATED = [
    DOCS / f"{name}.md"
    for name in (
        "index",
        "gallery",
        "films",
        "sample_log",
        "command-line",
        "extending",
        "own_robot",
        "configuration",
        "online",
        "studies",
        "results",
        "maps",
        "sessions",
        "other_sensors",
        "unknown_robot",
    )
]
MARKER = re.compile(r"^[ \t]*\{\{ (code|cell|output|figure|ask|live) (.+?) \}\}$", re.MULTILINE)


def markers(page: Path) -> list[tuple[str, ...]]:
    """The markers of a page, without the alternative texts, which are translated."""
    text = import_module("cells").markers(page.read_text())
    return [(kind, re.sub(r' "[^"]*"$', "", arguments)) for kind, arguments in MARKER.findall(text)]


def section_of(name: str, anchor: str) -> str:
    """The text below the heading with an id, up to the next heading."""
    text = (DOCS / name).read_text()
    found = re.search(rf"^#+ .*\{{ ?#{anchor} ?\}}\n(.*?)(?=^#+ |\Z)", text, re.MULTILINE | re.DOTALL)
    assert found, f"{name} has no heading {{#{anchor}}}"
    return found[1]


@pytest.mark.parametrize("lecture", FORMULAS)
def test_every_formula_stands_below_its_heading(lecture):
    explained = {(slide["page"], slide["anchor"]) for slide in SLIDES}
    for number, formulas in FORMULAS[lecture].items():
        for place, formula in formulas:
            page, anchor = place.split("#")
            # slides.toml names the code and the test for each of these headings
            assert (page, anchor) in explained
            for name in (page, page.replace(".md", ".ja.md")):
                assert formula in " ".join(section_of(name, anchor).split()), f"slide {number}: {formula}"


@pytest.mark.skipif(not LECTURES.exists(), reason="needs the slides of the lectures in ../shared/slides")
@pytest.mark.parametrize("lecture", FORMULAS)
def test_no_formula_of_a_slide_is_missing(lecture):
    for number, slide in enumerate(re.split(r"\n---\n", (LECTURES / lecture).read_text())):
        found = [a or b for a, b in re.findall(r"\$\$(.+?)\$\$|\$(.+?)\$", slide, re.DOTALL) if "newcommand" not in a]
        # a statement has a relation; names such as $x_t$ and the single sign in a sentence are no formulas
        statements = [f for f in found if re.search(r"=|\\approx|\\sim|\\mathcal\{N\}", f) and len(f.strip()) > 1]
        assert len(FORMULAS[lecture].get(str(number), [])) >= len(statements), f"slide {number}: {statements}"


@pytest.mark.parametrize("slide", SLIDES, ids=[f"{slide['section']}-{slide['anchor']}" for slide in SLIDES])
def test_every_formula_of_the_slides_is_on_a_page(slide):
    where, _, function = slide["function"].rpartition(" ")
    lecture = "graphslam" if "/graph/" in slide["page"] else "fastslam"
    shown = f"{where or lecture + '/textbook.py'}", function
    for name in (slide["page"], slide["page"].replace(".md", ".ja.md")):
        section = section_of(name, slide["anchor"])
        assert "$" in section or "{{" in section
        assert any(
            kind == "code" and shown[0] in what and shown[1] in what.split() for kind, what in markers(DOCS / name)
        )
        assert any(kind in ("cell", "output", "figure") for kind, _ in markers(DOCS / name))
    assert (ROOT / "tests" / slide["test"]).exists()


@pytest.mark.parametrize("page", [*PAGES, *TRANSLATED], ids=lambda page: str(page.relative_to(DOCS)))
def test_both_languages_have_the_same_content(page):
    translation = page.with_name(page.name.replace(".md", ".ja.md"))
    assert translation.exists()
    assert markers(translation) == markers(page)
    formulas = [len(re.findall(r"^\$\$$", path.read_text(), re.MULTILINE)) for path in (page, translation)]
    assert formulas[0] == formulas[1]
    headings = [len(re.findall(r"^#+ ", path.read_text(), re.MULTILINE)) for path in (page, translation)]
    assert headings[0] == headings[1]


@pytest.mark.parametrize(
    "page",
    [page for page in PAGES if page.parent.name in ("graph", "fastslam", "beyond") and page.stem != "index"],
    ids=lambda page: page.stem,
)
def test_chapters_have_two_exercises_that_answer_with_solutions_that_run(page):
    text = page.read_text()
    exercises = re.split(r"^\?\?\? question ", text, flags=re.MULTILINE)[1:]
    assert len(exercises) >= 2
    for exercise in exercises:
        assert '??? success "' in exercise
        assert re.search(r"\{\{ (cell|output) ", exercise)
    asked = [arguments for kind, arguments in markers(page) if kind == "ask"]
    assert len(asked) >= 2
    source = page.with_suffix(".py").read_text()
    code = import_module("cells").split(source)
    assert all(re.search(r"^ask\(", code[name], re.MULTILINE) and "assert" in code[name] for name in asked)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(DOCS)))
def test_the_code_that_a_page_shows_exists(page):
    listings = import_module("listings")
    for kind, arguments in markers(page):
        if kind == "code":
            assert listings.listing(*arguments.split(), language="en")


@pytest.mark.parametrize("path", ["graphslam/textbook.py", "fastslam/textbook.py"])
def test_the_textbook_programs_have_japanese_docstrings(path):
    listings = import_module("listings")
    tree = ast.parse((ROOT / path).read_text())
    inside = [(each, node) for each in tree.body if isinstance(each, ast.ClassDef) for node in each.body]
    nodes = {node.name: node for node in tree.body if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    nodes |= {f"{each.name}.{node.name}": node for each, node in inside if isinstance(node, ast.FunctionDef)}
    explained = {name for name, node in nodes.items() if ast.get_docstring(node)}
    assert set(listings.docstrings()[path]) == explained
    for name in explained:
        english, japanese = ast.get_docstring(nodes[name]), listings.docstrings()[path][name]
        # the same equations: each product and each number of the slides stands in both
        for part in re.findall(r"[A-Z]\w*' [A-Z]\w*(?:\^-1)?|h\^-1\(\w+, \w+\)|\(T\+1,[ 3]*\)", english):
            assert part in japanese, (name, part)
        if "." not in name:
            shown = listings.listing(path, name, language="ja")
            assert japanese.strip().splitlines()[0] in shown
            code = shown.split("\n", 1)[1].rsplit("```", 1)[0]
            plain = listings.listing(path, name, language="en").split("\n", 1)[1].rsplit("```", 1)[0]
            assert same_program(code) == same_program(plain)


def same_program(code):
    """The program without docstrings and comments."""
    tree = ast.parse(code)
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and ast.get_docstring(node):
            node.body[0].value = ast.Constant("")
    return ast.dump(tree)


@pytest.mark.parametrize("package", ["graphslam", "graphslam.factors", "fastslam", "comparisons"])
def test_every_public_name_is_on_a_page_of_the_python_interface(package):
    pages = [
        DOCS / "api" / f"{package.split('.')[-1]}.md",
        *([DOCS / "api" / "modules.md"] if package == "graphslam" else []),
    ]
    text = "".join(page.read_text() for page in pages)
    shown = re.findall(rf"^::: {package}\.(\w+)$", text, re.MULTILINE)
    modules = {name for name in shown if isinstance(getattr(import_module(package), name), ModuleType)}
    assert sorted({*shown} - modules) == sorted(import_module(package).__all__)
    for module, name in re.findall(rf"^::: ({package}(?:\.[a-z]\w*)+)\.(\w+)$", text, re.MULTILINE):
        assert hasattr(import_module(module), name), f"{module}.{name}"


def test_the_public_names_fit_on_a_screen():
    assert len(import_module("graphslam").__all__) <= 40


def test_stored_pictures_are_small():
    for picture in (DOCS / "img").iterdir():
        assert picture.stat().st_size < (1_000_000 if picture.suffix == ".gif" else 400_000), picture.name


def test_every_page_is_in_the_navigation():
    listed = set(re.findall(r"([\w/-]+\.md)$", (ROOT / "mkdocs.yml").read_text(), re.MULTILINE))
    pages = {str(page.relative_to(DOCS)) for page in DOCS.rglob("*.md") if not page.name.endswith(".ja.md")}
    assert pages - listed == {"_site/README.md"}


def test_only_pages_without_translation_are_called_english():
    called = []
    for page in [ROOT / "README.ja.md", *DOCS.rglob("*.ja.md")]:
        for target in re.findall(r"\]\(([\w./-]+)\.md[^)]*\)[^\[。]{0,30}英語", page.read_text()):
            if (page.parent / f"{target.removesuffix('.ja')}.ja.md").exists():
                called.append((page.name, target))
    assert called == []


FORMULA = re.compile(r"\$\$(.+?)\$\$|\$([^$\n]+?)\$", re.DOTALL)
CHAPTERS = [page for page in PAGES if page.parent.name in ("graph", "fastslam", "beyond") and page.stem != "index"]


def test_symbols_are_marked_and_nothing_else_changes():
    symbols, used = import_module("symbols"), set()
    for page in CHAPTERS:
        name = str(page.relative_to(DOCS)).removesuffix(".md")
        for path in (page, page.with_suffix(".ja.md")):
            for found in FORMULA.finditer(re.sub(r"`[^`]*`", "", path.read_text())):
                formula = found[1] or found[2]
                marked = symbols.marked(formula, name)
                used |= {int(number) for number in re.findall(r"sym=(\d+)", marked)}
                plain = re.sub(r"\\htmlData\{sym=\d+\}", "", marked)
                assert re.sub("[{}]", "", plain) == re.sub("[{}]", "", formula)
    assert used == set(range(len(symbols.table())))


def test_bold_symbols_of_chapters_are_explained():
    symbols, missing = import_module("symbols"), []
    # named where they stand, or a part of another symbol
    others = {r"\V{0}", r"\V{a}", r"\V{b}", r"\V{d}", r"\V{t}", r"\V{y}", r"\textbf{e}", r"\textbf{x}"}
    for page in CHAPTERS:
        name = str(page.relative_to(DOCS)).removesuffix(".md")
        used = set(re.findall(r"\\V\{\w\}|\\textbf\{\w\}", page.read_text())) - others
        missing += [(name, symbol) for symbol in used if not any(symbol in head for head, _ in symbols.heads(name))]
    assert missing == []


@pytest.mark.parametrize("entry", import_module("symbols").table(), ids=lambda entry: entry["latex"][0])
def test_symbols_have_a_meaning_in_both_languages_and_a_place(entry):
    assert entry["en"]
    assert entry["ja"]
    page, _, anchor = entry["where"].partition("#")
    for name in (f"{page}.md", f"{page}.ja.md"):
        assert not anchor or section_of(name, anchor)
        assert (DOCS / name).exists()


def test_each_chapter_ends_with_literature():
    literature = import_module("literature")
    assert set(literature.chapters()) == {str(page.relative_to(DOCS)).removesuffix(".md") for page in CHAPTERS}
    listed = [name for chapter in literature.chapters().values() for name in chapter["papers"]]
    assert set(listed) == set(literature.papers())
    for page in literature.chapters():
        for language in ("en", "ja"):
            text = literature.section(page, language)
            assert text.startswith("## ") and len(text.splitlines()) >= 4
