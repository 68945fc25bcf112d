from dataclasses import dataclass
from typing import Tuple

import pytest

from vb_core.errors import ParameterError
from vb_core.parameters import Parameters, param


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
