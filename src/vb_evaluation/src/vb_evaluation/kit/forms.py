"""Writes forms to print: information, consent, demographics, questionnaire. Fill in what is in [brackets]."""
from __future__ import annotations

from pathlib import Path
from typing import List, Sequence, Tuple

from markupsafe import escape

from vb_core.errors import CodedError
from vb_evaluation.report import questionnaire
from vb_evaluation.report.paper import METHOD_TITLES

TEMPLATES = Path(__file__).resolve().parents[3] / "config" / "forms"
DEMOGRAPHICS: Tuple[Tuple[str, str, Sequence[str]], ...] = (
    ("age", "Age group", ("18-24", "25-34", "35-49", "50-64", "65 and over", "no answer")),
    ("gender", "Gender", ("female", "male", "another", "no answer")),
    ("hand", "Hand that holds the pointer", ("right", "left")),
    ("sight", "Glasses or lenses worn today", ("yes", "no")),
    ("colours", "Trouble telling red from green", ("yes", "no", "no answer")),
    ("pointers", "How often do you use a laser pointer?", ("never", "seldom", "monthly", "weekly")),
    ("robots", "How often do you use a service robot, for instance a vacuum cleaner?", ("never", "seldom", "monthly", "weekly")),
)
_STYLE = ("body{font:15px/1.5 sans-serif;max-width:46rem;margin:2rem auto}table{border-collapse:collapse;width:100%}"
          "td,th{border:1px solid #999;padding:.35rem .5rem;text-align:center}td:first-child,td:last-child{text-align:left}"
          "h2{break-before:page}.box{font-size:1.3em}@media print{body{margin:0}}")
BOX = '<span class="box">&#9633;</span>'


def write(folder: Path) -> List[Path]:
    """Writes all forms, and demographics.csv and questionnaire.csv with nothing but their columns.

    Raises:
        CodedError: "cannot_write", also if one exists: entries must not be lost.
    """
    columns = questionnaire.columns() + questionnaire.ueq_columns()
    contents = {
        **{path.name: path.read_text(encoding="utf-8") for path in sorted(TEMPLATES.glob("*.md"))},
        "demographics.html": demographics_page(), "questionnaire.html": questionnaire_page(),
        "demographics.csv": ",".join(["participant", *(name for name, _, _ in DEMOGRAPHICS)]) + "\n",
        "questionnaire.csv": ",".join(columns) + "\n",
    }
    written = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in contents.items():
            with open(str(folder / name), "x", encoding="utf-8") as stream:
                stream.write(text)
            written.append(folder / name)
    except OSError as error:
        raise CodedError("cannot_write", f"cannot write into {folder}: {error.strerror}") from None
    return written


def demographics_page() -> str:
    """A page with the questions about the person."""
    rows = "".join(f"<tr><td>{escape(words)}</td><td>{' '.join(f'{BOX} {escape(option)}' for option in options)}</td></tr>"
                   for _, words, options in DEMOGRAPHICS)
    return _page("About you", f"<h1>About you</h1><p>Participant: ______ &nbsp; Every answer may be left out.</p><table>{rows}</table>")


def questionnaire_page() -> str:
    """Two pages with the paper's statements and the UEQ-S, one for each method, and the last question."""
    parts = []
    for method in questionnaire.METHODS:
        statements = "".join(
            f"<tr><td>{number}. {escape(statement)}</td>{f'<td>{BOX}</td>' * 5}<td>{escape(scale)}</td></tr>"
            for number, (statement, scale) in enumerate(questionnaire.STATEMENTS, 1))
        pairs = "".join(f"<tr><td>{escape(left)}</td>{f'<td>{BOX}</td>' * 7}<td>{escape(right)}</td></tr>"
                        for left, right in questionnaire.UEQ_S)
        heads = "".join(f"<th>{number}</th>" for number in range(1, 6))
        parts.append(
            f"<h2>Method: {escape(METHOD_TITLES[method].lower())}</h2><p>Participant: ______ &nbsp; Tick one box in each line.</p>"
            f"<table><tr><th></th>{heads}<th></th></tr>{statements}</table><p>Decide quickly; there is no right answer.</p>"
            f"<table>{pairs}</table>")
    return _page("Questionnaire", "<h1>Questionnaire</h1>" + "".join(parts) + f"<p>{escape(questionnaire.QUESTION)} {BOX} yes {BOX} no</p>"
                 "<p><small>Pairs of words: UEQ-S, Schrepp, Hinderks, Thomaschewski 2017, www.ueq-online.org</small></p>")


def _page(title: str, body: str) -> str:
    return (f'<!DOCTYPE html><html lang="en"><head><meta charset="utf-8"><title>{title}</title><style>{_STYLE}</style></head>'
            f"<body>{body}</body></html>\n")
