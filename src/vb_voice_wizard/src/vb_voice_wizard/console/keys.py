"""What the wizard console's keys mean; no ROS.

The idea: one key is one command. Borders are changed on the page, where they can be seen.
"""

from __future__ import annotations

from typing import Dict

from vb_core.vocabulary import COMMANDS

COMMAND_KEYS: Dict[str, str] = {command.key: name for name, command in COMMANDS.items()}
QUIT_KEY = "q"


def letters(typed: str) -> str:
    """Returns the letters in what a terminal sent; arrow and function keys begin with an escape and mean nothing.

    Capital letters stay what they are, and mean nothing either: on a slow line one may be the end of such a sequence.
    """
    return "" if "\x1b" in typed else "".join(filter(str.isprintable, typed))
