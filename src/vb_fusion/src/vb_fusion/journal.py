"""A small file from which a restarted node restores the point set of the interaction it was in.

One JSON document per line: the first names the interaction, each other one holds one spot and the state it was
collected in. Appended as spots come, so that a process that is killed loses at most its unwritten buffer.
"""
from __future__ import annotations

import json
import os
from pathlib import Path
from typing import List, Optional, Tuple

from vb_core.errors import CodedError
from vb_fusion.collector import Spot

Entry = Tuple[str, Spot]


class Journal:
    """Appends spots, and reads them back.

    Args:
        path: the file; its folder is made. None: nothing is written.
        limit: spots after which no more are written: the file stays below about 80 bytes for each.

    Raises:
        CodedError: "journal_unwritable" if the folder cannot be made.
    """

    def __init__(self, path: Optional[Path], limit: int = 60000) -> None:
        self._path = path
        self._limit = limit
        self._written = 0
        self._file = None
        if path is None:
            return
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise CodedError("journal_unwritable", f"cannot make the folder {path.parent}: {error.strerror}") from None

    def start(self, interaction_id: str) -> List[Entry]:
        """Begins an interaction, or continues it.

        Returns:
            The spots that are on record for this interaction; empty for another one, whose record is replaced.

        Raises:
            CodedError: "journal_unwritable".
        """
        if self._path is None:
            return []
        self.close()
        entries = self.read(interaction_id)
        try:
            self._file = open(str(self._path), "a" if entries else "w")
            if not entries:
                self._file.write(json.dumps({"interaction_id": interaction_id}) + "\n")
                self._file.flush()
            # a process that was killed may have left half a line
            elif not self._ends_with_newline():
                self._file.write("\n")
        except OSError as error:
            raise CodedError("journal_unwritable", f"cannot write {self._path}: {error.strerror}") from None
        self._written = len(entries)
        return entries

    def _ends_with_newline(self) -> bool:
        with open(str(self._path), "rb") as file:
            file.seek(-1, os.SEEK_END)
            return file.read(1) == b"\n"

    def read(self, interaction_id: str) -> List[Entry]:
        """The spots on record for an interaction; unreadable lines are left out."""
        entries: List[Entry] = []
        if self._path is None:
            return entries
        try:
            with open(str(self._path)) as file:
                if json.loads(file.readline()).get("interaction_id") != interaction_id:
                    return entries
                for line in file:
                    try:
                        state, stamp, x, y, camera, confidence = json.loads(line)
                        spot = Spot(float(stamp), float(x), float(y), str(camera), float(confidence))
                        entries.append((str(state), spot))
                    except (ValueError, TypeError):
                        continue
        except (OSError, ValueError, AttributeError):
            return []
        return entries

    def append(self, state: str, spot: Spot) -> None:
        """Writes one spot; it is on disk after the next `flush`."""
        if self._file is None or self._written >= self._limit:
            return
        self._written += 1
        self._file.write(
            json.dumps([state, spot.stamp, round(spot.x, 5), round(spot.y, 5), spot.camera, round(spot.confidence, 3)])
            + "\n"
        )

    def flush(self) -> None:
        """Hands what was written to the system: from there it survives the process."""
        if self._file is not None:
            self._file.flush()

    def discard(self) -> None:
        """Ends writing and removes the record: the interaction is over."""
        self.close()
        if self._path is not None:
            try:
                self._path.unlink()
            except OSError:
                pass  # there was none

    def close(self) -> None:
        """Ends writing; the record stays."""
        if self._file is not None:
            self._file.close()
            self._file = None
