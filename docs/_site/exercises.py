"""Exercises that answer: the reader writes numbers into fields, and the page says what is wrong with them.

A cell of a page calls `ask(right, mistakes)` with the numbers that it has computed. The marker
`{{ ask CELL "what to write" }}` puts the fields into the page. `exercises.js` compares in the page, and `check` below in a
notebook. Both know the right numbers, wrong ones with the sentence that explains each (`question` in
`run_cells.py`), and factors such as -1.
"""

from __future__ import annotations

import ast
import html
import json
import re
from collections.abc import Callable, Mapping
from typing import Any

import formulas
import numpy as np

Texts = tuple[str, str]  # in English and in Japanese
LANGUAGES = ("en", "ja")
WORDS: dict[str, Texts] = {
    "check": ("Check", "答え合わせ"),
    "right": ("Right", "正解です"),
    "nearly": ("Nearly right: give one digit more", "ほぼ正解です。もう1桁詳しく答えてください"),
    "wrong": ("This differs", "違っています"),
    "unreadable": ("Write a number such as -0.25, 3/4 or pi/2", "-0.25、3/4、pi/2のような数を入れてください"),
    "waiting": ("Replace the dots by your answer", "...を答えに書き換えてください"),
    "and": (" and ", "と"),
    "stop": (".", "。"),
    "row": ("row {r}", "{r}行目"),
    "column": ("column {c}", "{c}列目"),
    "entry": ("row {r}, column {c}", "{r}行{c}列"),
    "number": ("number {c}", "{c}番目の数"),
    "only": ("your answer", "答え"),
}
#: factors between a right number and a wrong one
FACTORS: dict[str, tuple[float, Texts]] = {
    "sign": (-1.0, ("The sign is wrong", "符号が逆です")),
    "double": (2.0, ("Twice the right number", "正解の2倍です")),
    "half": (0.5, ("Half of the right number", "正解の半分です")),
    "degrees": (180 / np.pi, ("In degrees? The answer is in rad", "単位が度のようです。ラジアンで答えてください")),
}
#: mistakes with a square matrix
OTHERS: list[tuple[Texts, Callable[[np.ndarray], np.ndarray]]] = [
    (("Rows and columns are exchanged", "行と列が入れ替わっています"), np.transpose),
    (("This is the inverse of the right answer", "正解の逆数（逆行列）になっています"), np.linalg.pinv),
]


def translated(asked: Mapping[str, Any], language: str) -> dict[str, Any]:
    """A question in one language, with the words of the answers."""
    k, right = LANGUAGES.index(language), np.array(asked["right"])
    factors = [value for name, value in FACTORS.items() if name != "degrees" or "rad" in asked["unit"]]
    others = [(text, made(right)) for text, made in OTHERS if right.shape[0] == right.shape[1]]
    return {
        **asked,
        "mistakes": [{**mistake, "text": mistake["text"][k]} for mistake in asked["mistakes"]],
        "factors": [[factor, text[k]] for factor, text in factors],
        "others": [{"value": value.tolist(), "text": text[k]} for text, value in others],
        "words": {name: texts[k] for name, texts in WORDS.items()},
    }


def form(asked: Mapping[str, Any], legend: str, language: str) -> str:
    """The fields of a question as HTML on one line, hidden where there is no JavaScript."""
    here = translated(asked, language)
    words, (rows, columns) = here["words"], np.shape(here["right"])
    fields = []
    for r in range(rows):
        for c in range(columns):
            place = "only" if rows == columns == 1 else "number" if rows == 1 else "entry"
            name = words[place].format(r=r + 1, c=c + 1)
            fields.append(f'<input type="text" size="7" autocomplete="off" aria-label="{html.escape(name)}">')
    said = re.sub(r"\$(.+?)\$", lambda found: formulas.render(found[1], False), legend)
    unit = f'<span class="ask-unit">{html.escape(asked["unit"])}</span>' if asked["unit"] else ""
    data = json.dumps(here, ensure_ascii=False).replace("<", "\\u003c")
    return (
        f'<form class="ask" hidden><script type="application/json">{data}</script><fieldset><legend>{said}</legend>'
        f'<span class="ask-fields" style="--columns: {columns}">{"".join(fields)}</span>{unit} '
        f'<button type="submit" class="md-button">{words["check"]}</button></fieldset>'
        '<p class="ask-answer" role="status"></p></form>'
    )


def shown(code: str) -> str:
    """The code of a cell as pages show it: without the question, and without the marks of gaps."""
    lines = code.splitlines()
    for node in reversed(ast.parse(code).body):
        if _asks(node):
            del lines[node.lineno - 1 : node.end_lineno]
    return re.sub(r"  # gap$", "", "\n".join(lines).rstrip(), flags=re.MULTILINE)


def with_gaps(name: str, code: str) -> str:
    """The code of a cell for a notebook, with `...` where a line ends with `# gap`, and the check of its result.

    A cell without gaps is for paper and pencil: the reader writes numbers.
    """
    lines, tree = code.splitlines(), ast.parse(code)
    call: Any = next(node for node in tree.body if _asks(node))
    asked = ast.unparse(call.value.args[0])
    gaps = [node for node in tree.body if lines[(node.end_lineno or 0) - 1].endswith("# gap")]
    if not gaps:
        shape = "a number, or a list of numbers or of rows"
        return f'answer = ...  # {shape}\ncheck("{name}", answer)'
    del lines[gaps[-1].end_lineno :]
    for node in reversed(gaps):
        target = re.match(r"\w+", lines[node.lineno - 1])
        assert target, f"the gap of {name} is no assignment"
        lines[node.lineno - 1 : node.end_lineno] = [f"{target[0]} = ...  # replace the dots"]
    return "\n".join([*lines, f'check("{name}", {asked})'])


def _asks(node: ast.stmt) -> bool:
    return (
        isinstance(node, ast.Expr) and isinstance(node.value, ast.Call) and getattr(node.value.func, "id", "") == "ask"
    )


#: what a notebook needs: `QUESTIONS` and `judge`, which says the same as `judge` in exercises.js
CHECK = '''def judge(question, given):
    """What is wrong with an answer, in one sentence."""
    words, right = question["words"], np.array(question["right"])
    if np.shape(given) not in (right.shape, right.squeeze().shape):
        return f"{words['wrong']}: {right.shape}{words['stop']}"
    given, slack = np.reshape(np.asarray(given, dtype=float), right.shape), np.array(question["slack"])
    wrong = np.argwhere(~(abs(given - right) <= slack))
    if not len(wrong):
        return words["right"] + words["stop"]
    at = tuple(wrong.T)

    def explained(kind):
        return [m["text"] for m in question[kind] if (abs(given - m["value"])[at] <= slack[at]).all()]

    factors = question["factors"]
    texts = [text for f, text in factors if (abs(given - f * right)[at] <= abs(f) * slack[at]).all()]
    whole = explained("mistakes") or (not texts and explained("others"))
    if whole:
        return whole[0] + words["stop"]
    if not texts and (abs(given - right) <= 5 * slack).all():
        texts = [words["nearly"]]
    rows, columns = ({int(number) + 1 for number in numbers} for numbers in at)
    if right.size == 1:
        where = ""
    elif len(right) > 1 and len(wrong) > 1 and len(columns) == 1:
        where = words["column"].format(c=min(columns))
    elif len(right) > 1 and len(wrong) > 1 and len(rows) == 1:
        where = words["row"].format(r=min(rows))
    else:
        name = words["entry" if len(right) > 1 else "number"]
        where = words["and"].join(name.format(r=r + 1, c=c + 1) for r, c in wrong)
    return (texts or [words["wrong"]])[0] + (": " + where if where else "") + words["stop"]


def check(name, answer):
    """Say what is wrong with an answer, as the page does."""
    words = QUESTIONS[name]["words"]
    print(words["waiting"] + words["stop"] if answer is ... else judge(QUESTIONS[name], answer))'''


def notebook_cell(questions: Mapping[str, Mapping[str, Any]], language: str) -> str:
    """The code that checks the answers in a notebook."""
    data = json.dumps({name: translated(asked, language) for name, asked in questions.items()}, ensure_ascii=False)
    return f'import json\n\nimport numpy as np\n\nQUESTIONS = json.loads(r"""{data}""")\n\n\n{CHECK}'
