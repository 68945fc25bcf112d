"""Ground truths, protocol, and measures taken from recordings that the other packages' code writes."""

import json
import re
import shutil
import tempfile
from itertools import product
from pathlib import Path

import cv2
import numpy as np
import pytest
import rosbag
import rospy

from refusals import refused
from vb_core import names
from vb_core.errors import CodedError
from vb_core.files import append_line
from vb_core.grid_map import GridMap
from vb_core.map_files import write_map
from vb_core.ros.messages import message_from_grid
from vb_evaluation import metrics
from vb_evaluation.report.html_page import write_report
from vb_evaluation.user_study import blind_judging, conduct, forms, privacy, protocol, recording_measures
from vb_evaluation.user_study.__main__ import main
from vb_evaluation.user_study.recording_measures import last_attempt, measure, read_ground_truth, seed_is_right
from vb_evaluation.user_study.recording import Recording
from vb_evaluation.report.study_files import read_sheet, read_study
from vb_map_integration.border import VirtualBorder
from vb_map_integration.border_messages import message_from_border
from vb_map_integration.integration import integrate
from vb_msgs.msg import DetectorStatus, VirtualBorderArray
from vb_voice_wizard.interaction import Interaction
from vb_voice_wizard.dialogue.command_answers import Answer


def room():
    """Returns a map of a room of 4 m x 3 m with walls and a table, unknown outside; 5 cm cells."""
    cells = np.full((70, 90), -1, np.int8)
    cells[5:65, 5:85] = 100
    cells[7:63, 7:83] = 0
    cells[40:44, 60:64] = 100
    return GridMap(cells, 0.05, (-0.25, -0.25, 0.0))


def truth_of(grid):
    marked = np.zeros(grid.shape, bool)
    marked[10:30, 20:50] = True
    return marked & (grid.data == 0)


def picture_of(grid):
    """Returns the map's picture, as an image editor opens it."""
    with tempfile.TemporaryDirectory() as folder:
        write_map(Path(folder) / "map", grid)
        return cv2.imread(f"{folder}/map.pgm")


def painted(grid, color):
    """Returns the map's picture with the area painted in a colour (b, g, r), as in an image editor."""
    picture = picture_of(grid)
    picture[::-1][10:30, 20:50] = color  # over walls and furniture too
    return picture


EXACT = ((0.751, 0.251), (2.249, 1.249))  # the ground truth's corners, to the cell


# ------------------------------------------------------------------ ground truths
LAYER = np.zeros((70, 90, 4), np.uint8)  # a separate layer: transparent black marks nothing
LAYER[::-1][10:30, 20:50] = (0, 215, 247, 255)


@pytest.mark.parametrize(
    "picture, least",
    [
        *((painted(room(), color), 1.0) for color in ((0, 215, 247), (0, 0, 255), (180, 90, 40))),
        (LAYER, 1.0),
        # a soft edge is cut at its middle
        (cv2.GaussianBlur(painted(room(), (0, 200, 255)), (5, 5), 0), 0.91),
    ],
)
def test_any_strong_colour_marks_free_floor(picture, least, tmp_path):
    cv2.imwrite(str(tmp_path / "carpet.png"), picture)
    assert metrics.jaccard(read_ground_truth(tmp_path / "carpet.png", room()), truth_of(room())) >= least


@pytest.mark.parametrize(
    "picture, words",
    [
        (picture_of(room()), "no free floor is marked"),
        (np.zeros((35, 45, 3), np.uint8), "45 x 35 pixels, the map 90 x 70"),
        (None, "damaged"),
    ],
)
def test_a_picture_that_is_no_ground_truth_is_named(picture, words, tmp_path):
    (tmp_path / "a.png").write_text("no picture")
    if picture is not None:
        cv2.imwrite(str(tmp_path / "a.png"), picture)
    with refused("bad_ground_truth") as caught:
        read_ground_truth(tmp_path / "a.png", room())
    assert words in str(caught.value) and "a.png" in str(caught.value)


# ------------------------------------------------------------------ protocol
def test_a_protocol_is_read_as_written_without_runs_that_did_not_take_place(tmp_path):
    path = tmp_path / "protocol.csv"
    protocol.write(path, protocol.plan(2, ["room"], ["nrs", "robot_only"], 1))
    entries = protocol.read(path)
    assert len(entries) == 4 and entries[0].completed is None
    with pytest.raises(CodedError):
        protocol.write(path, [])  # an existing protocol is not overwritten
    path.write_text(f"{','.join(protocol.COLUMNS)}\np1,1,nrs,room,a,yes,fine\np2,1,nrs,room,,,ill\n")
    assert protocol.read(path) == [protocol.Entry("p1", "nrs", "room", "a", True, "fine", 1)]


@pytest.mark.parametrize(
    "text, words",
    [
        ("participant,method\n", "scenario"),
        ("participant,method,scenario,recording,completed\np,nrs,room,a,perhaps\n", "line 2: completed"),
        ("participant,method,scenario,recording\np,nrs,room,a\np,nrs,room,b\n", "lines 2 and 3"),
        ("participant,method,scenario,recording\np,nrs,room,a\nq,nrs,room,a\n", "lines 2 and 3"),
        ("participant,method,scenario,recording\np,,room,a\n", "line 2: method is empty"),
    ],
)
def test_wrong_protocols_name_the_line(text, words, tmp_path):
    (tmp_path / "p.csv").write_text(text)
    with pytest.raises(CodedError) as caught:
        protocol.read(tmp_path / "p.csv")
    assert words in str(caught.value)


# ------------------------------------------------------------------ recordings
def write_state(folder, grid, borders, stamp_s, cameras=()):
    """Adds a map with its borders to a recording's bag, as the nodes publish them, and the status of some detectors."""
    path, stamp = folder / "bags" / "session.bag", rospy.Time.from_sec(stamp_s)
    path.parent.mkdir(parents=True, exist_ok=True)
    with rosbag.Bag(str(path), "a" if path.exists() else "w") as bag:
        bag.write(names.MAP_WITH_BORDERS, message_from_grid(grid, stamp), stamp)
        message = VirtualBorderArray(borders=[message_from_border(border) for border in borders])
        message.header.stamp = stamp
        bag.write(names.BORDERS, message, stamp)
        for camera, mobile in [*((name, False) for name in cameras), ("robot", True)]:
            bag.write(names.DETECTORS, DetectorStatus(camera=camera, mobile=mobile), stamp)


class Lab:
    """Writes a recording like that of a running system."""

    def __init__(self, folder, grid, cameras=("green",)):
        self.folder, self.grid = folder, grid
        self.borders = []
        write_state(folder, grid, [], 1.0, cameras)
        self.time = 10.0

    def interaction(self, key, low=(1.0, 0.4), high=(2.4, 1.2), seed=None, save=True, method="nrs"):
        """Draws a rectangle; Border takes 8 s, Seed 2 s."""
        machine = Interaction()
        machine.command("define_border", "wizard", self.time)
        machine.interaction_id = key
        machine.command("define_seed", "wizard", self.time + 8.0)
        self.time += 10.0
        if save:
            (x0, y0), (x1, y1) = low, high
            corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
            border = VirtualBorder(
                corners, corners.mean(axis=0) if seed is None else seed, closed=True, id=f"b{len(self.borders) + 1}"
            )
            self.borders.append(border)
            cells = np.max([integrate(self.grid, each).posterior.data for each in self.borders], axis=0)
            write_state(self.folder, self.grid.with_data(cells), self.borders, self.time - 0.1)
            machine.command("save", "wizard", self.time)
            machine.finish(Answer(True, "saved"), self.time, border.id)
        else:
            machine.command("cancel", "wizard", self.time)
        append_line(self.folder / "interactions.jsonl", machine.take_record().line(method, ["green"]))
        self.time += 5.0
        return self


@pytest.fixture
def study(tmp_path):
    truths = tmp_path / "ground_truth"
    truths.mkdir()
    cv2.imwrite(str(truths / "carpet.png"), painted(room(), (0, 215, 247)))
    return tmp_path


def plan(study, *rows, columns="participant,order,method,scenario,recording"):
    (study / "protocol.csv").write_text("\n".join([columns, *rows]) + "\n")


def rows_of(study):
    notes = measure(study / "protocol.csv", study / "ground_truth", study / "out")
    return read_sheet(study / "out" / "runs.csv", ()).to_dict("records"), notes


def test_measures_of_one_recording_per_run(study):
    grid = room()
    # the ground truth; then a smaller area
    Lab(study / "a", grid).interaction("ia", *EXACT)
    Lab(study / "b", grid, ()).interaction("i0", save=False, method="robot_only").interaction(
        "ib", (0.751, 0.251), (2.249, 0.749), method="robot_only"
    )
    # `cameras:=none` was forgotten in a robot_only run
    Lab(study / "c", grid).interaction("ic", *EXACT, method="robot_only")
    (study / "a" / "run.yaml").write_text("revision: abc\n")
    runs = ("p1,1,nrs,carpet,a,,", "p1,2,robot_only,carpet,b,yes,slow", "p2,1,robot_only,carpet,c,,")
    plan(study, *runs, columns="participant,order,method,scenario,recording,completed,note")
    rows, notes = rows_of(study)
    assert [(row["participant"], row["method"]) for row in rows] == [(run[:2], run.split(",")[2]) for run in runs]
    assert [row["order"] for row in rows] == ["1", "2", "1"] and rows[0]["revision"] == "abc"
    assert [row["completed"] for row in rows] == ["1", "1", "0"]
    assert [row["outcome"] for row in rows] == ["completed", "completed", "not_as_planned"]
    assert [float(rows[0][f"time_{name}_s"]) for name in ("border", "seed", "total")] == [8.0, 2.0, 10.0]
    assert float(rows[0]["jaccard"]) == 1.0 and float(rows[1]["jaccard"]) == 0.5
    assert float(rows[1]["time_total_s"]) == 20.0  # the cancelled attempt counts
    assert rows[1]["interaction"] == "ib" and rows[1]["note"] == "slow"
    assert float(rows[0]["error_mean_cm"]) == 0.0
    assert [row["as_planned"] for row in rows] == ["1", "1", "0"]
    assert len(notes) == 1 and "cameras green instead of none" in notes[0]
    assert list(read_study(study / "out").runs.recording) == ["a", "b"]
    assert json.loads((study / "out" / "study.json").read_text())["people"] is True


@pytest.mark.parametrize("log, words", [('{"interaction_id": "a"}\n', "line 1"), ("\n{broken\n", "line 2")])
def test_damaged_recordings_name_file_and_line(log, words, tmp_path):
    (tmp_path / "interactions.jsonl").write_text(log)
    with pytest.raises(CodedError, match=f"interactions.jsonl, {words}"):
        Recording(tmp_path)
    with pytest.raises(CodedError, match="nowhere"):
        Recording(tmp_path / "nowhere")


def test_nothing_is_deleted_unasked(study):
    (study / "out" / "maps").mkdir(parents=True)
    (study / "out" / "maps" / "mine.txt").write_text("keep me")
    Lab(study / "a", room()).interaction("i")
    plan(study, "p1,1,nrs,carpet,a")
    rows_of(study)
    assert (study / "out" / "maps" / "mine.txt").read_text() == "keep me"
    (study / "out" / "study.json").write_text("{}")
    with refused("other_study"):
        rows_of(study)


# ------------------------------------------------------------------ running
@pytest.fixture
def planned(tmp_path):
    path = tmp_path / "protocol.csv"
    assert main(["plan", "--participants", "2", "--out", str(path)]) == 0
    return path


def events_of(folder):
    return [json.loads(line) for line in (folder / "events.jsonl").read_text().splitlines()]


def test_orders_are_drawn_again_for_every_plan(tmp_path):
    assert main(["plan", "--out", str(tmp_path / "other.csv")]) == main(["plan", "--out", str(tmp_path / "a.csv")]) == 0
    assert (tmp_path / "other.csv").read_text() != (tmp_path / "a.csv").read_text()


def do(planned, keys):
    conduct.conduct_run(planned, lambda plan: lambda: None, iter(keys), lambda words: None)


def test_runs_come_in_the_planned_order_in_their_condition(planned, monkeypatch, capsys):
    entries, started = protocol.read(planned)[:6], []
    monkeypatch.setattr(conduct, "roslaunch", lambda run: started.append(run) or (lambda: None))
    monkeypatch.setattr(conduct, "read_keys", lambda: iter(["b", "h", "n", "slow today", "c"]))
    for entry in entries:
        assert "hand out" not in capsys.readouterr().out
        assert main(["run", "p01", "--protocol", str(planned)]) == 0 and started[-1].entry == entry
    assert f"hand out questionnaire_{entries[0].method}_first.html" in capsys.readouterr().out
    for entry, command in zip(entries, (run.command for run in started)):
        assert f"method:={entry.method}" in command and f"record:={planned.parent / entry.recording}" in command
        assert ("cameras:=none" in command) == (entry.method == "robot_only")
    notes = events_of(planned.parent / entries[0].recording)
    assert [note["key"] for note in notes] == ["b", "h", "n", "c"] and notes[2]["text"] == "slow today"
    assert notes[0]["time"] <= notes[-1]["time"]
    recorded = Recording(planned.parent / entries[0].recording).run
    assert recorded["order"] == 1 and recorded["method"] == entries[0].method and recorded["revision"]
    assert recorded["completed"] is True
    with refused("all_done"):
        conduct.next_run(planned, "p01")
    with refused("no_participant"):
        conduct.next_run(planned, "p07")


def test_a_system_that_came_up_otherwise_is_told_at_once(planned):
    run, said = conduct.next_run(planned, "p01"), []
    other = "robot_only" if run.entry.method == "nrs" else "nrs"

    def start(plan):
        Lab(plan.folder, room(), ["blue"]).interaction("i", method=other)
        return lambda: None

    conduct.conduct_run(run, start, iter("bc"), said.append)
    assert any(f"method:={other}" in words for words in said) and any(
        "cameras blue instead of" in words for words in said
    )
    silent = conduct.conduct_run(conduct.next_run(planned, "p02"), lambda plan: lambda: None, iter("c"), said.append)
    assert silent["recorded"] is False and "nothing was recorded" in said[-1]


def test_a_run_that_broke_off_is_kept_and_done_again_beside_it(planned):
    first = conduct.next_run(planned, "p02")
    do(first, ["b", "p"])  # the terminal was closed
    with refused("unfinished"):
        conduct.next_run(planned, "p02")
    again = conduct.next_run(planned, "p02", again=True)
    assert again.entry == first.entry and again.folder != first.folder
    do(again, ["b", "f"])
    assert events_of(first.folder) and last_attempt(first.folder) == again.folder
    (again.folder / "bags").mkdir()
    (again.folder / "bags" / "session.bag").write_bytes(b"#ROSBAG V2.0\n")  # a torn one does not stop the next run
    assert conduct.next_run(planned, "p02").entry.order == 2


def test_power_lists_the_people_that_an_effect_needs(capsys):
    assert main(["power"]) == main(["power", "--tests", "1"]) == 0
    listed = re.findall(r"^  (.*): (\d+)$", capsys.readouterr().out, re.M)
    assert listed[2::7] == [("0.6", "34"), ("0.6", "25")] and listed[4] == ("1.0", "15")


def test_forms_are_written_once(tmp_path):
    written = {path.name for path in forms.write(tmp_path / "forms")}
    assert {"information.md", "consent.md", "preregistration.md", "codebook.csv", "demographics.html"} <= written
    pages = [(tmp_path / "forms" / f"questionnaire_{first}_first.html").read_text() for first in ("robot_only", "nrs")]
    titles = [re.findall("Method: (.*)</h2>", page) for page in pages]
    assert titles == [["robot only", "network robot system"], titles[0][::-1]] and "http://" not in pages[0]
    with pytest.raises(CodedError):
        forms.write(tmp_path / "forms")


def test_the_codebook_explains_every_column_and_outcome(tmp_path):
    forms.write(tmp_path)
    book = read_sheet(tmp_path / "codebook.csv", ("file", "column", "values", "meaning"))
    of_runs = book[book.file == "runs.csv"]
    assert set(of_runs.column) == set(recording_measures.COLUMNS)
    told = set(of_runs["values"][of_runs.column == "outcome"])
    flags = (True, False)
    assert told - {"unreadable"} == {
        recording_measures.outcome_of(*of, noted) for of in product(flags, repeat=4) for noted in (None, *flags)
    }
    asked = (tmp_path / "demographics.csv").read_text().strip().split(",")[1:]
    assert asked == list(book.column[book.file == "demographics.csv"])


MISHAPS = {  # recording: (what happened, outcome, completed)
    "good": ("", "completed", "1"),
    "crash": ("the system died before anything was begun; f was pressed", "not_started", ""),
    "given_up": ("cancelled, with help and a problem of the system", "not_saved", "0"),
    "claimed": ("cancelled, but noted as completed", "disputed", "0"),
    "wrong": ("seed on the other side", "wrong_seed", "0"),
    "wrong_claimed": ("seed on the other side, but noted as completed", "disputed", "0"),
    "refused": ("saved as asked, but the judge says no", "judged_failed", "0"),
    "other": ("with the other method", "not_as_planned", "0"),
    "torn": ("the disk was full: no map of what was saved", "unreadable", ""),
    "gone": ("its folder was lost", "unreadable", ""),
}


@pytest.fixture
def mishaps(study):
    """A study in which every mishap happened, and one pair without any."""
    lines = []
    for number, name in enumerate(MISHAPS, 1):
        person, lab = f"p{number}", Lab(study / name, room())
        if name in ("given_up", "claimed"):
            lab.interaction("i", save=False)
        elif name != "crash":
            seed = {"seed": (3.2, 2.0)} if name.startswith("wrong") else {}
            lab.interaction("i", *EXACT, **seed, method="robot_only" if name == "other" else "nrs")
        Lab(study / f"{name}_alone", room(), ()).interaction("i", *EXACT, method="robot_only")
        lines += [f"{person},1,nrs,carpet,{name},,Ann was late", f"{person},2,robot_only,carpet,{name}_alone,,"]
    for name, completed in (("crash", False), ("claimed", True), ("wrong_claimed", True)):
        (study / name / "run.yaml").write_text(f"completed: {str(completed).lower()}\nended: now\n")
    (study / "torn" / "bags" / "session.bag").write_bytes(b"#ROSBAG V2.0\n")
    shutil.rmtree(study / "gone")
    for key in "hhp":
        append_line(study / "given_up" / "events.jsonl", json.dumps({"key": key, "time": "now"}))
    plan(study, *lines, columns="participant,order,method,scenario,recording,completed,note")
    (study / "demographics.csv").write_text("participant,age,experience\np1,28,3\np2,55,5\n")
    return study


def test_every_mishap_is_what_it_is_in_every_table(mishaps):
    rows_of(mishaps)
    # the judge sees what was drawn, but not by whom, with which method or in which order
    assert main(["judge", str(mishaps / "out")]) == 0
    pictures = mishaps / "judging"
    key = read_sheet(mishaps / "judging_key.csv", ("code", "recording")).set_index("recording").code
    assert {path.stem for path in pictures.glob("*.png")} == set(key) and "crash" not in key and "given_up" not in key
    (pictures / "judgements.csv").write_text(f"code,completed\n{key['refused']},no\n{key['good']},yes\n")
    rows, notes = rows_of(mishaps)
    found = {row["recording"]: row for row in rows}
    assert {name: (found[name]["outcome"], found[name]["completed"]) for name in MISHAPS} == {
        name: (outcome, completed) for name, (_, outcome, completed) in MISHAPS.items()
    }
    assert (found["given_up"]["helped"], found["given_up"]["problems"], found["good"]["helped"]) == ("2", "1", "0")
    assert float(found["wrong"]["jaccard"]) < 0.01 and found["crash"]["time_total_s"] == ""
    assert [line["warning"] for line in read_sheet(mishaps / "out" / "warnings.csv", ()).to_dict("records")] == notes
    assert len(notes) == 7  # crash, claimed, wrong_claimed, refused, other, torn, gone
    assert "session.bag" in notes[-2] and "there is no folder" in notes[-1]

    page = write_report(mishaps / "out").read_text()
    tables = {path.stem: read_sheet(path, ()).to_dict("records") for path in (mishaps / "out" / "tables").glob("*.csv")}
    nrs, alone = tables["completeness"]
    assert (nrs["completed"], alone["completed"]) == ("1 of 6", "10 of 10")
    became = tables["outcomes"][0]
    assert [became[name] for name in ("not_started", "unreadable", "disputed", "judged_failed")] == ["1", "2", "2", "1"]
    assert (became["helped"], became["problems"]) == ("1", "1") and "not_as_planned" not in became
    # one completed with both methods, five only with the robot alone, none only with the network: exact p of 0 of 5
    (pairs,) = tables["who_completed"]
    assert [pairs[name] for name in ("both", "first", "second", "neither", "p")] == ["1", "0", "5", "0", ".062"]
    # the repeated analysis leaves out people who were helped
    whole, without = tables["summary"][0], tables["summary_without_help"][0]
    assert (whole["pairs"], without["pairs"], tables["not_completed"][0]["outcome"]) == ("6", "5", "not_saved")
    # accuracy is that of completed runs only, so that it contains no index of a wrong seed
    accuracy = {row["method"]: row for row in tables["accuracy"]}
    assert accuracy["Network robot system"]["runs"] == "1" and float(accuracy["Network robot system"]["least"]) == 1.0
    assert "nothing was begun in this recording" in page and "1 runs were not done in the planned condition" in page
    assert "M = 41.5, SD = 19.1, 28 to 55" in page


def test_an_export_identifies_nobody_and_data_is_deleted_on_request(mishaps):
    rows_of(mishaps)
    assert main(["export", str(mishaps / "out"), "--out", str(mishaps / "shared")]) == 0
    shared = read_sheet(mishaps / "shared" / "runs.csv", ())
    text = "".join(path.read_text() for path in (mishaps / "shared").iterdir())
    assert len(shared) == 2 * len(MISHAPS) and not {"note", "recording", "map"} & set(shared) and "Ann" not in text
    assert not {f"p{number}" for number in range(1, 11)} & set(shared.participant)
    people = read_sheet(mishaps / "shared" / "demographics.csv", ())
    assert set(people.age) == {"20 to 29", "50 to 59"} and set(people.participant) < set(shared.participant)
    with pytest.raises(CodedError):
        privacy.export(mishaps / "out", mishaps / "shared")

    blind_judging.write(mishaps, mishaps / "out")
    code = read_sheet(mishaps / "judging_key.csv", ()).set_index("recording").code["good"]
    assert main(["delete", "p1", "--protocol", str(mishaps / "protocol.csv")]) == 0
    assert not (mishaps / "good").exists() and not (mishaps / "good_alone").exists() and (mishaps / "crash").exists()
    assert not (mishaps / "judging" / f"{code}.png").exists() and code not in (mishaps / "judging_key.csv").read_text()
    assert list(read_sheet(mishaps / "demographics.csv", ()).participant) == ["p2"]
    assert list((mishaps / "out" / "maps").glob("p1_*"))
    rows, _ = rows_of(mishaps)
    assert not list((mishaps / "out" / "maps").glob("p1_*"))
    assert "p1" not in {row["participant"] for row in rows} and len(rows) == 2 * len(MISHAPS) - 2
    with pytest.raises(CodedError):
        privacy.delete(mishaps / "protocol.csv", "p99")
    shutil.rmtree(mishaps / "judging")  # the judge has it
    privacy.delete(mishaps / "protocol.csv", "p2")
    assert not len(read_sheet(mishaps / "demographics.csv", ()))


def test_seed_is_right_if_the_nearest_free_floor_was_asked_for():
    grid = room()
    free = np.argwhere(grid.data == 0)
    centers = grid.cell_to_world(free)
    for seed in np.random.default_rng(6).uniform(-0.6, 4.4, (300, 2)):
        away = np.hypot(*(centers - seed).T)
        nearest = int(away.argmin())
        for truth in (truth_of(grid), grid.data == 0):  # the second reaches to the walls
            assert seed_is_right(seed, grid, truth) == (away[nearest] <= 0.2 and truth[tuple(free[nearest])])
    walls = grid.with_data(np.full(grid.shape, 100, np.int8))
    assert not seed_is_right((1.0, 1.0), walls, grid.data == 0)


def test_the_newest_of_a_runs_recordings_counts(tmp_path):
    assert last_attempt(tmp_path / "p1") == tmp_path / "p1"
    for name in ("p1", "p1_2", "p1_10", "p1_x", "p10"):
        (tmp_path / name).mkdir()
    assert [path.name for path in recording_measures.attempts(tmp_path / "p1")] == ["p1", "p1_2", "p1_10"]
    assert last_attempt(tmp_path / "p1").name == "p1_10"
