"""A small file from which a restarted node restores the point set of the interaction it was in.

One JSON document per line: the first names the interaction, each other one holds one spot and the state it was
collected in. Appended as spots come, so that a process that is killed loses at most its unwritten buffer.

A spot log that fails never stops the drawing: the failure is kept in `problem` until the next interaction.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import List, Optional, Tuple

from vb_core.errors import CodedError
from vb_fusion.spots.collector import FloorSpot

Entry = Tuple[str, FloorSpot]


class SpotLog:
    """Appends spots, and reads them back. No method raises an error of the disk.

    Args:
        path: the file; its folder is made. None: nothing is written.
        limit: spots after which no more are written: the file stays below about 90 bytes for each.

    Attributes:
        problem: "spot_log_unwritable" or "spot_log_damaged" with values, if something was lost; None if nothing was.
    """

    def __init__(self, path: Optional[Path], limit: int = 60000) -> None:
        self._path = path
        self._limit = limit
        self._written = 0
        self._file = None
        self.problem: Optional[CodedError] = None

    def start(self, interaction_id: str) -> List[Entry]:
        """Begins an interaction, or continues it.

        Returns:
            The spots that are on record for this interaction; empty for another one, whose record is replaced.
        """
        self.problem = None
        if self._path is None:
            return []
        self.close()
        entries, damaged = self._read(interaction_id)
        if damaged:
            self.problem = CodedError("spot_log_damaged", lines=damaged)
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._file = open(str(self._path), "a" if entries else "w", encoding="utf-8")
            if not entries:
                self._file.write(json.dumps({"interaction_id": interaction_id}) + "\n")
                self._file.flush()
            else:  # a process that was killed may have left half a line
                self._file.write("\n")
        except OSError as error:
            self._give_up(error)
        self._written = len(entries)
        return entries

    def _read(self, interaction_id: str) -> Tuple[List[Entry], int]:
        """Reads the spots on record and counts unreadable lines; a last line that was cut short is not damage."""
        if self._path is None:
            return [], 0
        try:
            with open(str(self._path), "rb") as file:
                # whatever is there: no more than a spot log can hold is read
                lines = file.read(200 * self._limit + 1000).decode("utf-8", errors="replace").split("\n")
        except OSError:
            return [], 0
        try:
            if json.loads(lines[0]).get("interaction_id") != interaction_id:
                return [], 0
        except (ValueError, AttributeError):
            return [], 0
        entries: List[Entry] = []
        damaged = 0
        for number, line in enumerate(lines[1:], start=2):
            if not line:
                continue
            try:
                state, stamp, x, y, camera, confidence, mobile = json.loads(line)
                spot = FloorSpot(float(stamp), float(x), float(y), str(camera), float(confidence), bool(mobile))
                entries.append((str(state), spot))
            except (ValueError, TypeError):
                damaged += number < len(lines)
        return entries, damaged

    def append(self, state: str, spot: FloorSpot) -> None:
        """Writes one spot; it is on disk after the next `flush`."""
        if self._file is None or self._written >= self._limit:
            return
        self._written += 1
        row = [state, spot.stamp, round(spot.x, 5), round(spot.y, 5), spot.camera, round(spot.confidence, 3)]
        try:
            self._file.write(json.dumps(row + [int(spot.mobile)]) + "\n")
        except (OSError, ValueError) as error:
            self._give_up(error)

    def flush(self) -> None:
        """Hands what was written to the system: from there it survives the process."""
        if self._file is None:
            return
        try:
            self._file.flush()
        except (OSError, ValueError) as error:
            self._give_up(error)

    def _give_up(self, error: Exception) -> None:
        """Stops writing for this interaction."""
        self.problem = CodedError("spot_log_unwritable", what=getattr(error, "strerror", None) or str(error))
        file, self._file = self._file, None
        try:
            if file is not None:
                file.close()
        except (OSError, ValueError):
            pass  # closing writes what is left, which fails again

    def discard(self) -> None:
        """Ends writing and removes the record: the interaction is over."""
        self.close()
        self.problem = None
        if self._path is not None:
            try:
                self._path.unlink()
            except OSError:
                pass  # there was none

    def close(self) -> None:
        """Ends writing; the record stays."""
        self.flush()
        if self._file is not None:
            self._file.close()
            self._file = None
