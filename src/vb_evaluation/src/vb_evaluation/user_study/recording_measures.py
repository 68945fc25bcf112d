"""Computes the paper's measures (Sect. 5.5) from recordings of people: the same runs.csv that a simulated study has."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path
from typing import Any, Dict, List, Optional, Set

import cv2
import numpy as np

from vb_core.errors import CodedError
from vb_core.files import write_atomically
from vb_core.grid_map import GridMap, nearest_cell
from vb_core.map_files import write_map
from vb_evaluation import metrics
from vb_evaluation.report.map_figures import write_truths
from vb_evaluation.report.study_files import META, REQUIRED, QUESTIONNAIRE_FILES, RUNS, STATES
from vb_evaluation.report.study_files import read_meta, read_sheet, write_table
from vb_evaluation.user_study import blind_judging, protocol
from vb_evaluation.user_study.recording import Recording

_TIMES = (*STATES, "total")
SEED_REACH = 0.2  # [m] from a seed to the free floor that it means
MIN_COLOR = 40  # [grey levels] between the largest and the smallest channel; less is grey
_EXTRAS = "order as_planned revision map outcome reason saved seed_is_right helped problems recording interaction note".split()
COLUMNS = (*REQUIRED, *metrics.ERRORS, *_EXTRAS)
_UNMEASURED = {"bad_recording": "unreadable", "other_map": "other_map"}  # outcome of a run, by the error's code


def measure_study(protocol_file: Path, ground_truths: Path, out: Path, physical: Optional[GridMap] = None) -> List[str]:
    """Measures every run of a protocol and writes runs.csv, study.json and maps/ for the report.

    Args:
        protocol_file: names the recordings, relative to its own folder.
        ground_truths: folder of <scenario>.png.
        physical: the physical map; None takes the first one without borders from the recordings.

    Returns:
        Sentences about the runs that have a `reason` why they are left out, or count as not completed.

    Raises:
        CodedError: what is wrong with protocol, recordings or ground truths; "other_map" if the physical map is that of
            no saved border. Then earlier results stay.
    """
    entries = protocol.read_protocol(protocol_file)
    if not entries:
        raise CodedError("bad_protocol", f"{protocol_file}: no run has a recording yet")
    if (out / RUNS).exists() and not read_meta(out / META).get("people"):
        raise CodedError("other_study", f"{out} holds another study: choose another --out, or move it away")
    folders = [last_attempt(entry.folder(protocol_file)) for entry in entries]
    physical = physical or _physical(folders)
    scenarios = list(dict.fromkeys(entry.scenario for entry in entries))
    truths = {scenario: read_ground_truth(ground_truths / f"{scenario}.png", physical) for scenario in scenarios}
    judged = blind_judging.read_judgements(protocol_file.parent)
    rows = []
    for entry, folder in zip(entries, folders):
        noted = judged.get(entry.recording, entry.completed)
        truth = truths[entry.scenario]
        try:
            row = _measured_row(entry, noted, Recording(folder), physical, truth, out / "maps")
        except CodedError as error:
            if error.code not in _UNMEASURED:
                raise
            row = _empty_row(entry, _UNMEASURED[error.code], f"counts for nothing: {error.message}")
        rows.append(row)
    if "other_map" in {row["outcome"] for row in rows} and not any(row["saved"] for row in rows):
        raise CodedError("other_map", "all saved borders are on another map: name that one with --map")
    _delete_maps(out, {row.get("map") for row in rows})
    write_truths(out, physical, truths)
    write_table(out / RUNS, COLUMNS, rows)
    for name in QUESTIONNAIRE_FILES:
        if (protocol_file.parent / name).is_file():
            write_atomically(out / name, (protocol_file.parent / name).read_bytes())
    meta = {"people": True, "protocol": protocol_file.name}
    (out / META).write_text(json.dumps(meta, indent=2) + "\n", encoding="utf-8")
    return [
        f"{row['participant']}, {row['scenario']}, {row['method']}: {row['reason']}" for row in rows if row["reason"]
    ]


def _delete_maps(out: Path, kept: Set[Optional[str]]) -> None:
    """Deletes the other maps of earlier measures: that of a run deleted at its participant's request must not stay."""
    names = read_sheet(out / RUNS, ("map",))["map"] if (out / RUNS).exists() else []
    for name in set(filter(None, names)) - kept:
        for suffix in (".yaml", ".pgm"):
            (out / name).with_suffix(suffix).unlink(missing_ok=True)


def read_ground_truth(path: Path, physical: GridMap) -> np.ndarray:
    """Reads which free cells of the physical map a ground truth marks: (H, W) bool.

    Args:
        path: a PNG as large as the map's image, in which the area is filled with any strong colour.
        physical: the map that it was drawn over.

    Raises:
        CodedError: "bad_ground_truth" naming the file and what is wrong with it.
    """
    image = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if image is None:
        raise CodedError("bad_ground_truth", f"{path}: there is no such picture, or a damaged one")
    if image.shape[:2] != physical.shape:
        sizes = f"{image.shape[1]} x {image.shape[0]} pixels, the map {physical.shape[1]} x {physical.shape[0]}"
        hint = "draw over the map's own picture and do not scale it"
        raise CodedError("bad_ground_truth", f"{path}: the picture has {sizes}: {hint}")
    chroma = np.ptp(image.astype(int), axis=2)[::-1]
    # half of the strongest colour: cuts the soft edge that an editor draws in its middle
    marked = (chroma >= max(MIN_COLOR, chroma.max() / 2.0)) & metrics.free_cells(physical)
    if not marked.any():
        raise CodedError("bad_ground_truth", f"{path}: no free floor is marked: fill the area with a strong colour")
    return marked


def _physical(folders: List[Path]) -> GridMap:
    for folder in folders:
        with contextlib.suppress(CodedError):  # what cannot be read is reported with its run
            physical = Recording(folder).physical()
            if physical is not None:
                return physical
    raise CodedError("bad_recording", "no recording has a map without borders: name the physical map with --map")


def attempts(folder: Path) -> List[Path]:
    """Lists a run's recordings, oldest first: <folder>, and <folder>_2, _3, ... of a run that was done again."""
    repeated = [path for path in folder.parent.glob(f"{folder.name}_*") if path.name[len(folder.name) + 1 :].isdigit()]
    repeated.sort(key=lambda path: int(path.name[len(folder.name) + 1 :]))
    return [path for path in (folder, *repeated) if path.exists()]


def last_attempt(folder: Path) -> Path:
    """Returns a run's newest recording, the one that counts; the folder itself if there is none."""
    return (attempts(folder) or [folder])[-1]


def deviations(entry: protocol.Entry, recording: Recording) -> List[str]:
    """Lists how the condition in which a recording was made differs from the planned one."""
    differences = []
    run = recording.run
    for name, planned in (("participant", entry.participant), ("scenario", entry.scenario), ("method", entry.method)):
        if run and str(run.get(name, planned)) != planned:
            differences.append(f"{name} {run[name]} instead of {planned}")
    methods = {interaction.method for interaction in recording.interactions}
    differences += [f"the system was started with method:={method}" for method in sorted(methods - {entry.method})]
    if recording.cameras is not None:
        planned = run.get("cameras", () if entry.method == "robot_only" else recording.cameras)
        if set(planned) != recording.cameras:
            recorded, expected = (" ".join(sorted(names)) or "none" for names in (recording.cameras, planned))
            differences.append(f"cameras {recorded} instead of {expected}")
    return differences


def classify_outcome(is_as_planned: bool, is_saved: bool, seed_is_right: bool, judged_completed: Optional[bool]) -> str:
    """Returns the outcome of a run, from which every table is made.

    unreadable      its recording is damaged or incomplete, which is the system's failure too (not returned here)
    other_map       its border is on another map than the physical one, so it cannot be measured (not returned here)
    not_started     no interaction was begun, which is the system's failure and nobody's result (not returned here)
    not_as_planned  in another condition than planned, and left out
    completed       saved, with the seed in the ground truth, and not judged to have failed
    judged_failed   the same, but judged not to be what was asked for
    wrong_seed      saved, with the seed on the wrong side
    not_saved       given up, cancelled, or broken off
    disputed        judged as completed, but nothing was saved or the seed is wrong; counts as not completed

    Args:
        judged_completed: what judge or experimenter said; None for nothing.
    """
    if not is_as_planned:
        return "not_as_planned"
    if is_saved and seed_is_right:
        return "judged_failed" if judged_completed is False else "completed"
    if judged_completed:
        return "disputed"
    return "wrong_seed" if is_saved else "not_saved"


def _empty_row(entry: protocol.Entry, outcome: str, reason: str) -> Dict[str, Any]:
    """Makes the row of a run of which only the protocol's entry is known."""
    row = {name: getattr(entry, name) for name in ("participant", "scenario", "method", "recording", "note")}
    row.update(order=entry.order or "", as_planned=1, outcome=outcome, reason=reason, saved=0, seed_is_right=0)
    return row


def _measured_row(
    entry: protocol.Entry, noted: Optional[bool], recording: Recording, physical: GridMap, truth: np.ndarray, maps: Path
) -> Dict[str, Any]:
    """Makes a run's row. Each interaction of its recording is an attempt at it. There may be none, or several."""
    interactions = recording.interactions
    row = _empty_row(
        entry, "not_started", "nothing was begun in this recording, so it counts for nothing: do it again?"
    )
    row.update(
        revision=recording.run.get("revision", ""),
        helped=recording.count_key_presses("h"),
        problems=recording.count_key_presses("p"),
    )
    if not interactions:
        return row
    differences = deviations(entry, recording)
    # cancelled attempts took time too, as in the simulated study
    for name in _TIMES:
        row[f"time_{name}_s"] = round(sum(getattr(interaction, f"{name}_s") for interaction in interactions), 3)
    row.update(as_planned=int(not differences), interaction=interactions[-1].interaction_id)
    result = recording.result(interactions[-1])
    if result is not None:
        posterior, seed = result
        if not posterior.same_geometry(physical):
            raise CodedError("other_map", "its map differs from the physical map in size, resolution or origin")
        name = "_".join((entry.participant, entry.scenario, entry.method)).replace("/", "-")
        write_map(maps / name, posterior)
        row.update(metrics.accuracy(physical, truth, metrics.restricted_cells(physical, posterior)))
        row.update(saved=1, map=f"maps/{name}.yaml", seed_is_right=int(seed_is_right(seed, physical, truth)))
    if noted is None:
        noted = recording.run.get("completed")
    row["outcome"] = classify_outcome(not differences, bool(row["saved"]), bool(row["seed_is_right"]), noted)
    row["completed"] = int(row["outcome"] == "completed")
    missing = "the seed point lies outside the ground truth" if row["saved"] else "nothing was saved"
    reasons = {
        "not_as_planned": f"not as planned, left out of the analysis: {'; '.join(differences)}",
        "disputed": f"noted as completed, but {missing}: counts as not completed",
        "judged_failed": "noted as not completed, but saved with the seed point within the ground truth",
    }
    row["reason"] = reasons.get(row["outcome"], "")
    return row


def seed_is_right(seed: np.ndarray, physical: GridMap, truth: np.ndarray) -> bool:
    """Returns whether a seed (2,) [m] points into the ground truth: nearer to it than to any other free floor, within reach."""
    cell, _ = nearest_cell(physical, metrics.free_cells(physical), seed, SEED_REACH)
    return cell is not None and bool(truth[cell])
