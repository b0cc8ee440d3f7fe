"""Tables, messages and reports in Japanese: every template has a translation, and what is shown is translated as a whole."""

from __future__ import annotations

import ast
import inspect
import io
import json
import re
import sys
import textwrap
import tomllib
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, partial
from importlib import import_module
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from matplotlib.text import Text
from typer import rich_utils
from typer.testing import CliRunner

from comparisons import animate, comparison, run, write_report
from comparisons.cli import VERBS, app, make_app
from comparisons.cli.output import language_of_words
from comparisons.cli.verb import name_of
from comparisons.estimators import filters
from comparisons.results import files as result_files
from comparisons.show import canvas, log_tables, studies, tables
from comparisons.show import report as page
from comparisons.show.language import NUMBER, PLACE, VERBATIM, _translated, catalogue, key_of, language_of, translated
from comparisons.show.report import charts
from fastslam import associate
from graphslam import OptionError, simulate
from graphslam.graph import build, defaults
from graphslam.identification.result import RobotEstimate
from graphslam.identification.sighting_errors import Ids
from graphslam.log import UNIDENTIFIED, cells, geometry, streams
from graphslam.log_checks import given, ids, readings
from graphslam.maps import parts, tracking

#: the module, whose package has a function of the same name
verbs = import_module("comparisons.cli.run")
ROOT = Path(__file__).parents[2]
JAPANESE = re.compile("[\u3040-\u30ff\u4e00-\u9fff]")
#: what makes the sentences of `run` and of its report
SOURCES: tuple[Callable[..., Any], ...] = (
    tables.result_tables, tables.comparison_tables, tables.session_table, tables.state_table, tables.landmark_table,
    tables._exchanged, tables._noise_remarks, verbs.run, verbs.report, verbs._noise_advice,
    comparison.Comparison._noise_findings, comparison.Comparison._unused_options,
    result_files.write_pose_graph, filters._one_run, filters.of_several_seeds,
    build._tied_steps, tracking.in_frame_of, parts.Part.sentence.fget, page._map_note,
    page._error_texts, page._unless_failed, page._matrix,
    charts.remarks, charts.description, page.association_table, defaults.pairs_overweight,
    RobotEstimate.sentences.fget, RobotEstimate.remarks.fget, Ids.reflections.fget,
    studies.solver_tables, studies.backend_tables,
    log_tables.import_tables, log_tables.overview_tables, log_tables.evaluation_tables, studies.particle_tables,
    studies.consistency_tables, studies.summary_tables, log_tables.survey_tables, log_tables.calibration_tables,
    readings.readings_of, readings.SightingPairs._others, readings.SightingPairs._clocks, readings._direction, readings.sizes,
    readings.single_pose,
    cells.nothing_measured, given.against_truth, given._headings, given.against_map, ids.misread_ids, ids.ids_of,
    ids.changed_ids, cells.repeated_times, geometry.sideways_poses, geometry.sideways_speed, cells.repeated_sightings,
    streams._why_few, readings.orientations_of,
)  # fmt: skip
#: strings of these functions that are no sentences
NO_SENTENCES = {
    "bold red",
    "not bold default",
    "a log and a file to write: slam-compare report LOG OUT.html",
    "too little noise",
    "wrong sightings",
    "unused option",
    # names of checks
    "turn rate unit",
    "bearing unit",
    "odometry swapped",
    "bearing sign",
    "axes swapped",
    "sensor direction",
    "fixed axes",
    "moved between logs",
    "time unit",
    "speed unit",
    "range unit",
    "no motion",
    "odometry noise",
    "range limit",
    "range without measurement",
    "truth scale",
    "truth mirrored",
    "truth sign",
    "truth heading",
    "map ids",
    "map mirrored",
    "misread ids",
    "seen once",
    "one landmark",
    "ids jump",
    "doubled sightings",
    "duplicate ids",
    "ids change",
    "{} repeats",
    # parts that are put together, whose wholes `test_warnings_of_a_log` translates
    "{} (clocks='sightings={}')",
    "the clock of the sightings is about {} s {}",
    "sensor_yaw={}",
    "the sensor looks {}{} degrees to the {} ({})",
    "{} (of {}) with the time",
    "{} (of {}) with the time, id and numbers of another row",
    "the odometry turns the other way than the truth; one of them has the wrong sign{}",
    "{} and numbers of the row before: the rows were probably written twice, or two files joined",
    "{} of the row before and other numbers: the times were probably rounded{}, and one row per time is used",
    "the times were probably rounded{}, ids were misread, or several objects have one id",
}


def strings_of(function: Callable[..., Any]) -> Iterator[str]:
    """The strings with a space of a function, those with values as templates, but not its docstring and its errors."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(function))).body[0]
    assert isinstance(tree, ast.FunctionDef)
    waiting: list[ast.AST] = list(tree.body[1:] if ast.get_docstring(tree) else tree.body)
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.JoinedStr):
            parts = [v.value if isinstance(v, ast.Constant) else PLACE for v in node.values]
            text = "".join(map(str, parts))
            waiting += [v.value for v in node.values if isinstance(v, ast.FormattedValue)]
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            text = node.value
        else:
            # annotations hold the help of options
            waiting += [] if isinstance(node, (ast.Raise, ast.arguments)) else list(ast.iter_child_nodes(node))
            continue
        if " " in text.strip() and len(re.findall("[a-zA-Z]", text)) > 4:
            yield text


@pytest.mark.parametrize("function", SOURCES, ids=lambda f: f.__name__)
def test_each_template_has_a_translation(function: Callable[..., Any]) -> None:
    keys = [template.replace(NUMBER, PLACE).replace(VERBATIM, PLACE) for template in catalogue("ja")]
    missing = {
        text
        for text in strings_of(function)
        if text not in NO_SENTENCES
        and _translated(text.replace(PLACE, "7"), "ja")[1] < 0.7 * len(key_of(text.replace(PLACE, "7")))
        # a part of a template
        and not any(key_of(text) in key for key in keys)
    }
    assert missing == set()


#: parts of templates that are put together when they are shown
PUT_TOGETHER = {
    "either odometry missed a motion between steps",
    "shares only one with the rest", "share only one with the rest", "time %", "norm %", "speed x", "turn rate x",
    "range x", "start J =", "sightings are from before or after the odometry",
    "and they fit each other better with the map at",
    "there is no noise.toml", "and these are", "no column for id",
    "the time goes back by", "and no fixed transform in TF leads from there to",
    "another map that was tried is less likely by a factor of", "degrees to the left", "degrees to the right",
    "the sensor looks about", "the times were probably rounded to seconds", "with the time and numbers of the row before",
    "with the time of the row before and other numbers", "the truth covers no pose",
    "but maximum-likelihood where a log has no ids", "a log and a file to write", "give at most a log and a file to write",
    "or at least", "has no sightings at all within max_range",
    "further return is ambiguous by a factor of", "further returns are ambiguous by a factor of",
    "alternatives that had not settled when they were compared", "but were not tried because of the limit on tries",
    "weight='marginal' has no effect", "does not use the partial sightings of the log",
    "does not use the positions of the log", "does not use the relations of the log",
    "does not use the relations and positions of the log", "times that of the file in the distance",
    "times that of the file in the heading", "times that of the file in the distance and",
}  # fmt: skip


@pytest.mark.slow
def test_no_template_is_stale() -> None:
    """Each template of the catalogue, between its places and sentences, is a text of the source."""
    spaces, texts = re.compile(r"\s+"), []
    for path in (path for package in ("graphslam", "fastslam", "comparisons") for path in (ROOT / package).rglob("*")):
        if path.suffix == ".py":
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.JoinedStr):
                    texts.append("".join(v.value if isinstance(v, ast.Constant) else PLACE for v in node.values))  # type: ignore[misc]
                elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                    texts.append(node.value)
        elif path.suffix in (".html", ".js"):
            texts.append(path.read_text(encoding="utf-8"))
    source = spaces.sub(" ", "\n".join(texts)).lower()
    stale = []
    for part in sorted((ROOT / "comparisons" / "show" / "japanese").iterdir()):
        groups = tomllib.loads(part.read_text(encoding="utf-8"))
        for template in (t for name, group in groups.items() if name not in ("typer", "system") for t in group):
            pieces = (p.strip(" .,:;()") for p in re.split(r"\{[#=]?\}|[.;:,] |[()]", spaces.sub(" ", template)))
            stale += [(template, p) for p in pieces if len(p) > 2 and p.lower() not in source and p not in PUT_TOGETHER]
    assert not stale, "\n".join(map(str, stale))


def test_no_template_is_there_twice() -> None:
    parts = (ROOT / "comparisons" / "show" / "japanese").iterdir()
    groups = [group for part in parts for group in tomllib.loads(part.read_text(encoding="utf-8")).values()]
    keys = [key_of(template) for group in groups for template in group]
    assert [key for key in set(keys) if keys.count(key) > 1] == []


@cache
def app_in(language: str) -> typer.Typer:
    """The command line, made once."""
    return make_app(language=language)


def shown_help(*words: str) -> str:
    """What --help shows of a verb, without the frames of its panels and line breaks."""
    result = CliRunner().invoke(app_in("ja"), [*words, "--help"], env={"COLUMNS": "2000"}, obj="ja")
    assert result.exit_code == 0, result.output
    return str(result.stdout)


@pytest.mark.slow
@pytest.mark.parametrize("language", ["en", "ja"])
def test_names_of_options_of_run_are_whole_at_80_columns(language: str) -> None:
    wide, narrow = (
        CliRunner().invoke(app_in(language), ["run", "--help"], env={"COLUMNS": width}, obj=language).stdout
        for width in ("2000", "80")
    )
    names = re.findall(r"^│ +(--[a-z-]+)", wide, re.MULTILINE)
    assert len(names) > 50
    assert [name for name in names if not re.search(rf"│ {name}[ ,]", narrow)] == []


@pytest.mark.slow
@pytest.mark.parametrize("verb", ["", *(name_of(verb) for verb in VERBS)])
def test_help_is_japanese(verb: str) -> None:
    lines = [line.strip(" │") for line in shown_help(*verb.split()).splitlines()]
    examples = lines.index("例:")
    described = [line for line in lines[:examples] if len(line.split()) > 2 and "使い方:" not in line]
    assert len(described) > 5
    assert [line for line in described if not JAPANESE.search(line) and not line.startswith(("╭", "╰"))] == []
    # no sentence is English in part: three words in a row without a letter of Japanese
    english = re.compile(r"(?<![\w./-])[A-Za-z]?[a-z]+ [a-z]{2,} [a-z]{2,}(?![\w./-])")
    assert [line for line in described if english.search(line)] == []


def test_what_the_parser_says_is_japanese() -> None:
    def said(*words: str) -> str:
        result = CliRunner().invoke(app_in("ja"), words, obj="ja")
        assert result.exit_code == 2
        return " ".join(result.stderr.split())

    assert "エラー" in said("run", "--foo") and "--foo というオプションはありません" in said("run", "--foo")
    assert "'rn' というコマンドはありません" in said("rn")
    assert "引数 '[LOG] OUT.html' を指定してください" in said("report")
    assert "'--particles' の値が正しくありません" in said("run", "--particles", "x")
    assert "余分な引数があります" in said("datasets", "x")
    # the fixed texts of Typer are put back
    assert rich_utils.ERRORS_PANEL_TITLE == "Error"


@pytest.mark.parametrize(
    ("words", "language"),
    [
        (["run", "--lang", "ja"], "ja"), (["--lang=ja", "run"], "ja"), (["run", "--lang", "fr"], "en"),
        (["run", "--lang"], "en"), ([], "en"),
    ],
)  # fmt: skip
def test_the_language_is_known_before_the_words_are_parsed(
    words: list[str], language: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("LC_ALL", "LC_MESSAGES", "LANG"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(io.BytesIO(), encoding="utf-8"))
    assert language_of_words(words) == language
    # a stream without the letters of the language
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(io.BytesIO(), encoding="ascii"))
    assert language_of_words(words) == "en"


@pytest.mark.parametrize(
    ("message", "japanese"),
    [
        ("particles must be at least 1, not 0", "particlesは1以上にしてください（指定された値は0）"),
        (
            "kernel must be one of none, huber, not 'hubr'; did you mean 'huber'?",
            "kernelはnone, huberのどれかにしてください（指定された値は'hubr'）。'huber'のことですか？",
        ),
        ("a.txt: there is no such file", "a.txt: そのファイルはありません"),
        ("b/u.csv:3: 'omega' should be a number, not 'x'", "b/u.csv:3: 'omega'は数にしてください（値は'x'）"),
        # names stay as they are, though tables translate some of these words
        (
            "n.toml:1: unknown key 'a'; known are motion, odometry, sightings",
            "n.toml:1: 'a'というキーはありません。キーはmotion, odometry, sightingsです",
        ),
    ],
)
def test_frequent_errors_are_japanese(message: str, japanese: str) -> None:
    assert translated(message, "ja") == japanese


def test_a_sentence_is_not_translated_by_half() -> None:
    for text in (
        "error: log.txt: nothing of this kind was expected here",
        "graph failed: the reason is not in the catalogue",
        "Wrote a file with words of its own into out/",
    ):
        assert translated(text, "ja") == text


def test_figures_are_japanese_where_a_font_has_the_letters(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = run(simulate(seed=2, steps=24, clean=True), estimators=["graph"])
    monkeypatch.setattr(canvas, "font_of", lambda language: "DejaVu Sans" if language == "ja" else None)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph", UserWarning)
        found.save_figure([tmp_path / "en.svg"])
        found.save_figure([tmp_path / "ja.svg"], language="ja")
    texts = {
        # each text is drawn as curves, with a comment that has it
        name: set(re.findall("<!-- (.+?) -->", (tmp_path / f"{name}.svg").read_text()))
        for name in ("en", "ja")
    }
    assert not any(JAPANESE.search(text) for text in texts["en"])
    assert {"真値", "センサ値", "位置の誤差 [m]", "(b) 各姿勢の位置の誤差"} <= texts["ja"]
    kept = {text for text in texts["ja"] if re.search("[a-z]{2,}", text) and not JAPANESE.search(text)}
    assert kept <= {"graph (pairs)", "graph"}


def test_font_of_last_resort_is_no_font() -> None:
    """It has a box for each script, as wide as a letter, and comes with matplotlib."""
    for font in canvas.fontManager.ttflist:
        if font.name.startswith(("Last Resort", "DejaVu Sans")):
            assert not canvas._has(font.fname, canvas._LETTERS["ja"])


@pytest.mark.slow
@pytest.mark.skipif(canvas.font_of("ja") is None, reason="needs a font with Japanese letters")
def test_the_font_has_the_letters(tmp_path: Path) -> None:
    found = run(simulate(seed=2, steps=24, clean=True), estimators=["graph"])
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # of a letter that no font has
        for suffix in ("png", "pdf", "svg"):
            figure = found.figure()
            canvas.translate_texts(figure, partial(translated, language="ja"), str(canvas.font_of("ja")))
            figure.savefig(tmp_path / f"figure.{suffix}")


def test_without_a_font_figures_are_english_and_say_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(canvas, "font_of", lambda _: None)
    monkeypatch.setenv("COLUMNS", "500")
    shown = output("show", "--figure", str(tmp_path / "a.png"), "--lang", "ja")
    assert "日本語のフォントがないので、図は英語です" in shown


@pytest.mark.slow
@pytest.mark.parametrize("estimator", ["graph", "fastslam1", "isam2", "particle-gibbs"])
def test_animations_are_japanese(estimator: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("comparisons.show.canvas.font_of", lambda _: "DejaVu Sans")
    few: dict[str, Any] = {"gibbs_iterations": 3, "gibbs_warm_up": 1, "gibbs_particles": 5, "gibbs_chains": 1}
    film = animate(
        simulate(seed=2, steps=12, clean=True), estimator=estimator, particles=10, **few if "gibbs" in estimator else {}
    )
    film = replace(film, language="ja")
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph", UserWarning)
        film.pictures[len(film) - 1]
    texts = [text.get_text() for text in film.pictures._canvas.figure.findobj(Text)]
    words = [text for text in texts if re.search("[A-Za-z]{3}", re.sub(r"\$.*?\$", "", text))]
    names = {"graph", "isam2"}
    assert {text for text in words if not JAPANESE.search(text)} <= names
    assert len([text for text in texts if JAPANESE.search(text)]) >= 6


def test_translations_use_the_places_of_their_templates() -> None:
    for template, translation in catalogue("ja").items():
        used, places = (
            re.findall(r"\{(\d*)\}", translation),
            template.replace(NUMBER, PLACE).replace(VERBATIM, PLACE).count(PLACE),
        )
        assert len(set(used) - {""}) == len([u for u in used if u]), template
        assert not ("" in used and set(used) != {""}), template
        assert len(used) <= places, template
        assert all(int(u) < places for u in used if u), template


def test_a_sentence_is_found_by_its_template() -> None:
    text = "graph and gtsam differ by at most 2.1e-12 in any x, y [m] or heading [rad]."
    assert translated(text, "ja") == "graphとgtsamの差は、x、y [m]、向き [rad] のどれも2.1e-12以下です。"
    assert translated(text, "en") == text
    # values change their places, and are translated themselves; names before a sentence stay
    assert translated("graph: no edge comes from landmarks 3 and 4, seen in one step only.", "ja") == (
        "graph: ランドマーク3と4は1つの時刻でしか観測されていないので、エッジになりません。"
    )
    assert "姿勢" in translated("graph, online, gtsam: the first pose was found in the map: 9 sightings agree.", "ja")
    no_file = (
        "There is no graph.g2o: MarginalEdges are no sum of edges between two nodes; use --weight pairs or tempered."
    )
    assert translated(no_file, "ja").startswith("graph.g2oはありません: MarginalEdgesは")
    assert translated("The errors are those of the 5 of 9 poses that the ground truth covers.", "ja") == (
        "誤差は、9個の姿勢のうち、真値のある5個のものです。"
    )
    # a message without a translation appears in English
    assert translated("Nothing like this is in the catalogue.", "ja") == "Nothing like this is in the catalogue."


def test_the_language_is_that_of_the_option_or_of_the_environment() -> None:
    assert language_of("ja", {"LANG": "en_US.UTF-8"}) == "ja"
    assert language_of(None, {"LANG": "ja_JP.UTF-8"}) == "ja"
    assert language_of(None, {"LC_ALL": "C.UTF-8", "LANG": "ja_JP.UTF-8"}) == "en"
    assert language_of(None, {"LC_ALL": "", "LANG": "fr_FR.UTF-8"}) == "en"
    assert language_of(None, {}) == "en"
    with pytest.raises(OptionError, match="lang must be one of en, ja, not 'fr'"):
        language_of("fr", {})


def output(*words: str, **environment: str) -> str:
    result = CliRunner().invoke(app, list(words), env=environment)
    assert result.exit_code == 0, result.output
    return str(result.stdout)


@pytest.mark.slow
def test_run_speaks_japanese_and_writes_the_same_numbers(tmp_path: Path) -> None:
    words = ["run", "--estimators", "dead-reckoning,graph,gtsam,fastslam1", "--particles", "10", "--seed", "1"]
    words += ["--figures", "png", "--out", str(tmp_path / "out")]
    english, japanese = (
        output(*words, "--json", str(tmp_path / f"{lang}.json"), "--lang", lang) for lang in ("en", "ja")
    )
    assert not JAPANESE.search(english)
    numbers_alone = ("─", "dead-reckoning ", "fastslam1 ")
    rows = [line for line in japanese.splitlines() if line and not line.startswith(numbers_alone)]
    assert [line for line in rows if not JAPANESE.search(line)] == []
    assert "姿勢" in japanese and "警告" not in japanese
    numbers = [json.loads((tmp_path / f"{lang}.json").read_text())["estimators"] for lang in ("en", "ja")]
    assert [each["poses"] for each in numbers[0]] == [each["poses"] for each in numbers[1]]
    assert output("show", LC_ALL="ja_JP.UTF-8") != output("show", LC_ALL="C.UTF-8")


def test_an_error_speaks_japanese() -> None:
    result = CliRunner().invoke(app, ["run", "--estimators", "grph", "--lang", "ja"])
    assert result.exit_code == 2
    assert result.stderr.startswith("エラー: estimators: 推定器 'grph' はありません。'graph' のことですか？")
    result = CliRunner().invoke(app, ["run", "--lang", "fr"])
    assert result.exit_code == 2
    assert "lang must be one of en, ja" in result.stderr


def test_the_report_is_japanese(tmp_path: Path) -> None:
    script = files("comparisons.show.report").joinpath("page.js").read_text()
    templates = set(re.findall(r'say\("([^"]+)"', script))
    assert len(templates) > 10
    assert templates <= set(catalogue("ja"))
    html = files("comparisons.show.report").joinpath("page.html").read_text()
    texts = {key_of(text) for text in page._TEXTS.findall(html)}
    names = {text for text in texts if not text.startswith("$") and not re.fullmatch(r"[xyσθ]+ \[(m|rad)\]", text)}
    assert {text for text in names if not JAPANESE.search(translated(text.replace("$title", "7"), "ja"))} == set()

    found = run(simulate(seed=2, steps=24, clean=True), estimators=["graph", "fastslam1"], particles=20)
    write_report(found, tmp_path / "page.html", language="ja")
    text = (tmp_path / "page.html").read_text()
    assert '<html lang="ja">' in text
    body = re.sub("(?s)<(script|style|pre)[^>]*>.*?</\\1>", "", text)
    sentences = [s.strip() for s in re.findall(">([^<>]+)<", body) if len(s.split()) > 4]
    assert sentences != []
    assert [s for s in sentences if not JAPANESE.search(s) and not s.startswith(("Linux", "Python"))] == []
    assert '"text":"反復"' in text
    hovers = set(re.findall(r'"hovertemplate":"((?:[^"\\]|\\.)*)"', text))
    shown = {re.sub(r"<[^>]*>|%\{[^}]*\}", " ", json.loads(f'"{hover}"')) for hover in hovers}
    assert len(shown) > 8
    assert [
        s for s in shown if re.search("[a-z]{3}", re.sub("graph|fastslam1", "", s)) and not JAPANESE.search(s)
    ] == []


def test_notes_on_ids_that_were_found_are_translated() -> None:
    log = simulate(seed=1, steps=60, clean=True)
    ids = np.where(np.arange(len(log.steps)) % 5, log.landmarks, UNIDENTIFIED)
    notes = associate(log.replace(landmarks=ids)).notes
    assert any("kept the ids" in note for note in notes)
    assert [note for note in notes if translated(note, "ja") == note] == []
