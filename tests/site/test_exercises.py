"""Exercises that answer: the page and the notebook say the same about an answer, in words that name what is wrong."""

from __future__ import annotations

import json
import shutil
import sys
import threading
from collections.abc import Iterator
from functools import partial
from http.server import ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chromium import Chromium, Quiet, find_browser

SITE = Path(__file__).parents[2] / "docs" / "_site"
sys.path.insert(0, str(SITE))
pytest.importorskip("py_mini_racer", reason="needs the packages of the site: pip install -e '.[docs]'")
import exercises  # noqa: E402
from run_cells import question  # noqa: E402

BROWSER = find_browser()
MISPRINT = ("As the slide prints it", "スライドの印刷のとおりです")
SQUARE = question([[1, 0, -2], [0, 1, 0.5], [0, 0, 1]], {MISPRINT: [[0, 1, 0], [1, 0, 0], [0, 0, 2]]}, unit="m, rad")
VECTOR = question([0.1, -0.3, np.pi / 4], unit="rad")
NUMBER = question(2.0, {MISPRINT: 3.0})
#: question, answer and what is said about it
ANSWERS: list[tuple[dict[str, Any], Any, str]] = [
    (SQUARE, [[1, 0, -2], [0, 1, 0.5], [0, 0, 1]], "Right."),
    (SQUARE, [[1, 0, -2.01], [0, 1, 0.501], [0, 0, 1]], "Right."),
    (SQUARE, [[1, 0, 2], [0, 1, 0.5], [0, 0, 1]], "The sign is wrong: row 1, column 3."),
    (SQUARE, [[1, 0, 2], [0, 1, -0.5], [0, 0, 1]], "The sign is wrong: column 3."),
    (SQUARE, [[1, 0, 7], [0, 1, 8], [0, 0, 9]], "This differs: column 3."),
    (SQUARE, [[1, 0, -2], [5, 1, 8], [0, 0, 1]], "This differs: row 2."),
    (SQUARE, [[7, 0, -2], [0, 1, 0.5], [0, 9, 1]], "This differs: row 1, column 1 and row 3, column 2."),
    (SQUARE, [[1, 0, 0], [0, 1, 0], [-2, 0.5, 1]], "Rows and columns are exchanged."),
    (SQUARE, [[1, 0, 2], [0, 1, -0.5], [0, 0, 1.0]], "The sign is wrong: column 3."),
    (SQUARE, [[0, 1, 0], [1, 0, 0], [0, 0, 2]], "As the slide prints it."),
    (VECTOR, [0.1, -0.3, 0.785], "Right."),
    (VECTOR, [0.1, -0.3, 45], "In degrees? The answer is in rad: number 3."),
    (VECTOR, [0.2, -0.6, 0.785], "Twice the right number: number 1 and number 2."),
    (VECTOR, [0.1, 0.3, 0.785], "The sign is wrong: number 2."),
    (VECTOR, [0.1, -0.32, 0.785], "Nearly right: give one digit more: number 2."),
    (NUMBER, 2, "Right."),
    (NUMBER, -2, "The sign is wrong."),
    (NUMBER, 0.5, "This is the inverse of the right answer."),
    (NUMBER, 3, "As the slide prints it."),
    (NUMBER, 5, "This differs."),
]


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chromium]:
    if BROWSER is None:
        pytest.skip("needs a browser: apt-get install chromium")
    folder = tmp_path_factory.mktemp("site")
    for file in ("exercises.js", "extra.css"):
        shutil.copy(SITE / file, folder)
    forms = exercises.form(SQUARE, "The matrix $B_2$", "en") + exercises.form(NUMBER, "数", "ja")
    (folder / "index.html").write_text(
        '<!doctype html><html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
        f'<link rel="stylesheet" href="extra.css"><link rel="icon" href="data:,"><body>{forms}'
        '<script type="module">import { judge, read } from "./exercises.js"; window.judge = judge, window.read = read;'
        "</script></body></html>"
    )
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(folder)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    with Chromium(BROWSER, tmp_path_factory.mktemp("profile")) as browser:
        browser.send("Page.navigate", url=f"http://127.0.0.1:{server.server_port}/")
        browser.wait_for("window.judge !== undefined")
        yield browser
    server.shutdown()
    server.server_close()


@pytest.mark.parametrize(("asked", "answer", "sentence"), ANSWERS)
def test_a_notebook_says_what_is_wrong(asked: dict[str, Any], answer: Any, sentence: str) -> None:
    namespace: dict[str, Any] = {"np": np}
    exec(exercises.CHECK, namespace)
    assert namespace["judge"](exercises.translated(asked, "en"), answer) == sentence


@pytest.mark.slow
@pytest.mark.browser
def test_the_page_says_the_same(page: Chromium) -> None:
    for asked, answer, sentence in ANSWERS:
        given = np.ravel(answer).tolist()
        call = f"judge({json.dumps(exercises.translated(asked, 'en'))}, {json.dumps(given)})[0]"
        assert page.evaluate(call) == sentence


@pytest.mark.slow
@pytest.mark.browser
@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("-0.25", -0.25), ("3/4", 0.75), ("pi/2", np.pi / 2), ("π / 6", np.pi / 6), ("−1.2", -1.2), ("0,5", 0.5),
        ("0.14^2", 0.0196), ("-2^2", -4), ("2*-3", -6), ("sqrt(2)/2", np.sqrt(0.5)), ("√2", np.sqrt(2)), ("１．５", 1.5),
        ("1e-4", 1e-4), ("2 * (1 + 3)", 8), ("1 - 2 - 3", -4), ("2**3", 8), (".5", 0.5), ("x", None), ("", None),
        ("2 3", None), ("(1", None),
    ],
)  # fmt: skip
def test_fields_take_expressions(page: Chromium, text: str, value: float | None) -> None:
    found = page.evaluate(f"(() => {{ const x = read({json.dumps(text)}); return Number.isNaN(x) ? null : x; }})()")
    assert found == (None if value is None else pytest.approx(value))


@pytest.mark.slow
@pytest.mark.browser
def test_fields_are_filled_and_checked_by_keyboard(page: Chromium) -> None:
    page.evaluate("document.querySelector('form.ask input').focus()")
    for row in ("1", "0", "pi", "0", "1", "1/2", "0", "0", "1"):
        page.send("Input.insertText", text=row)
        page.press("Tab", 9)
    # the last Tab has reached the button
    assert page.evaluate("document.activeElement.textContent") == "Check"
    page.send("Input.dispatchKeyEvent", type="keyDown", key="Enter", windowsVirtualKeyCode=13, text="\r")
    said = "document.querySelector('form.ask [role=status]').textContent"
    page.wait_for(f"{said} !== ''")
    assert page.evaluate(said) == "This differs: row 1, column 3."
    invalid = "document.querySelector('form.ask').querySelectorAll('[aria-invalid=true]')"
    assert page.evaluate(f"[...{invalid}].map((field) => field.ariaLabel)") == ["row 1, column 3"]
    page.evaluate("document.querySelectorAll('form.ask')[1].requestSubmit()")
    assert "のような数" in page.evaluate("document.querySelectorAll('form.ask [role=status]')[1].textContent")
    page.resize(390, 844)
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    assert page.complaints() == []


def test_code_is_shown_without_the_question_and_with_gaps_in_notebooks() -> None:
    code = "x = 1\nright = [\n    x,\n    2,\n]  # gap\nassert right\nask(  # noqa: F821\n    right, {},\n)"
    assert exercises.shown(code) == "x = 1\nright = [\n    x,\n    2,\n]\nassert right"
    assert exercises.with_gaps("a", code) == 'x = 1\nright = ...  # replace the dots\ncheck("a", right)'
    assert exercises.with_gaps("b", "right = 3\nask(right)").startswith("answer = ...")
