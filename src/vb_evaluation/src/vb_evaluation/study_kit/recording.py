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
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional, Tuple

import yaml

from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_core.map_files import read_map
from vb_map_integration.border import VirtualBorder
from vb_map_integration.borders.geojson import borders_from_geojson

LOG, MAPS, INDEX, BAGS, SESSION = "interactions.jsonl", "recordings", "index.jsonl", "bags", "session.yaml"
RUN, EVENTS = "run.yaml", "events.jsonl"


@dataclass(frozen=True)
class LoggedInteraction:
    """One line of the interaction log; times in seconds."""

    id: str
    outcome: str
    border_id: str
    started: float
    guide_s: float
    border_s: float
    seed_s: float
    total_s: float
    method: str
    cameras: Tuple[str, ...] = ()


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
        try:
            return borders_from_geojson(self.borders_path.read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError) as error:
            raise CodedError("bad_recording", f"cannot read {self.borders_path}: {error}") from None


class Recording:
    """A recording, read and checked.

    Raises:
        CodedError: "bad_recording" naming the file, and the line if there is one.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = Path(folder).expanduser()
        if not self.folder.is_dir():
            raise CodedError("bad_recording", f"there is no folder {self.folder}")
        self.interactions = [_interaction(values, where) for values, where in _lines(self.folder / LOG)]
        self.maps = [_stored(values, where, self.folder / MAPS) for values, where in _lines(self.folder / MAPS / INDEX)]
        self.bags = sorted((self.folder / BAGS).glob("*.bag"))

    @property
    def session(self) -> Mapping[str, Any]:
        """How the system was started; empty if that was not recorded."""
        return self._yaml(SESSION)

    @property
    def run(self) -> Mapping[str, Any]:
        """What was planned and noted; empty if the recording was not made by study_kit run."""
        return self._yaml(RUN)

    def count(self, key: str) -> int:
        """Counts how often the experimenter pressed a key."""
        return sum(event.get("key") == key for event, _ in _lines(self.folder / EVENTS))

    def _yaml(self, name: str) -> Mapping[str, Any]:
        try:
            found = yaml.safe_load((self.folder / name).read_text(encoding="utf-8"))
        except FileNotFoundError:
            return {}
        except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
            raise CodedError("bad_recording", f"cannot read {self.folder / name}: {error}") from None
        return found if isinstance(found, dict) else {}

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
            f"{self.folder / MAPS}: the map of interaction {interaction.id} with border "
            f"{interaction.border_id} was not recorded",
        )


def _lines(path: Path) -> List[Tuple[Dict[str, Any], str]]:
    """Yields (values, where) of each line of JSON."""
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        return []
    except (OSError, UnicodeDecodeError) as error:
        raise CodedError("bad_recording", f"cannot read {path}: {error}") from None
    found = []
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip():
            continue
        try:
            values = json.loads(line)
        except ValueError as error:
            raise CodedError("bad_recording", f"{path}, line {number}: {error}") from None
        found.append((values, f"{path}, line {number}"))
    return found


def _interaction(values: Mapping[str, Any], where: str) -> LoggedInteraction:
    times = ("started", "guide_s", "border_s", "seed_s", "total_s")
    try:
        names = {
            "id": str(values["interaction_id"]),
            **{key: str(values[key]) for key in ("outcome", "border_id", "method")},
        }
        found = LoggedInteraction(
            **names, **{key: float(values[key]) for key in times}, cameras=tuple(values.get("cameras", ()))
        )
    except (KeyError, TypeError, ValueError) as error:
        raise CodedError("bad_recording", f"{where}: this is no interaction: {error!r}") from None
    if not all(
        math.isfinite(value) and value >= 0.0 for value in (found.guide_s, found.border_s, found.seed_s, found.total_s)
    ):
        raise CodedError("bad_recording", f"{where}: times must not be negative")
    return found


def _stored(values: Mapping[str, Any], where: str, folder: Path) -> StoredMap:
    try:
        return StoredMap(float(values["stamp_s"]), folder / str(values["map"]), folder / str(values["borders"]))
    except (KeyError, TypeError, ValueError) as error:
        raise CodedError("bad_recording", f"{where}: this is no record of a map: {error!r}") from None
