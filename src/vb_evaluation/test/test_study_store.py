"""Rows that survive an interruption."""

import json
import subprocess
import sys

import pytest

from vb_core.errors import CodedError
from vb_evaluation.report.data import META, read_meta
from vb_evaluation.study.store import RowFile, open_folder

COLUMNS = ("participant", "scenario", "value")


def file(path):
    return RowFile(path / "runs.csv", COLUMNS, ("participant", "scenario"))


def test_rows_are_kept(tmp_path):
    rows = file(tmp_path)
    rows.append({"participant": 1, "scenario": "room", "value": 0.5})
    rows.append({"participant": 2, "scenario": "a, b", "value": ""})
    again = file(tmp_path)
    assert list(again.rows) == [("1", "room"), ("2", "a, b")] and again.rows["2", "a, b"]["value"] == ""


@pytest.mark.parametrize("rest", [b"2,carpet", b"2,carpet,0.", b"\xff"])
def test_a_row_that_was_cut_off_is_forgotten(tmp_path, rest):
    file(tmp_path).append({"participant": 1, "scenario": "room", "value": 0.5})
    with open(str(tmp_path / "runs.csv"), "ab") as stream:
        stream.write(rest)
    again = file(tmp_path)
    assert list(again.rows) == [("1", "room")]
    again.append({"participant": 2, "scenario": "carpet", "value": 1})
    assert (tmp_path / "runs.csv").read_text() == "participant,scenario,value\n1,room,0.5\n2,carpet,1\n"


def test_the_order_does_not_tell_who_was_ready_first(tmp_path):
    rows = file(tmp_path)
    for participant in (3, 1, 2):
        rows.append({"participant": participant, "scenario": "room", "value": 0})
    rows.write([(str(number), "room") for number in (1, 2)])
    assert list(file(tmp_path).rows) == [("1", "room"), ("2", "room"), ("3", "room")]


def test_other_columns_are_refused(tmp_path):
    (tmp_path / "runs.csv").write_text("participant,colour\n1,red\n")
    with pytest.raises(CodedError, match="other columns"):
        file(tmp_path)


def test_another_configuration_is_refused_or_thrown_away(tmp_path):
    open_folder(tmp_path, "abc", False, {"seed": 1})
    file(tmp_path).append({"participant": 1, "scenario": "room", "value": 0.5})
    open_folder(tmp_path, "abc", False, {"seed": 1})
    with pytest.raises(CodedError, match="FRESH=1"):
        open_folder(tmp_path, "def", False, {})
    assert (tmp_path / "runs.csv").exists() and read_meta(tmp_path / META)["configuration"] == "abc"
    open_folder(tmp_path, "def", True, {"seed": 2})
    assert not (tmp_path / "runs.csv").exists() and read_meta(tmp_path / META) == {"configuration": "def", "seed": 2}


def test_rows_of_unknown_origin_are_refused(tmp_path):
    (tmp_path / "runs.csv").write_text("participant\n1\n")
    with pytest.raises(CodedError, match="of another configuration"):
        open_folder(tmp_path, "abc", False, {})
    (tmp_path / "study.json").write_text("{")
    with pytest.raises(CodedError, match="study.json"):
        open_folder(tmp_path, "abc", False, {})
    (tmp_path / "study.json").write_text(json.dumps([1]))
    with pytest.raises(CodedError):
        open_folder(tmp_path, "abc", False, {})


def test_a_study_needs_no_ros():
    blocked = (
        "rospy",
        "tf2_ros",
        "cv_bridge",
        "roslib",
        "actionlib",
        "vb_msgs",
        "std_msgs",
        "sensor_msgs",
        "nav_msgs",
        "geometry_msgs",
    )
    code = (
        f"import sys; sys.modules.update({{name: None for name in {blocked!r}}}); import vb_evaluation.study.__main__"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
