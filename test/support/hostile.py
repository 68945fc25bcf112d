"""Malformed and hostile messages, derived from good ones, for the tests of the page."""

import copy
import json

from hypothesis import strategies as st

from examples import ANYTHING

GOOD_DRAFT = {"points": [[1.0, 1.0], [2.0, 1.0], [2.0, 2.0]], "seed": [1.7, 1.3], "kind": "polygon", "name": "carpet"}
GOOD_DRAFT.update(zone="keep_out", max_speed=0.0, enabled=True, robots=[])
TARGET = {"border": "b1", "revision": 3}
GOOD = {  # the fields of a request of each action
    "command": {"command": "save", "seen_stop": "5a", "age": 0.1},
    "preview": {"draft": GOOD_DRAFT, "border": ""},
    "add": {"draft": GOOD_DRAFT},
    "update": {"draft": GOOD_DRAFT, **TARGET},
    "rename": {"name": "Küche 厨房", **TARGET},
    "enable": {"enabled": False, **TARGET},
    "remove": dict(TARGET),
    "send": {"robot": "ada", "goal": [1.0, 2.0]},
    "halt": {"robot": ""},
    "confirm_map": {"same": True, "map_id": "0af3"},
    "invite": {},
}
NASTY = [-1, 50, 2**63, 10**400, 1e308, "\x00", "\ud800", "\u202e", "A" * 5000, [1] * 600, [[0, 0]] * 600]
NASTY += ["../../etc/passwd", "/cmd_vel", "save;reboot", "define_border\n", {"__proto__": {}}]
VALUES = st.sampled_from(NASTY) | ANYTHING
RAW = ["{" * 500, "[" * 5000, "1" * 9000, "[]", "\ufeff{}", '{"do":NaN}']
RAW += ['{"do":"command","id":"1","command":"save","command":"reboot"}']


def _places(value, path=()):
    """Lists the paths, as keys and indices, to a value and to everything in it."""
    items = enumerate(value) if isinstance(value, list) else ()
    items = value.items() if isinstance(value, dict) else items
    return [path, *(place for key, inner in items for place in _places(inner, (*path, key)))]


@st.composite
def hostile_messages(draw):
    """Draws texts that are almost a request, the beginning of one, or none at all; a few happen to be valid."""
    kind = draw(st.integers(0, 9))
    if kind == 0:
        return draw(st.sampled_from(RAW) | st.text())
    action = draw(st.sampled_from(sorted(GOOD)))
    message = {"do": action, "id": "1", **copy.deepcopy(GOOD[action])}
    for _ in range(draw(st.integers(1, 2))):
        *path, key = draw(st.sampled_from([*_places(message)[1:], ("topic",)]))
        target = message
        for step in path:
            target = target[step]
        if isinstance(target, dict) and draw(st.integers(0, 4)) == 0:
            target.pop(key, None)
        else:
            target[key] = copy.deepcopy(draw(VALUES))
    text = json.dumps(message)
    return text[: draw(st.integers(0, len(text)))] if kind == 1 else text
