"""What the wizard console's keys mean; no ROS.

The idea: one key is one command. Borders are changed on the page, where they can be seen.
"""

from __future__ import annotations

import re
from typing import Dict

from vb_core.vocabulary import COMMANDS

COMMAND_KEYS: Dict[str, str] = {command.key: name for name, command in COMMANDS.items()}
QUIT_KEY = "q"

# what a terminal sends for arrow and function keys; a slow line may cut a sequence in two
_SEQUENCE = re.compile("\x1b(\\[[0-9;?]*[ -/]*[@-~]|O.)")
_CUT_OFF = re.compile("\x1b(\\[[0-9;?]*[ -/]*|O)?$")


class KeyReader:
    """Separates the letters in a terminal's input from arrow, function and control keys, which mean nothing."""

    def __init__(self) -> None:
        self._kept = ""

    def feed(self, typed: str) -> str:
        """Returns the letters in the input; "" if nothing came for a while, which ends a sequence that was cut off."""
        text, self._kept = _SEQUENCE.sub("", self._kept + typed), ""
        cut_off = _CUT_OFF.search(text) if typed else None
        if cut_off:
            text, self._kept = text[: cut_off.start()], cut_off.group()
        return "".join(filter(str.isprintable, text)).lower()
