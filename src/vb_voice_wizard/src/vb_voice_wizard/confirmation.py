"""The question whether a command was meant that may have been misheard.

The idea: what must be asked follows from what the command would do now. One that would move a robot, change the map or
lose a drawing is asked about unless it is beyond doubt; all others are done at once. The answer is another phrase
("yes, save"), as a word that was misheard once is misheard again, and only the source that was asked can give it.
"""

from __future__ import annotations

from typing import NamedTuple

from vb_core.vocabulary import ALWAYS, COMMANDS, NEVER, WHILE_DRAWN, WHILE_POINTING, WHILE_STOPPED

# the answer to the question whether a command was meant, and that command
ANSWERS = {"yes_" + name: name for name, command in COMMANDS.items() if command.matters != NEVER}

# [s] the answer counts within this time: enough to look at the preview, too short to forget
CONFIRM_WITHIN = 30.0


def would_matter(command: str, drawn: bool, stopped: bool, points_elsewhere: bool) -> bool:
    """Returns whether a command would at once move a robot, change the map or lose a drawing.

    Args:
        drawn: there is a border or a seed.
        stopped: the robots are.
        points_elsewhere: somebody points with the laser, and the command leads to another state.
    """
    now = {ALWAYS: True, NEVER: False, WHILE_DRAWN: drawn, WHILE_STOPPED: stopped, WHILE_POINTING: points_elsewhere}
    return now[COMMANDS[command].matters]


class Question(NamedTuple):
    """The open question: which command, the source that was asked, and when [s]; "" if there is none."""

    command: str = ""
    source: str = ""
    asked: float = 0.0
