"""What the wizard console's keys mean: from terminal input to actions; no ROS."""
from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Dict, List, Optional, Sequence, Tuple

from vb_voice_wizard.interaction import (
    CANCEL, DEFINE_BORDER, DEFINE_SEED, GUIDE_ROBOT, REDO, RESUME, SAVE, STOP, UNDO,
)

# in the order of the screen's two lines; the largest key stops
DRAWING_KEYS: Dict[str, str] = {"b": DEFINE_BORDER, "d": DEFINE_SEED, "g": GUIDE_ROBOT, "s": SAVE, "c": CANCEL}
OTHER_KEYS: Dict[str, str] = {" ": STOP, "p": RESUME, "u": UNDO, "r": REDO}
COMMAND_KEYS: Dict[str, str] = {**DRAWING_KEYS, **OTHER_KEYS}
QUIT_KEY = "q"
RENAME_KEY, ENABLE_KEY, REMOVE_KEY = "n", "e", "x"

UP, DOWN, ENTER, ESCAPE, BACKSPACE = "up", "down", "enter", "escape", "backspace"
LONGEST_NAME = 40

# what a terminal sends for arrow, function and other keys; a sequence cut off at the end may go on
_SEQUENCE = re.compile("\x1b(?:\\[[0-9;?]*[ -/]*[@-~]|O.)")
_CUT_OFF = re.compile("\x1b(?:\\[[0-9;?]*[ -/]*|O)?$")
_ARROWS = {"\x1b[A": UP, "\x1bOA": UP, "\x1b[B": DOWN, "\x1bOB": DOWN}
_CONTROLS = {"\r": ENTER, "\n": ENTER, "\x7f": BACKSPACE, "\x08": BACKSPACE, "\x1b": ESCAPE}


class KeyReader:
    """Separates the keys in a terminal's input.

    A slow line may cut the sequence of an arrow key in two; the beginning of one is also what the escape key
    sends. So a beginning is kept until more arrives, or nothing does.
    """

    def __init__(self) -> None:
        self._kept = ""

    def feed(self, typed: str) -> List[str]:
        """The keys in the input, each a character, or UP, DOWN, ENTER, ESCAPE, BACKSPACE; others are left out.

        Args:
            typed: "" if nothing came for a while.
        """
        text, self._kept = self._kept + typed, ""
        cut_off = _CUT_OFF.search(text) if typed else None
        if cut_off:
            text, self._kept = text[: cut_off.start()], cut_off.group()
        keys: List[str] = []
        while text:
            sequence = _SEQUENCE.match(text)
            if sequence:
                keys.append(_ARROWS.get(sequence.group(), ""))
                text = text[sequence.end() :]
            else:
                keys.append(_CONTROLS.get(text[0], text[0] if text[0].isprintable() else ""))
                text = text[1:]
        return [key for key in keys if key]


@dataclass(frozen=True)
class BorderRow:
    """A stored border as the console lists it."""

    id: str
    name: str
    area_m2: float
    enabled: bool
    occupancy: float = 1.0


@dataclass(frozen=True)
class Action:
    """What a key asks for: "command" (text: which), "rename" (text: the new name), "enable", "disable", "remove",
    "quit", or "note" (text: a sentence's code, for the operator; no action)."""

    what: str
    border_id: str = ""
    text: str = ""
    key: str = ""


class Controls:
    """The console's keys. One key is one command; a name is typed, and removing a border takes a yes.

    Attributes:
        mode: "keys", "rename" or "remove".
        text: the part of a new name typed so far.
    """

    def __init__(self) -> None:
        self.mode = "keys"
        self.text = ""
        self._chosen = ""

    def chosen(self, borders: Sequence[BorderRow]) -> Optional[BorderRow]:
        """The border that rename, enable and remove are about: the newest, until another one is chosen."""
        return next((row for row in borders if row.id == self._chosen), borders[-1] if borders else None)

    def press(self, key: str, borders: Sequence[BorderRow]) -> Optional[Action]:
        """A key, from KeyReader; returns what to do, if anything."""
        if self.mode == "rename":
            return self._rename(key)
        if self.mode == "remove":
            self.mode = "keys"
            return Action("remove", self._chosen) if key.lower() == "y" else Action("note", text="console_nothing_removed")
        key = key if len(key) > 1 else key.lower()
        if key in COMMAND_KEYS:
            return Action("command", text=COMMAND_KEYS[key])
        if key == QUIT_KEY:
            return Action("quit")
        if key in (UP, DOWN, RENAME_KEY, ENABLE_KEY, REMOVE_KEY):
            return self._about_border(key, borders)
        return Action("note", text="console_key_unknown", key=key) if len(key) == 1 else None

    def _about_border(self, key: str, borders: Sequence[BorderRow]) -> Optional[Action]:
        row = self.chosen(borders)
        if row is None:
            return Action("note", text="console_no_border")
        if key in (UP, DOWN):
            place = list(borders).index(row) + (1 if key == DOWN else -1)
            self._chosen = borders[min(max(place, 0), len(borders) - 1)].id
            return None
        # from here on it stays this one, whatever is added meanwhile
        self._chosen = row.id
        if key == ENABLE_KEY:
            return Action("disable" if row.enabled else "enable", row.id)
        self.mode = "rename" if key == RENAME_KEY else "remove"
        self.text = ""
        return None

    def _rename(self, key: str) -> Optional[Action]:
        if key == BACKSPACE:
            self.text = self.text[:-1]
        elif key in (ENTER, ESCAPE):
            self.mode = "keys"
            name = self.text.strip()
            if key == ENTER and name:
                return Action("rename", self._chosen, name)
            return Action("note", text="console_name_stays")
        elif len(key) == 1:
            self.text = (self.text + key)[:LONGEST_NAME]
        return None


KEY_HELP: Tuple[Tuple[str, str], ...] = (
    ("\u2191\u2193", "console_choose"),
    (RENAME_KEY, "console_name"),
    (ENABLE_KEY, "console_on_off"),
    (REMOVE_KEY, "console_remove_key"),
    (QUIT_KEY, "console_quit"),
)
