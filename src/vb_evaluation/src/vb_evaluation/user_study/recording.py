"""Makes and reads recordings: what a recording's folder holds, and what each interaction in it left behind.

<recording>/run.yaml                what was planned, and what the experimenter noted (study_kit run)
            events.jsonl            what the experimenter noted by key press, with the time
            interactions.jsonl      one line per interaction, from the interaction manager
            bags/*.bag              all messages but images
"""

from __future__ import annotations

import json
import os
import sys
from collections import defaultdict
from functools import cached_property
from pathlib import Path
from typing import Any, Callable, Dict, List, Mapping, NamedTuple, Optional, Set, Tuple, TypeVar, get_type_hints

import numpy as np
import yaml

from vb_core import names
from vb_core.errors import CodedError
from vb_core.grid_map import GridMap

LOG, BAGS, RUN, EVENTS = "interactions.jsonl", "bags", "run.yaml", "events.jsonl"
TOPICS = [names.MAP_WITH_BORDERS, names.BORDERS, names.DETECTORS]  # those that are read from a bag
WITHOUT = ".*(image|compressed|points|projector).*"  # not recorded: a thousand times as large as the rest
Row = TypeVar("Row")


class LoggedInteraction(NamedTuple):
    """One line of the interaction log; times in seconds."""

    interaction_id: str
    outcome: str
    border_id: str
    method: str
    started: float
    guide_s: float
    border_s: float
    seed_s: float
    total_s: float


class Recording:
    """A recording, read and checked.

    Raises:
        CodedError: "bad_recording" naming the file, and the line if there is one.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = Path(folder).expanduser()
        if not self.folder.is_dir():
            raise CodedError("bad_recording", f"there is no folder {self.folder}")
        self.interactions = _rows(self.folder / LOG, _interaction)

    @cached_property
    def _bags(self) -> Tuple[Dict[float, Dict[str, Any]], Optional[Set[str]]]:
        """The messages of each state by topic, by its stamp [s], and the cameras. Read on first use."""
        states: Dict[float, Dict[str, Any]] = defaultdict(dict)
        cameras: Set[str] = set()
        paths = sorted((self.folder / BAGS).glob("*.bag"))
        for path in paths:
            _read_bag(path, states, cameras)
        if not paths:
            return states, None
        return states, cameras

    @property
    def cameras(self) -> Optional[Set[str]]:
        """The ceiling cameras whose detectors ran, or None if there is no bag."""
        return self._bags[1]

    @property
    def run(self) -> Mapping[str, Any]:
        """What was planned and noted, empty if the recording was not made by study_kit run."""
        return _read(self.folder / RUN, yaml.safe_load) or {}

    def count_key_presses(self, key: str) -> int:
        """Counts how often the experimenter pressed a key."""
        return _rows(self.folder / EVENTS, lambda row: row.get("key")).count(key)

    def physical(self) -> Optional[GridMap]:
        """Returns the physical map, which is the first recorded one without a border in force, or None."""
        return next((grid for _, grid, borders in self._maps() if not borders), None)

    def result(self, interaction: LoggedInteraction) -> Optional[Tuple[GridMap, np.ndarray]]:
        """Returns the map with borders and the seed (2,) [m] that an interaction made, or None if nothing was saved.

        Borders of earlier attempts in the same recording act on the map too, as they did on the robot.

        Raises:
            CodedError: "bad_recording" if the map that belongs to it was not recorded.
        """
        if interaction.outcome != "saved":
            return None
        for stamp_s, grid, borders in self._maps():
            for border in borders:
                if stamp_s >= interaction.started and border.id == interaction.border_id:
                    return grid, np.array([border.seed.x, border.seed.y])
        lost = f"the map of interaction {interaction.interaction_id} with border {interaction.border_id}"
        hint = "rosbag reindex reads a bag that was not closed"
        raise CodedError("bad_recording", f"{self.folder / BAGS}: {lost} was not recorded; {hint}")

    def _maps(self) -> List[Tuple[float, GridMap, Any]]:
        """Returns (stamp [s], map, messages of the borders in it) of each state."""
        complete = sorted((stamp_s, state) for stamp_s, state in self._bags[0].items() if len(state) == 2)
        return [(stamp_s, state[names.MAP_WITH_BORDERS], state[names.BORDERS].borders) for stamp_s, state in complete]


def _read_bag(path: Path, states: Dict[float, Dict[str, Any]], cameras: Set[str]) -> None:
    """Adds the messages of a bag to states, by stamp [s] and topic, and its ceiling cameras to cameras."""
    # a study is planned and reported without ROS
    import rosbag
    from vb_core.ros.messages import NumpyOccupancyGrid, grid_from_message

    try:
        with rosbag.Bag(str(path)) as bag:
            for topic, (_, content, *_, kind), _ in bag.read_messages(TOPICS, raw=True):
                is_map = topic == names.MAP_WITH_BORDERS
                message = (NumpyOccupancyGrid if is_map else kind)().deserialize(content)
                if topic != names.DETECTORS:
                    # the integrator gives map and borders of one state the same stamp
                    states[message.header.stamp.to_sec()][topic] = grid_from_message(message) if is_map else message
                elif not message.mobile:
                    cameras.add(message.camera)
    except Exception as error:  # a damaged file fails in many ways
        raise CodedError("bad_recording", f"cannot read {path}: {error}") from None


def _interaction(row: Dict[str, Any]) -> LoggedInteraction:
    return LoggedInteraction(*(kind(row[name]) for name, kind in get_type_hints(LoggedInteraction).items()))


def _read(path: Path, read: Callable[[str], Any]) -> Any:
    """Reads a text file, or returns None if there is none."""
    try:
        return read(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except (OSError, ValueError, yaml.YAMLError) as error:
        raise CodedError("bad_recording", f"cannot read {path}: {error}") from None


def _rows(path: Path, make: Callable[[Dict[str, Any]], Row]) -> List[Row]:
    """Makes a row of each line of JSON in a file. There are none if there is no file."""
    rows = []
    for number, line in enumerate((_read(path, str) or "").splitlines(), 1):
        try:
            rows += [make(json.loads(line))] if line.strip() else []
        except (KeyError, TypeError, ValueError) as error:
            raise CodedError("bad_recording", f"{path}, line {number}: {error!r}") from None
    return rows


def record() -> None:
    """Becomes rosbag's recorder, which records into the folder of the first argument. A restart begins another file."""
    from roslib.packages import find_node

    bags = Path(sys.argv[1]).expanduser() / BAGS
    bags.mkdir(parents=True, exist_ok=True)
    recorder = find_node("rosbag", "record")[0]
    # what roslaunch appended (__name:=, __log:=) is for the recorder
    options = ["--all", "--exclude", WITHOUT, "--output-prefix", str(bags / "session"), "--lz4", "--buffsize", "512"]
    os.execv(recorder, [recorder, *options, *sys.argv[2:]])
