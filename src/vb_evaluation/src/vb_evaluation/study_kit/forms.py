"""Writes forms to print: information, consent, demographics, questionnaire. Fill in what is in [brackets]."""

from __future__ import annotations

from pathlib import Path
from typing import List, Sequence, Tuple

import jinja2

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
    (
        "robots",
        "How often do you use a service robot, for instance a vacuum cleaner?",
        ("never", "seldom", "monthly", "weekly"),
    ),
)


def write(folder: Path) -> List[Path]:
    """Writes all forms, and demographics.csv and questionnaire.csv with nothing but their columns.

    Raises:
        CodedError: "cannot_write_into", also if one exists: entries must not be lost.
    """
    pages = jinja2.Environment(loader=jinja2.FileSystemLoader(str(TEMPLATES)), autoescape=True, trim_blocks=True)
    asked = {
        "demographics": DEMOGRAPHICS,
        "methods": [METHOD_TITLES[method] for method in questionnaire.METHODS],
        "statements": questionnaire.STATEMENTS,
        "pairs": questionnaire.UEQ_S,
        "question": questionnaire.QUESTION,
    }
    contents = {
        **{path.name: path.read_text(encoding="utf-8") for path in sorted(TEMPLATES.glob("*.md"))},
        **{
            name: pages.get_template(f"{name}.j2").render(asked) for name in ("demographics.html", "questionnaire.html")
        },
        "demographics.csv": ",".join(["participant", *(name for name, _, _ in DEMOGRAPHICS)]) + "\n",
        "questionnaire.csv": ",".join(questionnaire.columns() + questionnaire.ueq_columns()) + "\n",
    }
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in contents.items():
            with open(str(folder / name), "x", encoding="utf-8") as stream:
                stream.write(text)
    except OSError as error:
        raise CodedError("cannot_write_into", folder=str(folder), reason=error.strerror) from None
    return [folder / name for name in contents]
