"""Parameters, also changed while a node runs; the server itself is tested with a real node in vb_laser_detect."""

import pickle
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Tuple

import pytest
import rospy
from dynamic_reconfigure.encoding import decode_description, encode_description

from vb_testing import assert_fields
from vb_core.errors import CodedError, ParameterError
from vb_core.parameters import Parameters, param
from vb_core.ros import reconfigure


@dataclass(frozen=True)
class Example(Parameters):
    speed: float = param(0.2, "m/s", low=0.0, high=1.0, doc="of the robot")
    size: float = param(1.0, "m", above=0.0)
    count: int = param(3, low=1)
    mode: str = param("fast", choices=("fast", "good"))
    on: bool = param(True)
    limits: Tuple[float, ...] = param((0.1, 0.2), low=0.0)
    fixed: float = param(0.5)

    def __post_init__(self):
        super().__post_init__()
        if self.speed > self.size:
            raise ParameterError("speed", f"must be at most size = {self.size}, got {self.speed}")


@dataclass(frozen=True)
class Groups(Parameters):
    example: Example = param(Example())
    parts: tuple = param((), of=Example)


def test_groups_and_list_entries_are_checked():
    groups = Groups.from_mapping({"example": {"speed": 1}, "parts": [{}, {"count": 5}]})
    assert groups == Groups(Example(speed=1.0), (Example(), Example(count=5)))
    assert Groups(Example(speed=1.0)).describe() == "example/speed=1.0 m/s"
    assert Groups.from_mapping({"example": None}) == Groups()
    mistakes = (
        ({"example": {"speed": 7.0}}, "example/speed"),
        ({"example": {"sped": 0.1}}, "example/sped"),
        ({"example": 3}, "example"),
        ({"parts": [{}, {"size": 0.0}]}, "parts[1]/size"),
        ({"parts": 3}, "parts"),
    )
    for mapping, key in mistakes:
        with pytest.raises(ParameterError) as caught:
            Groups.from_mapping(mapping, "/node")
        assert caught.value.key == f"/node/{key}"


def test_values_given_replace_the_defaults():
    params = Example.from_mapping({"speed": 1, "limits": [0.0, 1.0]})
    assert repr(params.speed) == "1.0", "a whole number is read as a real one"
    assert_fields(params, limits=(0.0, 1.0), count=3)
    assert params.describe() == "speed=1.0 m/s, limits=(0.0, 1.0)"
    assert Example.from_mapping(None) == Example()
    assert Example().describe() == ""


@pytest.mark.parametrize(
    "key, value, word",
    [
        ("sped", 0.1, "unknown"),
        ("speed", 1.5, "at most 1.0 m/s"),
        ("speed", -0.1, "at least 0.0 m/s"),
        ("speed", "quick", "number"),
        ("speed", True, "number"),
        ("speed", float("nan"), "number"),
        ("size", 0.0, "above 0.0 m"),
        ("count", 2.5, "whole number"),
        ("count", False, "whole number"),
        ("mode", "slow", "fast, good"),
        ("mode", 3, "text"),
        ("on", 1, "true or false"),
        ("limits", 3, "list"),
        ("limits", [0.1, -1.0], "at least"),
        ("limits", [0.1, float("nan")], "finite"),
        ("limits", ["0.1"], "finite"),
        ("size", float("inf"), "finite"),
    ],
)
def test_each_mistake_names_its_key(key, value, word):
    with pytest.raises(ParameterError) as caught:
        Example.from_mapping({key: value}, "/node")
    assert caught.value.key == f"/node/{key}"
    sentence_key, _, mistake = caught.value.message.partition(": ")
    assert sentence_key == f"/node/{key}"
    assert word in mistake


def test_a_mistake_can_be_raised_in_another_process():
    mistake = ParameterError("/node/speed", "must be finite")
    copied = pickle.loads(pickle.dumps(mistake))
    assert copied.key == mistake.key
    assert str(copied) == str(mistake)


# ------------------------------------------------------------------ changed while a node runs
def test_the_description_follows_from_the_fields():
    description = reconfigure.reconfigure_description(Example(speed=0.5), fixed=("fixed",))
    entries = {entry["name"]: entry for entry in description.config_description["parameters"]}
    assert list(entries) == ["speed", "size", "count", "on"]
    assert_fields(entries["speed"], type="double", description="of the robot [m/s]", min=0.0, max=1.0, default=0.5)
    assert (entries["count"]["min"], entries["count"]["max"]) == (1, 2**31 - 1)
    # as clients decode it
    decoded = decode_description(encode_description(description))
    assert {entry["name"] for entry in decoded["parameters"]} == set(entries)


@pytest.fixture
def tuned(monkeypatch):
    """A node's parameters: `change` changes values as a server does; the values stored, applied and warned of."""
    stored, applied, warned = {}, [], []
    monkeypatch.setattr(reconfigure, "Server", lambda *_: None)
    monkeypatch.setattr(rospy, "set_param", stored.__setitem__)
    monkeypatch.setattr(rospy, "resolve_name", lambda name: "/node" + name.replace("~", "/"))
    monkeypatch.setattr(rospy, "loginfo", lambda *_: None)
    monkeypatch.setattr(rospy, "logwarn", lambda text, *values: warned.append(text % values))

    def apply(params):
        if params.count == 13:
            raise CodedError("unlucky", "no")
        applied.append(params)

    node = reconfigure.ReconfigureServer(Example(), "~limits", apply)
    config = {name: getattr(Example(), name) for name in ("speed", "size", "count", "on")}

    def change(**values):
        config.update(node._change({**config, **values}, 1))
        return config

    return SimpleNamespace(change=change, stored=stored, applied=applied, warned=warned)


def test_a_change_is_applied_once(tuned):
    assert tuned.change()["speed"] == tuned.stored["~limits/speed"] == 0.2
    assert tuned.applied == []
    assert tuned.change(speed=0.3)["speed"] == 0.3
    tuned.change(speed=0.3)
    assert_fields(tuned, applied=[Example(speed=0.3)], warned=[])


@pytest.mark.parametrize("key, new, why", [("size", 0.1, "at most size"), ("size", 0, "above 0"), ("count", 13, "no")])
def test_a_refused_change_changes_nothing(tuned, key, new, why):
    tuned.change(speed=0.3)
    config = tuned.change(on=False, **{key: new})
    assert config == {"speed": 0.3, "size": 1.0, "count": 3, "on": True}
    assert len(tuned.applied) == 1
    (warning,) = tuned.warned
    assert why in warning
    assert tuned.change(speed=0.4)["speed"] == 0.4
