"""Our configuration of twist_mux against its rules: twist_mux is not among Debian's packages.

The rules are those of its sources for Noetic (3.1): TwistMux::getTopicHandles reads name, topic, timeout and priority
of each entry of ~topics and ~locks by their XML-RPC types; TwistMux::hasPriority compares names, and begins with
priority 0.
"""
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import yaml

PACKAGE = Path(__file__).resolve().parents[1]
CONFIG = yaml.safe_load((PACKAGE / "config" / "twist_mux.yaml").read_text())
ROBOT = ElementTree.parse(str(PACKAGE.parents[1] / "launch" / "parts" / "robot.launch")).getroot()
HANDED_ON = 0.5  # [s] after whoever drove has died; the base has stopped before by its own timeout
TOPICS = {entry["name"]: entry for entry in CONFIG["topics"]}


def node(kind):
    return next(child for child in ROBOT.findall("node") if child.get("type") == kind)


def test_every_entry_has_the_fields_and_types_that_twist_mux_reads():
    assert set(CONFIG) == {"topics", "locks"}, "a list that is missing is a fatal error in its log"
    for entry in [*CONFIG["topics"], *CONFIG["locks"]]:
        assert set(entry) == {"name", "topic", "timeout", "priority"}
        # XML-RPC does not make a double of an integer: the node would end with an exception
        types = {"name": str, "topic": str, "timeout": float, "priority": int}
        assert {key: type(value) for key, value in entry.items()} == types
        assert re.fullmatch(r"[a-zA-Z][\w/]*", entry["topic"]), "relative, so that each robot has its own"
        assert 0.0 < entry["timeout"] and 1 <= entry["priority"] <= 255, "0 never has its turn"


def test_names_topics_and_priorities_are_unique():
    for key in ("name", "topic", "priority"):
        values = [entry[key] for entry in CONFIG["topics"]]
        assert len(set(values)) == len(values), key


def test_monitor_comes_before_guide_before_navigation():
    order = sorted(TOPICS, key=lambda name: -TOPICS[name]["priority"])
    assert order == ["monitor", "guide", "navigation"]


def test_who_speaks_keeps_the_word_and_who_died_does_not_keep_it_long():
    files = [PACKAGE / "config" / f"{name}.yaml" for name in ("robot_guide", "workspace_monitor")]
    guide, monitor = (yaml.safe_load(path.read_text()) for path in files)
    rates = {"guide": guide["rate"], "monitor": min(monitor["rate"], monitor["exit_rate"])}
    for name, rate in rates.items():
        assert 2.0 / rate <= TOPICS[name]["timeout"] <= HANDED_ON, "one message may be late"


def test_launch_file_and_configuration_name_the_same_topics():
    for kind, name in (("robot_guide", "guide"), ("workspace_monitor", "monitor")):
        remap = next(remap for remap in node(kind).findall("remap") if remap.get("from") == "cmd_vel")
        assert (remap.get("if"), remap.get("to")) == ("$(arg mux)", TOPICS[name]["topic"])
    mux = node("twist_mux")
    assert mux.get("if") == "$(arg mux)"
    assert mux.find("rosparam").get("file").endswith("vb_robot)/config/twist_mux.yaml")
    assert [(remap.get("from"), remap.get("to")) for remap in mux.findall("remap")] == [("cmd_vel_out", "cmd_vel")]
