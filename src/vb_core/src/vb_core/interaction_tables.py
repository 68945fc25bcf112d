"""The tables of the interaction's commands and states (paper, Sect. 4.2).

A row defines what a command or a state means to the interaction, the fusion, robots, the display, LED, sounds, voice,
buttons, console, and the page, which receives both tables when it connects. Messages carry the names (vb_msgs/Command,
vb_msgs/InteractionState). The texts for people are in languages/<language>/interaction.yaml: command_<name>,
state_<name>, page_command_<name>, page_state_<name>.

>>> COMMANDS[DEFINE_SEED].enters, STATES["seed"].collects, words_of_name(DEFINE_SEED)
('seed', 'seed', 'define seed')
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Dict, List, Tuple

from vb_core.sentences import words_of_name


@dataclass(frozen=True)
class State:
    """A state of the interaction.

    Attributes:
        collects: the part of a border that a spot becomes, "border" or "seed"; "": spots are ignored.
        guides: whether a robot follows the spot, even while ceiling cameras see it.
        prompt: code of the sentence that says what to do in this state; "" in Default.
        color: on the display, the LED, the page and the console, "#rrggbb"; distinguishable with any colour vision
            (orange and sky blue are Okabe and Ito's, 2008).
        led: a Kobuki's LED, the constant of kobuki_msgs/Led nearest to the colour; BLACK where spots are ignored.
        tone: the two notes that announce the state.
    """

    name: str
    collects: str = ""
    guides: bool = False
    prompt: str = ""
    color: str = "#ffffff"
    led: str = "BLACK"
    tone: Tuple[str, str] = ("E5", "C5")

    @property
    def robots_act(self) -> bool:
        """Whether a robot may follow the spot, or come to look for it. The time in these states is counted."""
        return self.guides or bool(self.collects)


_STATES = (
    State("default"),
    State("border", "border", prompt="draw_border", color="#e69f00", led="ORANGE", tone=("C5", "E5")),
    State("seed", "seed", prompt="point_seed", color="#56b4e9", led="GREEN", tone=("C5", "G5")),
    State("guide", guides=True, prompt="guide", color="#e150a0", led="RED", tone=("C5", "C6")),
    State("paused", prompt="paused", color="#9682ff", tone=("G6", "E6")),
)
STATES: Dict[str, State] = {state.name: state for state in _STATES}
DEFAULT, BORDER, SEED, GUIDE, PAUSED = _STATES  # the states themselves; commands are known by their names


def state_by_name(name: str) -> State:
    """Returns the named state; for an unknown name, a state in which nothing is done."""
    return STATES.get(name, State(name))


# needs: what must be connected for a command to have an effect
CAMERA = "camera"  # cameras that report
DRIVER = "driver"  # cameras, and a robot with this stack's driver
STOPPABLE = "stoppable"  # a robot that obeys Stop

# values of `Command.consequences`: when the command moves a robot, changes the map or loses a drawing at once. Then the
# person must confirm a command that may have been misheard
ALWAYS = "always"
NEVER = "never"
WHILE_DRAWN = "while_drawn"  # there is a drawing that can be lost
WHILE_STOPPED = "while_stopped"  # robots would move again
WHILE_POINTING = "while_pointing"  # the laser is on: a robot would follow it, or a line become the seed


@dataclass(frozen=True)
class Command:
    """A command, whose name people say and vb_msgs/Command carries.

    Attributes:
        key: the command's key on the wizard's console.
        icon: the name of its Material Design icon, which Home Assistant shows.
        needs: what must be connected; "" for nothing.
        consequences: when the command has any: ALWAYS, NEVER or one of WHILE_...
        enters: name of the state that it leads to; "" if the state stays, or depends on the interaction.
        is_delegated: whether another node carries it out; until that node answers, other commands are refused
            as "busy".
        phrases: English phrases that people may say instead of its name.
        button_place: position among the page's laser pointer buttons, 0 for no button. If two commands share a
            position, the available one is shown.
    """

    name: str
    key: str
    icon: str
    needs: str = ""
    consequences: str = WHILE_POINTING
    enters: str = ""
    is_delegated: bool = False
    phrases: Tuple[str, ...] = ()
    button_place: int = 0


_COMMANDS = (
    Command("define_border", "b", "laser-pointer", CAMERA, enters="border", button_place=1),
    Command("define_seed", "d", "map-marker-off", CAMERA, enters="seed", button_place=2),
    Command("guide_robot", "g", "robot", DRIVER, enters="guide", button_place=6),
    Command("save", "s", "content-save", CAMERA, ALWAYS, is_delegated=True, button_place=4),
    Command("cancel", "c", "cancel", CAMERA, WHILE_DRAWN, button_place=3),
    Command("stop", " ", "stop-circle", STOPPABLE, NEVER, phrases=("stop robot", "no, stop", "stop, stop")),
    Command("resume", "p", "play-circle", STOPPABLE, WHILE_STOPPED),
    Command("undo", "u", "undo", consequences=ALWAYS, is_delegated=True),
    Command("redo", "r", "redo", consequences=ALWAYS, is_delegated=True),
    Command("pause", "h", "pause", CAMERA, NEVER, enters="paused", button_place=5),
    Command("continue", "k", "play", CAMERA, button_place=5),
)
COMMANDS: Dict[str, Command] = {command.name: command for command in _COMMANDS}
DEFINE_BORDER, DEFINE_SEED, GUIDE_ROBOT, SAVE, CANCEL, STOP, RESUME, UNDO, REDO, PAUSE, CONTINUE = COMMANDS  # names

QUESTIONS = ("confirm_save", "confirm_command")  # codes with which the system asks for confirmation
# by the reply that answers such a question with yes, the command that it confirms
YES_ANSWERS = {"yes_" + name: name for name, command in COMMANDS.items() if command.consequences != NEVER}


def command_name_from_text(text: str) -> str:
    """Converts a command as people write it ("Define border") to its name ("define_border")."""
    return "_".join(text.replace("-", " ").replace("_", " ").replace(",", " ").lower().split())


def tables() -> Dict[str, List[Dict[str, Any]]]:
    """Returns both tables as plain values, for the page."""
    return {
        "states": [asdict(state) for state in _STATES],
        "commands": [{**asdict(command), "spoken": words_of_name(command.name)} for command in _COMMANDS],
    }
