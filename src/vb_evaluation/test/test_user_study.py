"""The study kit: protocols, conducting runs in their order, forms, and data protection."""

import json
import re
from itertools import product
from types import SimpleNamespace

import pytest

from refusals import refused
from vb_testing import assert_fields
from study_recordings import EXACT, RecordedLab, make_study, measure_study, write_protocol
from vb_core.errors import CodedError
from vb_evaluation.report.study_files import read_sheet
from vb_evaluation.user_study import blind_judging, conduct_run, forms, privacy, protocol
from vb_evaluation.user_study.__main__ import main
from vb_evaluation.user_study.recording import Recording
from vb_evaluation.user_study.recording_measures import COLUMNS, attempts, classify_outcome, last_attempt


# ------------------------------------------------------------------ protocol
def test_a_new_protocol_has_all_runs_and_no_result(tmp_path):
    path = tmp_path / "protocol.csv"
    protocol.write_protocol(path, protocol.plan_runs(2, ["room"], ["nrs", "robot_only"], 1))
    assert [entry.completed for entry in protocol.read_protocol(path)] == [None] * 4


def test_an_existing_protocol_is_not_overwritten(tmp_path):
    path = tmp_path / "protocol.csv"
    path.write_text("mine")
    with refused("cannot_write"):
        protocol.write_protocol(path, [])
    assert path.read_text() == "mine"


def test_a_run_that_did_not_take_place_is_left_out(tmp_path):
    path = tmp_path / "protocol.csv"
    path.write_text(f"{','.join(protocol.COLUMNS)}\np1,1,nrs,room,a,yes,fine\np2,1,nrs,room,,,ill\n")
    assert protocol.read_protocol(path) == [protocol.Entry("p1", "nrs", "room", "a", True, "fine", 1)]


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
    with pytest.raises(CodedError, match=words):
        protocol.read_protocol(tmp_path / "p.csv")


# ------------------------------------------------------------------ running
@pytest.fixture
def planned(tmp_path):
    """The path of a protocol of two participants."""
    path = tmp_path / "protocol.csv"
    assert main(["plan", "--participants", "2", "--out", str(path)]) == 0
    return path


def do_run(run, keys):
    """Conducts a run in which the experimenter presses these keys; the system records nothing. Returns what is said."""
    said = []
    conduct_run.conduct_run(run, lambda plan: lambda: None, iter(keys), said.append)
    return said


def events_of(folder):
    return [json.loads(line) for line in (folder / "events.jsonl").read_text().splitlines()]


def test_orders_are_drawn_again_for_every_plan(planned, tmp_path):
    assert main(["plan", "--participants", "2", "--out", str(tmp_path / "other.csv")]) == 0
    assert (tmp_path / "other.csv").read_text() != planned.read_text()


@pytest.fixture
def conducted(planned, monkeypatch, capsys):
    """The entries of the participant p01, the runs that the command `run` started for them, and what it printed."""
    started, said = [], []
    monkeypatch.setattr(conduct_run, "roslaunch", lambda run: started.append(run) or (lambda: None))
    monkeypatch.setattr(conduct_run, "read_keys", lambda: iter(["b", "h", "n", "slow today", "c"]))
    for _ in range(6):
        assert main(["run", "p01", "--protocol", str(planned)]) == 0
        said.append(capsys.readouterr().out)
    return SimpleNamespace(entries=protocol.read_protocol(planned)[:6], started=started, said=said)


def test_runs_come_in_the_planned_order(conducted):
    assert [run.entry for run in conducted.started] == conducted.entries


def test_the_system_is_started_in_the_runs_condition(conducted, planned):
    for entry, run in zip(conducted.entries, conducted.started):
        assert {f"method:={entry.method}", f"record:={planned.parent / entry.recording}"} <= set(run.command)
        assert ("cameras:=none" in run.command) == (entry.method == "robot_only")


def test_events_are_noted_in_their_order_with_their_text(conducted, planned):
    notes = events_of(planned.parent / conducted.entries[0].recording)
    assert [(note["key"], note["text"]) for note in notes] == [("b", ""), ("h", ""), ("n", "slow today"), ("c", "")]
    assert notes[0]["time"] <= notes[-1]["time"]


def test_a_recording_says_what_was_planned_and_how_it_ended(conducted, planned):
    entry = conducted.entries[0]
    recorded = Recording(planned.parent / entry.recording).run
    assert_fields(recorded, order=1, method=entry.method, completed=True)
    assert recorded["revision"]


def test_the_questionnaire_of_the_first_method_is_handed_out_at_the_end(conducted):
    form = f"hand out questionnaire_{conducted.entries[0].method}_first.html"
    assert [form in words for words in conducted.said] == [False] * 5 + [True]


@pytest.mark.parametrize("participant, code", [("p01", "all_done"), ("p07", "no_participant")])
def test_a_finished_or_unknown_participant_has_no_next_run(conducted, planned, participant, code):
    with refused(code):
        conduct_run.find_next_run(planned, participant)


def test_a_system_started_with_other_method_or_cameras_is_reported_at_once(planned):
    run, said = conduct_run.find_next_run(planned, "p01"), []
    other = "robot_only" if run.entry.method == "nrs" else "nrs"

    def start(plan):
        RecordedLab(plan.folder, ["blue"]).interaction("i", method=other)
        return lambda: None

    conduct_run.conduct_run(run, start, iter("bc"), said.append)
    output = " ".join(said)
    assert f"method:={other}" in output
    assert "cameras blue instead of" in output


def test_a_system_that_recorded_nothing_is_reported_at_once(planned):
    run = conduct_run.find_next_run(planned, "p02")
    assert "nothing was recorded" in do_run(run, "c")[-1]
    assert Recording(run.folder).run["recorded"] is False


def test_a_run_that_broke_off_is_kept_and_has_to_be_done_again(planned):
    first = conduct_run.find_next_run(planned, "p02")
    do_run(first, ["b", "p"])  # the terminal was closed
    with refused("unfinished"):
        conduct_run.find_next_run(planned, "p02")
    again = conduct_run.find_next_run(planned, "p02", again=True)
    do_run(again, ["b", "f"])
    assert again.entry == first.entry
    assert events_of(first.folder)
    assert again.folder == last_attempt(first.folder) != first.folder


def test_a_torn_recording_does_not_stop_the_next_run(planned):
    run = conduct_run.find_next_run(planned, "p02")
    do_run(run, ["b", "f"])
    (run.folder / "bags").mkdir()
    (run.folder / "bags" / "session.bag").write_bytes(b"#ROSBAG V2.0\n")
    assert conduct_run.find_next_run(planned, "p02").entry.order == 2


def test_the_newest_of_a_runs_recordings_counts(tmp_path):
    assert last_attempt(tmp_path / "p1") == tmp_path / "p1"
    for name in ("p1", "p1_2", "p1_10", "p1_x", "p10"):
        (tmp_path / name).mkdir()
    assert [path.name for path in attempts(tmp_path / "p1")] == ["p1", "p1_2", "p1_10"]
    assert last_attempt(tmp_path / "p1").name == "p1_10"


# ------------------------------------------------------------------ forms
def test_all_forms_are_written_and_existing_ones_not_overwritten(tmp_path):
    written = {path.name for path in forms.write_forms(tmp_path / "forms")}
    assert {"information.md", "consent.md", "preregistration.md", "codebook.csv", "demographics.html"} <= written
    with refused("cannot_write_into"):
        forms.write_forms(tmp_path / "forms")


def test_each_questionnaire_begins_with_its_method_and_loads_nothing(tmp_path):
    forms.write_forms(tmp_path)
    pages = [(tmp_path / f"questionnaire_{first}_first.html").read_text() for first in ("robot_only", "nrs")]
    titles = [re.findall("Method: (.*)</h2>", page) for page in pages]
    assert titles == [["robot only", "network robot system"], ["network robot system", "robot only"]]
    assert "http://" not in pages[0]


@pytest.fixture
def codebook(tmp_path):
    forms.write_forms(tmp_path)
    return read_sheet(tmp_path / "codebook.csv", ("file", "column", "values", "meaning"))


def test_the_codebook_explains_every_column(codebook, tmp_path):
    columns = (tmp_path / "demographics.csv").read_text().strip().split(",")[1:]
    assert set(codebook.column[codebook.file == "runs.csv"]) == set(COLUMNS)
    assert list(codebook.column[codebook.file == "demographics.csv"]) == columns


def test_the_codebook_explains_every_outcome(codebook):
    possible = {
        classify_outcome(is_as_planned=planned, is_saved=saved, seed_is_right=right, judged_completed=judged)
        for planned, saved, right, judged in product((True, False), (True, False), (True, False), (True, False, None))
    }
    never_returned = {"unreadable", "other_map", "not_started"}
    assert set(codebook["values"][codebook.column == "outcome"]) == possible | never_returned


# ------------------------------------------------------------------ data protection
@pytest.fixture
def study(tmp_path):
    """The folder of a study of two participants, measured and ready to be judged."""
    make_study(tmp_path)
    for name in ("a", "b"):
        RecordedLab(tmp_path / name).interaction("i", *EXACT)
    write_protocol(tmp_path, "p1,1,nrs,carpet,a,,Ann was late", "p2,1,nrs,carpet,b,,")
    (tmp_path / "demographics.csv").write_text("participant,age,experience\np1,28,3\np2,55,5\n")
    measure_study(tmp_path)
    blind_judging.write_judging_sheet(tmp_path, tmp_path / "out")
    return tmp_path


def test_the_judge_gets_the_pictures_in_the_study_that_was_named(study):
    assert main(["judge", str(study / "out"), "--study", str(study / "a")]) == 0
    codes = read_sheet(study / "a" / "judging_key.csv", ("recording",)).code
    assert [(study / "a" / "judging" / f"{code}.png").exists() for code in codes] == [True, True]


def test_an_export_has_no_words_folders_or_numbers_of_participants(study):
    assert main(["export", str(study / "out"), "--out", str(study / "shared")]) == 0
    shared = read_sheet(study / "shared" / "runs.csv", ())
    assert len(shared) == 2
    assert not {"note", "recording", "map"} & set(shared)
    text = "".join(path.read_text() for path in (study / "shared").iterdir())
    assert not [word for word in ("Ann", "p1", "p2") if word in text]


def test_an_export_has_age_bands_under_the_same_new_numbers(study):
    privacy.export(study / "out", study / "shared")
    people, runs = (read_sheet(study / "shared" / name, ()) for name in ("demographics.csv", "runs.csv"))
    assert set(people.age) == {"20 to 29", "50 to 59"}
    assert set(people.participant) == set(runs.participant)


def test_an_export_overwrites_nothing(study):
    (study / "shared").mkdir()
    with refused("cannot_write_into"):
        privacy.export(study / "out", study / "shared")


def test_a_participants_recordings_answers_and_pictures_are_deleted_on_request(study):
    code = read_sheet(study / "judging_key.csv", ()).set_index("recording").code["a"]
    assert main(["delete", "p1", "--protocol", str(study / "protocol.csv")]) == 0
    assert [(study / name).exists() for name in ("a", "b")] == [False, True]
    assert list(read_sheet(study / "demographics.csv", ()).participant) == ["p2"]
    assert not (study / "judging" / f"{code}.png").exists()
    assert code not in (study / "judging_key.csv").read_text()


def test_a_participants_results_are_gone_once_measured_again(study):
    privacy.delete(study / "protocol.csv", "p1")
    assert list((study / "out" / "maps").glob("p1_*"))
    rows, _ = measure_study(study)
    assert [row["participant"] for row in rows.values()] == ["p2"]
    assert not list((study / "out" / "maps").glob("p1_*"))


def test_a_participant_is_deleted_also_while_the_judge_has_the_pictures(study):
    (study / "judging").rename(study / "at the judge's")
    privacy.delete(study / "protocol.csv", "p2")
    assert list(read_sheet(study / "demographics.csv", ()).participant) == ["p1"]


def test_an_unknown_participant_cannot_be_deleted(study):
    with refused("no_participant"):
        privacy.delete(study / "protocol.csv", "p99")
