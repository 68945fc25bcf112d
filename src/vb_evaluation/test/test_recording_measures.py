"""Measures of people's recordings: ground truths, the rows of all runs, and what becomes of every mishap."""

import json
import shutil
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, Dict, NamedTuple, Optional

import cv2
import numpy as np
import pytest

from refusals import refused
from vb_testing import assert_fields
from study_recordings import BLUE, EXACT, RED, ROOM, TRUTH, YELLOW, RecordedLab
from study_recordings import make_study, measure_study, painted_room, picture_of_room, write_protocol
from vb_core.errors import CodedError
from vb_core.files import append_line
from vb_evaluation import metrics
from vb_evaluation.report.document import compute_tables, write_report
from vb_evaluation.report.study_files import read_sheet, read_study
from vb_evaluation.user_study.__main__ import main
from vb_evaluation.user_study.recording import Recording
from vb_evaluation.user_study.recording_measures import read_ground_truth, seed_is_right


# ------------------------------------------------------------------ ground truths
LAYER = np.zeros((*ROOM.shape, 4), np.uint8)  # a separate layer: transparent black marks nothing
LAYER[::-1][10:30, 20:50] = (0, 215, 247, 255)


@pytest.mark.parametrize(
    "picture, least",
    [
        pytest.param(painted_room(YELLOW), 1.0, id="yellow"),
        pytest.param(painted_room(RED), 1.0, id="red"),
        pytest.param(painted_room(BLUE), 1.0, id="blue"),
        pytest.param(LAYER, 1.0, id="transparent layer"),
        pytest.param(cv2.GaussianBlur(painted_room((0, 200, 255)), (5, 5), 0), 0.91, id="soft edge"),
    ],
)
def test_any_strong_colour_marks_free_floor(picture, least, tmp_path):
    cv2.imwrite(str(tmp_path / "carpet.png"), picture)
    assert metrics.jaccard(read_ground_truth(tmp_path / "carpet.png", ROOM), TRUTH) >= least


@pytest.mark.parametrize(
    "picture, words",
    [
        pytest.param(picture_of_room(), "no free floor is marked", id="nothing marked"),
        pytest.param(np.zeros((35, 45, 3), np.uint8), "45 x 35 pixels, the map 90 x 70", id="another size"),
        pytest.param(None, "damaged", id="no picture"),
    ],
)
def test_a_picture_that_is_no_ground_truth_is_named(picture, words, tmp_path):
    (tmp_path / "a.png").write_text("no picture")
    if picture is not None:
        cv2.imwrite(str(tmp_path / "a.png"), picture)
    with refused("bad_ground_truth") as caught:
        read_ground_truth(tmp_path / "a.png", ROOM)
    assert words in str(caught.value)
    assert "a.png" in str(caught.value)


def test_a_seed_is_right_if_the_nearest_free_floor_was_asked_for():
    """The oracle searches all free cells; one of the two truths reaches to the walls."""
    free = np.argwhere(ROOM.data == 0)
    for seed in np.random.default_rng(6).uniform(-0.6, 4.4, (300, 2)):
        away = np.hypot(*(ROOM.cell_to_world(free) - seed).T)
        nearest = int(away.argmin())
        for truth in (TRUTH, ROOM.data == 0):
            assert seed_is_right(seed, ROOM, truth) == (away[nearest] <= 0.2 and truth[tuple(free[nearest])])


def test_no_seed_is_right_where_no_floor_is_free():
    walls = ROOM.with_data(np.full(ROOM.shape, 100, np.int8))
    assert not seed_is_right((1.0, 1.0), walls, ROOM.data == 0)


# ------------------------------------------------------------------ one recording for each run
@pytest.fixture(scope="module")
def three_runs(tmp_path_factory):
    """A measured study with an exact border, one of half the area at the second try, and one in another condition."""
    study = make_study(tmp_path_factory.mktemp("three_runs"))
    RecordedLab(study / "exact").interaction("i", *EXACT)
    half = RecordedLab(study / "half", cameras=()).interaction("cancelled", save=False, method="robot_only")
    half.interaction("saved", (0.751, 0.251), (2.249, 0.749), method="robot_only")
    RecordedLab(study / "unplanned").interaction("i", *EXACT, method="robot_only")
    (study / "exact" / "run.yaml").write_text("revision: abc\n")
    runs = ["p1,1,nrs,carpet,exact,,", "p1,2,robot_only,carpet,half,yes,slow", "p2,1,robot_only,carpet,unplanned,,"]
    write_protocol(study, *runs)
    rows, notes = measure_study(study)
    return SimpleNamespace(folder=study, rows=rows, notes=notes)


@pytest.mark.parametrize(
    "column, exact, half, unplanned",
    [
        ("participant", "p1", "p1", "p2"),
        ("order", "1", "2", "1"),
        ("method", "nrs", "robot_only", "robot_only"),
        ("completed", "1", "1", "0"),
        ("outcome", "completed", "completed", "not_as_planned"),
        ("as_planned", "1", "1", "0"),
        ("jaccard", "1.0", "0.5", "1.0"),
        ("time_border_s", "8.0", "16.0", "8.0"),
        ("time_seed_s", "2.0", "4.0", "2.0"),
        ("time_total_s", "10.0", "20.0", "10.0"),  # the time of all attempts
        ("interaction", "i", "saved", "i"),
        ("note", "", "slow", ""),
        ("revision", "abc", "", ""),
    ],
)
def test_each_run_is_measured(three_runs, column, exact, half, unplanned):
    assert [three_runs.rows[run][column] for run in ("exact", "half", "unplanned")] == [exact, half, unplanned]


def test_an_exact_border_has_no_error(three_runs):
    assert float(three_runs.rows["exact"]["error_mean_cm"]) == 0.0


def test_a_run_in_another_condition_is_reported(three_runs):
    (note,) = three_runs.notes
    assert "cameras green instead of none" in note


def test_the_report_reads_what_was_measured_as_a_study_of_people(three_runs):
    assert list(read_study(three_runs.folder / "out").runs.recording) == ["exact", "half"]
    assert json.loads((three_runs.folder / "out" / "study.json").read_text())["people"] is True


@pytest.mark.parametrize("log, words", [('{"interaction_id": "a"}\n', "line 1"), ("\n{broken\n", "line 2")])
def test_a_damaged_recording_names_file_and_line(log, words, tmp_path):
    (tmp_path / "interactions.jsonl").write_text(log)
    with pytest.raises(CodedError, match=f"interactions.jsonl, {words}"):
        Recording(tmp_path)


@pytest.fixture
def plain_study(tmp_path):
    """A study of one run."""
    study = make_study(tmp_path)
    RecordedLab(study / "a").interaction("i")
    write_protocol(study, "p1,1,nrs,carpet,a,,")
    return study


def test_other_files_beside_the_maps_stay(plain_study):
    (plain_study / "out" / "maps").mkdir(parents=True)
    (plain_study / "out" / "maps" / "mine.txt").write_text("keep me")
    measure_study(plain_study)
    assert (plain_study / "out" / "maps" / "mine.txt").read_text() == "keep me"


def test_the_map_of_no_saved_border_is_refused_and_earlier_results_stay(plain_study):
    measure_study(plain_study)
    with refused("other_map"):
        measure_study(plain_study, SHIFTED)
    row = read_sheet(plain_study / "out" / "runs.csv", ()).iloc[0]
    assert (plain_study / "out" / row["map"]).is_file()


def test_another_study_is_not_overwritten(plain_study):
    measure_study(plain_study)
    (plain_study / "out" / "study.json").write_text("{}")
    with refused("other_study"):
        measure_study(plain_study)


# ------------------------------------------------------------------ mishaps
class Mishap(NamedTuple):
    """Arguments of the interaction, None if none was begun, what was noted, and what has to be in the run's row."""

    outcome: str
    completed: str = "0"
    interaction: Optional[Dict[str, Any]] = {}
    noted: Optional[bool] = None
    reason: str = ""  # or a part of it


CANCELLED, WRONG_SEED, OTHER_METHOD = dict(save=False), dict(seed=(3.2, 2.0)), dict(method="robot_only")
SHIFTED = replace(ROOM, origin=(0.5, -0.25, 0.0))
MISHAPS = {  # by the recording's name
    "good": Mishap("completed", "1"),
    "never begun": Mishap("not_started", "", None, False, "nothing was begun in this recording"),
    "cancelled with help": Mishap("not_saved", "0", CANCELLED),
    "cancelled, noted as completed": Mishap("disputed", "0", CANCELLED, True, "completed, but nothing was saved"),
    "wrong seed": Mishap("wrong_seed", "0", WRONG_SEED),
    "wrong seed, noted as completed": Mishap(
        "disputed", "0", WRONG_SEED, True, "completed, but the seed point lies outside"
    ),
    "judged as not completed": Mishap("judged_failed", reason="noted as not completed, but saved"),
    "with the other method": Mishap("not_as_planned", "0", OTHER_METHOD, reason="was started with method:=robot_only"),
    "on another map": Mishap("other_map", "", reason="counts for nothing: its map differs"),
    "torn by a full disk": Mishap("unreadable", "", reason="session.bag"),
    "lost": Mishap("unreadable", "", reason="there is no folder"),
}


def record_mishaps(study):
    """Records each mishap with the method nrs, beside a good run of the same person with robot_only."""
    runs = []
    for number, (name, mishap) in enumerate(MISHAPS.items(), 1):
        lab = RecordedLab(study / name, grid=SHIFTED if name == "on another map" else ROOM)
        if mishap.interaction is not None:
            lab.interaction("i", *EXACT, **mishap.interaction)
        if mishap.noted is not None:
            (study / name / "run.yaml").write_text(f"completed: {str(mishap.noted).lower()}\nended: now\n")
        RecordedLab(study / f"{name} alone", cameras=()).interaction("i", *EXACT, method="robot_only")
        runs += [f'p{number},1,nrs,carpet,"{name}",,', f'p{number},2,robot_only,carpet,"{name} alone",,']
    for key in "hhp":
        append_line(study / "cancelled with help" / "events.jsonl", json.dumps({"key": key, "time": "now"}))
    (study / "torn by a full disk" / "bags" / "session.bag").write_bytes(b"#ROSBAG V2.0\n")
    shutil.rmtree(study / "lost")
    write_protocol(study, *runs)
    (study / "demographics.csv").write_text("participant,age,experience\np1,28,3\np2,55,5\n")


@pytest.fixture(scope="module")
def mishaps(tmp_path_factory):
    """A study of all mishaps, judged, measured and reported: its folder, rows, warnings, page and tables."""
    study = make_study(tmp_path_factory.mktemp("mishaps"))
    record_mishaps(study)
    measure_study(study)
    assert main(["judge", str(study / "out")]) == 0
    codes = read_sheet(study / "judging_key.csv", ("code", "recording")).set_index("recording").code
    judgements = f"code,completed\n{codes['judged as not completed']},no\n{codes['good']},yes\n"
    (study / "judging" / "judgements.csv").write_text(judgements)
    rows, notes = measure_study(study)
    page = write_report(study / "out").read_text()
    tables = compute_tables(read_study(study / "out"))
    return SimpleNamespace(folder=study, codes=codes, rows=rows, notes=notes, page=page, tables=tables)


@pytest.mark.parametrize("name, mishap", MISHAPS.items(), ids=MISHAPS)
def test_each_mishap_has_its_outcome(mishaps, name, mishap):
    assert_fields(mishaps.rows[name], outcome=mishap.outcome, completed=mishap.completed)


def test_the_judge_sees_each_saved_border_under_a_number_alone(mishaps):
    assert {path.stem for path in (mishaps.folder / "judging").glob("*.png")} == set(mishaps.codes)
    assert not {"never begun", "cancelled with help"} & set(mishaps.codes.index)


@pytest.mark.parametrize("name, helped, problems", [("cancelled with help", "2", "1"), ("good", "0", "0")])
def test_help_and_problems_are_counted(mishaps, name, helped, problems):
    assert_fields(mishaps.rows[name], helped=helped, problems=problems)


def test_a_wrong_seed_has_its_index_and_a_run_that_was_never_begun_no_time(mishaps):
    assert float(mishaps.rows["wrong seed"]["jaccard"]) < 0.01
    assert mishaps.rows["never begun"]["time_total_s"] == ""


@pytest.mark.parametrize("name, mishap", MISHAPS.items(), ids=MISHAPS)
def test_each_doubtful_run_has_its_reason_and_is_reported(mishaps, name, mishap):
    row = mishaps.rows[name]
    assert mishap.reason in row["reason"]
    assert bool(row["reason"]) == bool(mishap.reason)
    assert (f"{row['participant']}, carpet, nrs: {row['reason']}" in mishaps.notes) == bool(mishap.reason)


@pytest.mark.parametrize(
    "table, row, cells",
    [
        ("completeness", 0, {"Completed": "1 of 6", "With help": "1", "With a problem of the system": "1"}),
        ("completeness", 0, dict.fromkeys(["Outcome not_started", "Outcome judged_failed", "Outcome other_map"], "1")),
        ("completeness", 0, dict.fromkeys(["Outcome unreadable", "Outcome disputed"], "2")),
        ("completeness", 1, {"Completed": "11 of 11"}),
        ("effects", 0, {"Pairs": 6}),
        ("failures", 0, {"Outcome": "not_started"}),
        ("failures", 1, {"Outcome": "not_saved"}),
        (
            "accuracy",
            0,
            {"Method": "Network robot system", "Runs": "1", "Smallest": "1.000"},
        ),  # of the completed run alone
    ],
)
def test_each_table_counts_mishaps_as_what_they_are(mishaps, table, row, cells):
    assert cells.items() <= mishaps.tables[table][row].items()


def test_the_page_reports_mishaps_and_people(mishaps):
    assert "nothing was begun in this recording" in mishaps.page
    assert "1 runs were not done in the planned condition" in mishaps.page
    assert "not_as_planned" not in mishaps.page
    assert "M = 41.5, SD = 19.1, 28 to 55" in mishaps.page
