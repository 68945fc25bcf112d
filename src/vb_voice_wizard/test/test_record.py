"""The files of the interaction manager."""

from __future__ import annotations

import json

import pytest

from vb_core.errors import ParameterError
from vb_core.files import append_line
from vb_voice_wizard.session import Record
from vb_voice_wizard.dialogue.record import file_path, record_line

RECORD = Record("i1", "saved", "b7", 10.0, 31.23456, 1.0, 15.0, 5.23456, 21.23456, ("voice", "wizard"))


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


def test_a_folder_is_no_file(tmp_path):
    with pytest.raises(ParameterError) as caught:
        file_path("~log_file", str(tmp_path))
    assert caught.value.key == "~log_file"
