"""Malformed and hostile messages, drawn from good ones, for the tests of the page."""

from __future__ import annotations

import copy
import json
import random

GOOD_DRAFT = {
    "points": [[1.0, 1.0], [2.0, 1.0], [2.0, 2.0]],
    "kind": "polygon",
    "seed": [1.7, 1.3],
    "name": "carpet",
    "zone": "keep_out",
    "max_speed": 0.0,
    "enabled": True,
    "robots": [],
}
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
NASTY = [
    None,
    True,
    False,
    0,
    -1,
    2**63,
    10**400,
    1e308,
    -1e308,
    "",
    "\x00",
    "../../etc/passwd",
    "/cmd_vel",
    "$(reboot)",
    "`id`",
    "'; --",
    "<script>alert(1)</script>",
    "%s%n{0.__class__}",
    "\ud800",
    "\u202e",
    "A" * 5000,
    [],
    [[]],
    {},
    {"__proto__": {}},
    [1] * 600,
    [[0, 0]] * 600,
    "define_border\n",
    "SAVE",
    "save;reboot",
    "b1/../..",
    {"do": "save"},
]
RAW = [
    "",
    " ",
    "{",
    "}",
    "[]",
    "null",
    "true",
    "0",
    '"save"',
    "{}",
    '{"do":"command"}',
    '{"do":NaN}',
    "{" * 500,
    "[" * 5000,
    "\x00",
    '{"do":"command","id":"1","command":"save","command":"reboot"}',
    '{"do":"command","id":"1","command":"save","x":1}',
    "1" * 9000,
    '{"do":"add","id":"1","draft":{"points":[[NaN,1],[1,1]]}}',
    "\ufeff{}",
    '{"do":"command","id":"' + "x" * 999 + '","command":"save"}',
]


def _places(value, path=()):
    found = [path]
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in items:
        found += _places(inner, path + (key,))
    return found


def hostile_messages(count, seed):
    """That many texts, the same for the same seed; a few of them are requests by accident."""
    draw = random.Random(seed)
    for _ in range(count):
        if draw.random() < 0.15:
            text = draw.choice(RAW)
            yield text if draw.random() < 0.7 else text + chr(draw.randrange(1, 0x2FF)) * draw.randrange(20)
            continue
        action = draw.choice(sorted(GOOD))
        message = {"do": action, "id": "1", **copy.deepcopy(GOOD[action])}
        for _ in range(draw.randrange(1, 4)):
            path = draw.choice([path for path in _places(message) if path] or [("id",)])
            target = message
            try:
                for key in path[:-1]:
                    target = target[key]
                if draw.random() < 0.25 and isinstance(target, dict):
                    target.pop(path[-1], None)
                elif draw.random() < 0.2 and isinstance(target, dict):
                    target[draw.choice(["topic", "path", "__class__", "param", "/rosout"])] = copy.deepcopy(
                        draw.choice(NASTY)
                    )
                else:
                    target[path[-1]] = copy.deepcopy(draw.choice(NASTY))
            except (KeyError, IndexError, TypeError):
                continue
        text = json.dumps(message)
        yield text if draw.random() < 0.9 else text[: draw.randrange(len(text))]
