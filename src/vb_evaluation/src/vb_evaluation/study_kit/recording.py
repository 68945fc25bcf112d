"""What a recording's folder holds, and what each interaction in it left behind.

<recording>/run.yaml                what was planned, and what the experimenter noted (study_kit run)
            events.jsonl            what the experimenter noted by key press, with the time
            session.yaml            how the system was started
            interactions.jsonl      one line per interaction, from the interaction manager
            recordings/             numbered maps with their borders, from the map recorder
            bags/NN.bag             the topics that matter
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Callable, Dict, List, Mapping, Optional, Tuple, TypeVar

import yaml

from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_core.map_files import read_map
from vb_map_integration.border import VirtualBorder
from vb_map_integration.borders.geojson import borders_from_geojson

LOG, MAPS, INDEX, BAGS, SESSION = "interactions.jsonl", "recordings", "index.jsonl", "bags", "session.yaml"
RUN, EVENTS = "run.yaml", "events.jsonl"
Row = TypeVar("Row")


@dataclass(frozen=True)
class LoggedInteraction:
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


@dataclass(frozen=True)
class StoredMap:
    """One record of the map recorder."""

    stamp_s: float
    map_path: Path
    borders_path: Path

    def grid(self) -> GridMap:
        """Returns the map with borders."""
        return read_map(self.map_path)

    def borders(self) -> List[VirtualBorder]:
        """Returns the borders that acted on it."""
        return _read(self.borders_path, borders_from_geojson)


class Recording:
    """A recording, read and checked.

    Raises:
        CodedError: "bad_recording" naming the file, and the line if there is one.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = Path(folder).expanduser()
        if not self.folder.is_dir():
            raise CodedError("bad_recording", f"there is no folder {self.folder}")
        maps = self.folder / MAPS
        self.interactions = _rows(self.folder / LOG, _interaction)
        self.maps = _rows(
            maps / INDEX, lambda row: StoredMap(float(row["stamp_s"]), maps / row["map"], maps / row["borders"])
        )

    @property
    def session(self) -> Mapping[str, Any]:
        """How the system was started; empty if that was not recorded."""
        return _read(self.folder / SESSION, yaml.safe_load) or {}

    @property
    def run(self) -> Mapping[str, Any]:
        """What was planned and noted; empty if the recording was not made by study_kit run."""
        return _read(self.folder / RUN, yaml.safe_load) or {}

    def count(self, key: str) -> int:
        """Counts how often the experimenter pressed a key."""
        return _rows(self.folder / EVENTS, lambda row: row.get("key")).count(key)

    def physical(self) -> GridMap:
        """Returns the physical map: the first one recorded without any border."""
        for stored in self.maps:
            if not stored.borders():
                return stored.grid()
        raise CodedError(
            "bad_recording",
            f"{self.folder / MAPS}: no map without borders was recorded: start each recording in a "
            "folder of its own",
        )

    def result(self, interaction: LoggedInteraction) -> Optional[Tuple[GridMap, VirtualBorder]]:
        """Returns (map with borders, border) that an interaction made; None if nothing was saved.

        Borders of earlier attempts in the same recording act on the map too, as they did on the robot.

        Raises:
            CodedError: "bad_recording" if the map that belongs to it was not recorded.
        """
        if interaction.outcome != "saved":
            return None
        for stored in self.maps:
            if stored.stamp_s < interaction.started:
                continue
            own = [border for border in stored.borders() if border.id == interaction.border_id]
            if own:
                return stored.grid(), own[0]
        raise CodedError(
            "bad_recording",
            f"{self.folder / MAPS}: the map of interaction {interaction.interaction_id} with border "
            f"{interaction.border_id} was not recorded",
        )


def _interaction(row: Dict[str, Any]) -> LoggedInteraction:
    return LoggedInteraction(
        **{
            name: (str if kind == "str" else float)(row[name])
            for name, kind in LoggedInteraction.__annotations__.items()
        }
    )


def _read(path: Path, read: Callable[[str], Any]) -> Any:
    """Reads a text file; None if there is none."""
    try:
        return read(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except (OSError, ValueError, yaml.YAMLError) as error:
        raise CodedError("bad_recording", f"cannot read {path}: {error}") from None


def _rows(path: Path, make: Callable[[Dict[str, Any]], Row]) -> List[Row]:
    """Makes something of each line of JSON of a file; nothing if there is none."""
    found = []
    for number, line in enumerate((_read(path, str) or "").splitlines(), 1):
        try:
            found += [make(json.loads(line))] if line.strip() else []
        except (KeyError, TypeError, ValueError) as error:
            raise CodedError("bad_recording", f"{path}, line {number}: {error!r}") from None
    return found
