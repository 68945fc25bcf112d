"""Maps buttons to commands."""

from __future__ import annotations

from typing import Dict, List, Mapping, Sequence

from vb_core.errors import ParameterError
from vb_core.interaction_tables import COMMANDS, STATES, command_name_from_text


class ButtonMap:
    """Turns button presses into commands, one command per press.

    Args:
        mapping: the index of the button of each command, or a list of them. If it is empty, button i gives command i.
        by_state: for a device with few buttons, a mapping for each state in which buttons have other meanings. Buttons
            that it does not contain keep their meaning from `mapping`.

    Raises:
        ParameterError: with the key that is unknown or has invalid buttons.
    """

    def __init__(self, mapping: Mapping[str, object], by_state: Mapping[str, Mapping[str, object]]) -> None:
        if not mapping:
            mapping = {command: index for index, command in enumerate(COMMANDS)}
        common = _read("mapping", mapping)
        self._commands: Dict[str, Dict[int, str]] = {state: dict(common) for state in STATES}
        for state, mapping_in_state in by_state.items():
            if state not in STATES:
                raise ParameterError(f"by_state/{state}", f"unknown state; known are {', '.join(STATES)}")
            self._commands[state].update(_read(f"by_state/{state}", mapping_in_state))
        self._held: frozenset = frozenset()

    def update(self, buttons: Sequence[int], state: str) -> List[str]:
        """Returns the commands of the buttons that have just been pressed, given a new reading of 0 or 1 per button.

        A button that is held does not repeat its command. An unknown state counts as "default".
        """
        held = frozenset(button for button, value in enumerate(buttons) if value)
        pressed = sorted(held - self._held)
        self._held = held
        commands = self._commands.get(state, self._commands["default"])
        return [commands[button] for button in pressed if button in commands]


def _read(key: str, mapping: object) -> Dict[int, str]:
    """Converts the parameter `key`, which has the buttons of each command, to the command of each button."""
    if not isinstance(mapping, Mapping):
        raise ParameterError(key, f"expected commands with their buttons, got {mapping!r}")
    result: Dict[int, str] = {}
    for name, buttons in mapping.items():
        command = command_name_from_text(str(name))
        if command not in COMMANDS:
            raise ParameterError(f"{key}/{name}", f"unknown command; known are {', '.join(COMMANDS)}")
        indices = buttons if isinstance(buttons, (list, tuple)) else [buttons]
        for button in indices:
            if isinstance(button, bool) or not isinstance(button, int) or button < 0:
                raise ParameterError(f"{key}/{name}", f"expected the index of a button, 0 or more, got {button!r}")
            if result.get(button, command) != command:
                raise ParameterError(f"{key}/{name}", f"button {button} already means {result[button]}")
            result[button] = command
    return result
