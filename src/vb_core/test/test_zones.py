"""The table of zones against what must stay apart: the message, and words in each language."""

import pytest

from vb_core import sentences
from vb_core.offer import ConnectedRobot
from vb_core.zones import KEEP_OUT, ZONES, zone_of
from vb_msgs.msg import VirtualBorder


def test_the_message_names_the_same_zones():
    kinds = ("AUTO", "POLYGON", "SEPARATING_CURVE", "VIRTUAL_WALL")
    numbers = {name: value for name, value in vars(VirtualBorder).items() if name.isupper() and name not in kinds}
    assert numbers == {zone.name.upper(): zone.number for zone in ZONES.values()}


def test_robots_keep_out_of_a_zone_that_is_not_known():
    assert all(zone_of(zone.number) is zone for zone in ZONES.values()) and zone_of(77) is KEEP_OUT


def test_a_zone_changes_the_map_or_limits_the_speed():
    for zone in ZONES.values():
        assert (zone.value(0.6), zone.value(0.0)) == (60 * zone.restricts, 0)
        assert zone.restricts or zone.limits_speed
        # what may be crossed must not be drawn as a wall, and the rest must be
        assert (zone.occupancy < 1.0) == zone.soft
        assert not zone.kept_by(ConnectedRobot("idle"))


@pytest.mark.parametrize("language", sentences.languages())
def test_each_zone_has_its_words(language):
    known = sentences.catalog(language)
    assert all(known[f"page_zone_{name}"] and known[f"border_unkept_{name}"] for name in ZONES)
