"""Parameters that are changed while a node runs; the server's own part is tested over a real node in vb_laser_detect."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
import rospy
from dynamic_reconfigure.encoding import decode_description, encode_description

from vb_core.errors import CodedError, ParameterError
from vb_core.parameters import Parameters, param
from vb_core.ros import reconfigure


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
