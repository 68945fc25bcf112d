"""What happened between two lists of borders."""

from __future__ import annotations

import pytest
from geometry_msgs.msg import Point

from vb_core.border_changes import border_changes
from vb_msgs.msg import VirtualBorder


def border(**changes):
    return VirtualBorder(**{"name": "a", "enabled": True, **changes})


@pytest.mark.parametrize(
    "after, expected",
    [
        ({"1": border()}, []),
        # what the map integrator fills in is nobody's change
        ({"1": border(reason="disabled", area_m2=2.0)}, []),
        # found again on a map that has grown
        ({"1": border(seed=Point(1e-3, 0.0, 0.0))}, []),
        ({"1": border(seed=Point(0.05, 0.0, 0.0))}, [("changed", "a")]),
        ({"1": border(robots=["ada"])}, [("changed", "a")]),
        ({"1": border(occupancy=0.5)}, [("changed", "a")]),
        ({}, [("removed", "a")]),
        ({"1": border(name="b")}, [("renamed", "b")]),
        ({"1": border(enabled=False)}, [("disabled", "a")]),
        ({"1": border(), "2": border(name="c")}, [("added", "c")]),
    ],
)
def test_what_happened_between_two_lists_of_borders(after, expected):
    assert [(kind, one.name) for kind, one in border_changes({"1": border()}, after)] == expected
