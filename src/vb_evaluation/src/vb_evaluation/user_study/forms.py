"""Writes forms to print: information, consent, demographics, questionnaire. Fill in what is in [brackets]."""

from __future__ import annotations

from pathlib import Path
from typing import List, Sequence, Tuple

import jinja2
import rospkg

from vb_core.errors import CodedError
from vb_evaluation.report import questionnaire
from vb_evaluation.report.paper_results import METHOD_TITLES

TEMPLATES = Path(rospkg.RosPack().get_path("vb_evaluation")) / "config" / "forms"
DEMOGRAPHICS: Tuple[Tuple[str, str, Sequence[str]], ...] = (
    ("age", "Age in years", ()),
    ("gender", "Gender", ("female", "male", "another", "no answer")),
    ("hand", "Hand that holds the pointer", ("right", "left")),
    ("sight", "Glasses or lenses worn today", ("yes", "no")),
    ("colours", "Trouble telling red from green", ("yes", "no", "no answer")),
    ("pointers", "How often do you use a laser pointer?", ("never", "seldom", "monthly", "weekly")),
    ("experience", "Experience with robots, from 1 (no experience) to 5 (highly experienced)", tuple("12345")),
)


def write_forms(folder: Path) -> List[Path]:
    """Writes all forms, and demographics.csv and questionnaire.csv with nothing but their columns.

    Raises:
        CodedError: "cannot_write_into", also if one exists: entries must not be lost.
    """
    pages = jinja2.Environment(loader=jinja2.FileSystemLoader(str(TEMPLATES)), autoescape=True, trim_blocks=True)
    fields = {"statements": questionnaire.STATEMENTS, "question": questionnaire.QUESTION}
    contents = {path.name: path.read_text(encoding="utf-8") for path in sorted(TEMPLATES.glob("*.[mc][ds]*"))}
    contents["demographics.html"] = pages.get_template("demographics.html.j2").render(demographics=DEMOGRAPHICS)
    # half of the people are asked about one method first, half about the other
    for first in questionnaire.METHODS:
        methods = [METHOD_TITLES[name] for name in sorted(questionnaire.METHODS, key=lambda name: name != first)]
        page = pages.get_template("questionnaire.html.j2").render(methods=methods, **fields)
        contents[f"questionnaire_{first}_first.html"] = page
    contents["demographics.csv"] = ",".join(["participant", *(name for name, _, _ in DEMOGRAPHICS)]) + "\n"
    contents["questionnaire.csv"] = ",".join(questionnaire.COLUMNS) + "\n"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in contents.items():
            with open(str(folder / name), "x", encoding="utf-8") as stream:
                stream.write(text)
    except OSError as error:
        raise CodedError("cannot_write_into", folder=str(folder), reason=error.strerror) from None
    return [folder / name for name in contents]
