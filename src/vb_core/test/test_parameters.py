"""Parameters, also changed while a node runs; the server's own part is tested over a real node in vb_laser_detect."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Tuple

import pytest
import rospy
from dynamic_reconfigure.encoding import decode_description, encode_description

from vb_core.errors import CodedError, ParameterError
from vb_core.parameters import Parameters, param
from vb_core.ros import reconfigure


@dataclass(frozen=True)
class Example(Parameters):
    speed: float = param(0.2, "m/s", low=0.0, high=1.0)
    size: float = param(1.0, "m", above=0.0)
    count: int = param(3, low=1)
    mode: str = param("fast", choices=("fast", "good"))
    on: bool = param(True)
    limits: Tuple[float, ...] = param((0.1, 0.2), low=0.0)


@dataclass(frozen=True)
class Groups(Parameters):
    example: Example = param(Example())
    parts: tuple = param((), of=Example)


def test_groups_and_list_entries_are_checked_as_parameters_are():
    found = Groups.from_mapping({"example": {"speed": 1}, "parts": [{}, {"count": 5}]})
    assert found == Groups(Example(speed=1.0), (Example(), Example(count=5)))
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


def test_defaults_and_values():
    params = Example.from_mapping({"speed": 1, "limits": [0.0, 1.0]})
    assert params.speed == 1.0 and isinstance(params.speed, float)
    assert params.limits == (0.0, 1.0) and params.count == 3
    assert params.describe() == "speed=1.0 m/s, limits=(0.0, 1.0)"
    assert Example.from_mapping(None) == Example() and not Example().describe()


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
    ],
)
def test_each_mistake_names_its_key(key, value, word):
    with pytest.raises(ParameterError) as caught:
        Example.from_mapping({key: value}, "/node")
    assert caught.value.key == f"/node/{key}"
    assert word in caught.value.message and caught.value.message.startswith(f"/node/{key}: ")


# ------------------------------------------------------------------ changed while a node runs
@dataclass(frozen=True)
class Params(Parameters):
    low: float = param(1.0, "m", low=0.0, high=10.0, doc="the smaller one")
    high: float = param(5.0, "m", above=0.0)
    count: int = param(3, "", low=1)
    switch: bool = param(False)
    name: str = param("red")
    fixed: float = param(0.5)
    places: list = param([])

    def __post_init__(self):
        super().__post_init__()
        if self.low > self.high:
            raise ParameterError("low", f"must be at most high = {self.high}, got {self.low}")


def test_the_description_follows_from_the_fields():
    description = reconfigure.describe(Params(low=2.0), fixed=("fixed",))
    entries = {entry["name"]: entry for entry in description.config_description["parameters"]}
    assert list(entries) == ["low", "high", "count", "switch"]
    assert entries["low"]["type"] == "double" and entries["low"]["description"] == "the smaller one [m]"
    assert (entries["low"]["min"], entries["low"]["max"], entries["low"]["default"]) == (0.0, 10.0, 2.0)
    assert entries["count"]["min"] == 1 and entries["count"]["max"] == 2**31 - 1
    # as clients read it
    decoded = decode_description(encode_description(description))
    assert {entry["name"] for entry in decoded["parameters"]} == set(entries)


@pytest.fixture
def tuned(monkeypatch):
    """What changes values as a server does, and what is stored, applied and warned of."""
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

    node = reconfigure.ReconfigureServer(Params(), "~limits", apply)
    config = {name: getattr(Params(), name) for name in ("low", "high", "count", "switch")}
    return lambda **values: config.update(node._change({**config, **values}, 1)) or config, stored, applied, warned


def test_a_change_is_applied_once(tuned):
    change, stored, applied, warned = tuned
    assert change()["low"] == stored["~limits/low"] == 1.0 and not applied
    assert change(low=3.0)["low"] == 3.0
    assert [params.low for params in applied] == [3.0] and applied[0].name == "red"
    change(low=3.0)
    assert len(applied) == 1 and not warned


@pytest.mark.parametrize(
    "changes, reason", [({"low": 6.0}, "at most high"), ({"high": 0.0}, "above 0"), ({"count": 13}, "unlucky")]
)
def test_a_refused_change_changes_nothing(tuned, changes, reason):
    change, _, applied, warned = tuned
    change(low=2.0)
    config = change(switch=True, **changes)
    assert (config["low"], config["high"], config["count"], config["switch"]) == (2.0, 5.0, 3, False)
    assert len(applied) == 1 and len(warned) == 1 and reason in warned[0]
    assert change(low=4.0)["low"] == 4.0
