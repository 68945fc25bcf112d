"""The files of the interaction manager."""

from __future__ import annotations

import json
import os

import pytest

from vb_core.errors import CodedError, ParameterError
from vb_core.files import append_line
from vb_voice_wizard.session import Record
from vb_voice_wizard.dialogue.persistence import StateFile, file_path, record_line

RECORD = Record("i1", "saved", "b7", 10.0, 31.23456, 1.0, 15.0, 5.23456, 21.23456, ("voice", "wizard"))


def test_state_file_round_trip(tmp_path):
    path = str(tmp_path / "state.json")
    assert StateFile(path, "run").read() is None
    StateFile(path, "run").write({"interaction": {"a": 1}})
    assert StateFile(path, "run").read()["interaction"] == {"a": 1}
    StateFile(path, "run").write({"interaction": {"a": 2}})
    assert StateFile(path, "run").read()["interaction"] == {"a": 2}
    assert os.listdir(str(tmp_path)) == ["state.json"]


def test_state_of_another_run_is_not_ours(tmp_path):
    path = str(tmp_path / "state.json")
    StateFile(path, "run").write({"a": 1})
    assert StateFile(path, "other").read() is None
    StateFile(path, "").write({"a": 1})
    assert StateFile(path, "").read() is None


@pytest.mark.parametrize("content", ["", "{", "[]", "3", "\x00\x01"])
def test_damaged_state_file(tmp_path, content):
    path = tmp_path / "state.json"
    path.write_text(content)
    with pytest.raises(CodedError) as caught:
        StateFile(str(path), "run").read()
    assert caught.value.code == "bad_state_file"


def test_record_is_one_line_of_json(tmp_path):
    path = str(tmp_path / "log.jsonl")
    for method in ("nrs", "robot_only"):
        append_line(path, record_line(RECORD, method, ["red"]))
    lines = open(path).read().splitlines()
    assert len(lines) == 2
    fields = json.loads(lines[1])
    assert fields["method"] == "robot_only" and fields["cameras"] == ["red"]
    assert fields["sources"] == ["voice", "wizard"] and fields["border_id"] == "b7"
    assert fields["seed_s"] == 5.235 and fields["outcome"] == "saved"


def test_a_line_goes_into_a_folder_that_is_made_for_it(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    path = file_path("~log_file", "~/a/b/log.jsonl")
    append_line(path, "{}")
    assert (tmp_path / "a" / "b" / "log.jsonl").read_text() == "{}\n"


def test_the_state_is_remembered_in_a_folder_that_is_made_for_it(tmp_path):
    """Before the first record there may be none, and a stop has to be remembered from the first second on."""
    state = StateFile(str(tmp_path / "new" / "state.json"), "run")
    state.write({"stopped": True})
    assert state.read()["stopped"] is True


def test_a_folder_is_no_file(tmp_path):
    with pytest.raises(ParameterError) as caught:
        file_path("~log_file", str(tmp_path))
    assert caught.value.key == "~log_file"


def test_a_disk_that_cannot_be_written_ends_nothing_before_something_is_written(tmp_path):
    (tmp_path / "file").write_text("")
    path = file_path("~log_file", str(tmp_path / "file" / "log"))
    with pytest.raises(OSError):
        append_line(path, "{}")
    (tmp_path / "file").unlink()
    append_line(path, "{}")
