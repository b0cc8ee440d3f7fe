"""Tables, messages and reports in Japanese: every template has a translation, and what is shown is translated as a whole."""

from __future__ import annotations

import ast
import inspect
import json
import re
import textwrap
from collections.abc import Callable, Iterator
from importlib import import_module
from importlib.resources import files
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from comparisons import comparison, run, write_report
from comparisons.cli import app
from comparisons.estimators import filters
from comparisons.results import exchange
from comparisons.show import log_tables, tables
from comparisons.show.language import NUMBER, PLACE, _translated, catalogue, key_of, language_of, translated
from comparisons.show.report import curves, matches, page
from graphslam import OptionError, simulate
from graphslam.graph import build, defaults, tracking
from graphslam.identification.result import RobotEstimate

#: the module, whose package has a function of the same name
verbs = import_module("comparisons.cli.run")
JAPANESE = re.compile("[\u3040-\u30ff\u4e00-\u9fff]")
#: what makes the sentences of `run` and of its report
SOURCES: tuple[Callable[..., Any], ...] = (
    tables.result_tables, tables.comparison_tables, tables.session_tables, tables.state_table, tables.landmark_table,
    tables._exchanged, tables._noise_remarks, verbs.run, verbs.report, verbs._noise_advice,
    comparison.Comparison._noise_findings, exchange.reason_without_graph, filters._one_run, filters.of_several_seeds,
    build._tied_steps, tracking.in_frame_of, page._map_note, page._error_texts, page._convergence, page._matrix,
    curves.remarks, matches.description, matches.association_table, defaults.pairs_overweight,
    RobotEstimate.sentences.fget, RobotEstimate.remarks.fget, tables.solver_tables, tables.backend_tables,
    log_tables.import_tables, log_tables.overview_tables, log_tables.evaluation_tables, log_tables.particle_tables,
    log_tables.consistency_tables, log_tables.summary_tables, log_tables.survey_tables, log_tables.calibration_tables,
)  # fmt: skip
#: strings of these functions that are no sentences
NO_SENTENCES = {
    "bold red",
    "not bold default",
    "a log and a file to write: slam-compare report LOG OUT.html",
    "too little noise",
    "wrong sightings",
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
    keys = [template.replace(NUMBER, PLACE) for template in catalogue("ja")]
    missing = {
        text
        for text in strings_of(function)
        if text not in NO_SENTENCES
        and _translated(text.replace(PLACE, "7"), "ja")[1] < 0.7 * len(key_of(text.replace(PLACE, "7")))
        # a part of a template
        and not any(key_of(text) in key for key in keys)
    }
    assert missing == set()


def test_translations_use_the_places_of_their_templates() -> None:
    for template, translation in catalogue("ja").items():
        used, places = re.findall(r"\{(\d*)\}", translation), template.replace(NUMBER, PLACE).count(PLACE)
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
