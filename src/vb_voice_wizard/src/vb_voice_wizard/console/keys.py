"""What the wizard console's keys mean; no ROS.

The idea: one key is one command. Borders are changed on the page, where they can be seen.
"""

from __future__ import annotations

import re
from typing import Dict

from vb_core.vocabulary import COMMANDS

COMMAND_KEYS: Dict[str, str] = {command.key: name for name, command in COMMANDS.items()}
QUIT_KEY = "q"


# what a terminal sends for an arrow or function key
_SEQUENCE = re.compile("\x1b(\\[[0-?]*[ -/]*[@-~]|O.|)")


def letters(typed: str) -> str:
    """Returns the letters in what a terminal sent; arrow, function and control keys mean nothing.

    Capital letters stay what they are, and mean nothing either: on a slow line one may be the end of such a sequence.
    """
    return "".join(filter(str.isprintable, _SEQUENCE.sub("", typed)))
