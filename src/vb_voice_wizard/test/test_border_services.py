"""What the manager says was undone or made again."""

from geometry_msgs.msg import Point

from vb_msgs.msg import VirtualBorder
from vb_voice_wizard.interaction_manager_node import _what_changed


def test_what_was_undone_is_named():
    def told(before, after, command="undo"):
        answer = _what_changed(
            command, {border.id: border for border in before}, {border.id: border for border in after}
        )
        return answer.code, answer.values.get("borders")

    rug, bed = VirtualBorder(id="b1", name="Rug", enabled=True), VirtualBorder(id="b2", name="Bed", enabled=True)
    off, renamed = VirtualBorder(id="b1", name="Rug"), VirtualBorder(id="b1", name="Carpet", enabled=True)
    # what the map integrator fills in is nobody's change
    idle = VirtualBorder(id="b2", name="Bed", enabled=True, reason="inactive_on_this_map")
    assert told([rug, bed], [rug]) == ("border_removed", "Bed")
    assert told([rug], [rug, bed]) == ("border_restored", "Bed")
    assert told([rug, bed], [off, idle]) == ("border_disabled", "Rug")
    assert told([off, bed], [rug, bed]) == ("border_enabled", "Rug")
    assert told([rug, bed], [renamed, bed]) == ("change_undone", "Carpet")
    assert told([rug, bed], [renamed, bed], "redo") == ("change_redone", "Carpet")
    for change, answer in (
        ({"robots": ["ada"]}, ("change_undone", "Rug")),
        ({"occupancy": 0.5}, ("change_undone", "Rug")),
        ({"seed": Point(0.05, 0.0, 0.0)}, ("change_undone", "Rug")),
        # found again on a map that has grown it lies a little elsewhere, which is no change
        ({"seed": Point(1e-3, 0.0, 0.0)}, ("borders_changed", None)),
    ):
        assert told([rug, bed], [VirtualBorder(id="b1", name="Rug", enabled=True, **change), bed]) == answer
    assert told([rug], [off, bed]) == ("borders_changed", None)
    assert told([rug, idle], [rug, bed]) == ("borders_changed", None)
