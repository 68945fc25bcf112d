"""Protects participants: a copy of the data in which nobody can be identified, and deletion on request."""

from __future__ import annotations

import secrets
import shutil
from pathlib import Path
from typing import List

import pandas

from vb_core.errors import CodedError
from vb_core.files import write_atomically
from vb_evaluation.report.study_files import QUESTIONNAIRE_FILES, RUNS, read_sheet
from vb_evaluation.user_study import blind_judging, protocol
from vb_evaluation.user_study.recording_measures import attempts

# free text, dates, folders and versions may reveal who it was
IDENTIFYING = ("reason", "note", "recording", "interaction", "map", "revision")
AGE_BAND = 10  # [years]


def export(results: Path, out: Path) -> List[Path]:
    """Writes the measured tables with new numbers for the participants, in random order, without free text.

    The numbers are not kept anywhere. Ages become bands of ten years. Raw recordings are not exported.

    Raises:
        CodedError: "cannot_write_into" if the folder exists; "bad_study" if there is nothing measured.
    """
    names = [RUNS, *(name for name in QUESTIONNAIRE_FILES if (results / name).is_file())]
    tables = {name: read_sheet(results / name, ("participant",)) for name in names}
    people = sorted({name for table in tables.values() for name in table.participant})
    secrets.SystemRandom().shuffle(people)
    numbers = {name: f"a{number:02d}" for number, name in enumerate(people, 1)}
    try:
        out.mkdir(parents=True)
        for name, table in tables.items():
            anonymous = table.drop(columns=[column for column in IDENTIFYING if column in table])
            anonymous = anonymous.assign(participant=anonymous.participant.map(numbers))
            if "age" in anonymous:
                anonymous["age"] = anonymous.age.map(_age_band)
            anonymous.sort_values(list(anonymous.columns[:1])).to_csv(out / name, index=False, lineterminator="\n")
    except OSError as error:
        raise CodedError("cannot_write_into", folder=str(out), reason=error.strerror) from None
    return [out / name for name in tables]


def _age_band(text: str) -> str:
    if not text.isdigit():
        return ""
    low = int(text) // AGE_BAND * AGE_BAND
    return f"{low} to {low + AGE_BAND - 1}"


def delete(path: Path, participant: str) -> List[str]:
    """Deletes a participant's recordings, answers and judged pictures for good. Returns what was deleted.

    The participant's rows stay in the protocol, without recording, completion and note, so that the plan of the others is
    unchanged. Results must be measured again.

    Raises:
        CodedError: "no_participant".
    """
    sheet = read_sheet(path, protocol.COLUMNS[:5], "bad_protocol")
    own = sheet.participant == participant
    if not own.any():
        raise CodedError("no_participant", f"{path} has no participant '{participant}'", participant=participant)
    recordings = [name for name in sheet.recording[own] if name]
    deleted = []
    for recording in recordings:
        for folder in attempts(path.parent / Path(recording).expanduser()):
            shutil.rmtree(folder)
            deleted.append(str(folder))
    sheet.loc[own, [column for column in ("recording", "completed", "note") if column in sheet]] = ""
    _write(sheet, path)
    for name in QUESTIONNAIRE_FILES:
        if (path.parent / name).is_file():
            answers = read_sheet(path.parent / name, ("participant",))
            remaining = answers[answers.participant != participant]
            _write(remaining, path.parent / name)
            deleted.append(f"{len(answers) - len(remaining)} line(s) of {name}")
    _delete_pictures(path.parent, recordings)
    return deleted


def _write(table: pandas.DataFrame, path: Path) -> None:
    """Replaces the only copy of a table, atomically."""
    write_atomically(path, table.to_csv(index=False, lineterminator="\n").encode("utf-8"))


def _delete_pictures(study: Path, recordings: List[str]) -> None:
    folder = study / blind_judging.FOLDER
    sheet_file = folder / blind_judging.SHEET
    key_file = study / blind_judging.KEY
    if not key_file.is_file():
        return
    key = read_sheet(key_file, ("code", "recording"))
    codes = set(key.code[key.recording.isin(recordings)])
    for code in codes:
        (folder / f"{code}.png").unlink(missing_ok=True)
    if sheet_file.is_file():  # the judge may have taken the sheet away
        judgements = read_sheet(sheet_file, ("code",))
        _write(judgements[~judgements.code.isin(codes)], sheet_file)
    _write(key[~key.code.isin(codes)], key_file)
