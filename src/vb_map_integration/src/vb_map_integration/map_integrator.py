"""Keeps physical map, borders, their database and the map with borders consistent.

Borders are kept in the frame of the map on which their place's first border was drawn. `PlaceRecognizer` finds which
place the current map shows, and `compute_borders_in_force` what is in force there, as one value, `BordersInForce`.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path
from typing import Any, List, Mapping, Optional, Sequence, Tuple

from vb_core import map_files
from vb_core.errors import CodedError
from vb_core.files import write_atomically
from vb_core.grid_map import GridMap, Transform
from vb_core.notices import Notice, Severity
from vb_map_integration.border import IntegrationError, VirtualBorder, borders_to_geojson, warning
from vb_map_integration.borders_in_force import BordersInForce, BorderStatus, compute_borders_in_force, find_notices
from vb_map_integration.places.border_location import BorderLocator
from vb_map_integration.places.recognition import PlaceRecognition, PlaceRecognizer
from vb_map_integration.restricted_cells import BorderCheck, Positions
from vb_map_integration.storage.border_database import BorderChange, Change, Database, fingerprint
from vb_map_integration.storage.durable_values import DurableValues


@dataclass(frozen=True)
class ChangeResult:
    """Result of a change: the ids of the borders that changed, and warnings."""

    ids: Tuple[str, ...] = ()
    issues: Tuple[Notice, ...] = ()


class MapIntegrator:
    """A physical map and its borders. Every change is checked, then written to disk, and only then made.

    Regions are always computed on the physical map, so what a border restricts does not depend on other borders.

    Args:
        root: folder of the database; None keeps borders in memory only.
        map_name: name of the place that the map shows; empty: the place is recognised by the map alone.
        robots: names of the robots that borders may name; empty: any.
        robot_radius: [m] radius of the robots, which decides what they can reach.

    Attributes:
        map_id: the current map's fingerprint.

    Raises:
        CodedError: "database_in_use".
    """

    def __init__(
        self, root: Optional[Path], map_name: str = "", robots: Sequence[str] = (), robot_radius: float = 0.18
    ) -> None:
        self._expected_name = map_name
        self._robots = robots
        self._robot_radius = robot_radius
        self._store = DurableValues(root)
        self._database = Database(self._store)
        self._recognizer = PlaceRecognizer(self._database, map_name)
        self._recognition = PlaceRecognition()
        self._locator: Optional[BorderLocator] = None  # None until the first map arrives, as `_borders_in_force`
        self._borders_in_force: Optional[BordersInForce] = None
        self.map_id = ""
        self._place_notices: List[Notice] = []  # why the map's place could not be recorded

    def close(self) -> None:
        """Releases the database."""
        self._store.close()

    # ------------------------------------------------------------- state
    @property
    def borders_in_force(self) -> BordersInForce:
        """What is in force; raises CodedError "no_map" until the first map arrives."""
        if self._borders_in_force is None:
            raise CodedError("no_map")
        return self._borders_in_force

    @property
    def has_map(self) -> bool:
        """Whether there is a physical map."""
        return self._borders_in_force is not None

    @property
    def physical_map(self) -> GridMap:
        """The physical map; raises CodedError "no_map" until the first one arrives."""
        return self.borders_in_force.physical_map

    @property
    def map_with_borders(self) -> GridMap:
        """The physical map with all borders in force; raises CodedError "no_map" until the first map arrives."""
        return self.borders_in_force.map_with_borders

    def map_with_borders_for(self, robot: str) -> GridMap:
        """Returns the map for one robot, with the borders that name this robot or none."""
        others = [border.id for border in self.borders if border.robots and robot not in border.robots]
        return self.borders_in_force.draw_map(excluded_ids=others)

    @property
    def borders(self) -> Tuple[VirtualBorder, ...]:
        """All borders of the current map, in its frame, oldest first."""
        return tuple(status.map_border for status in self._statuses)

    @property
    def _statuses(self) -> List[BorderStatus]:
        return list(self._borders_in_force.statuses.values()) if self._borders_in_force else []

    @property
    def revision(self) -> int:
        """The revision; it grows with every change."""
        return self._store.revision

    @property
    def map_name(self) -> str:
        """The name of the place that the current map shows; "" if it has none."""
        return self._database.place_name(self._recognition.place) if self._recognition.place else self._expected_name

    @property
    def needs_confirmation(self) -> bool:
        """Whether a person has to confirm which place the map shows, or that borders are right on it."""
        return not self._recognition.is_certain or any(status.can_be_confirmed for status in self._statuses)

    @property
    def notices(self) -> List[Notice]:
        """Notices about the database, the map's place, and borders that have changed on this map."""
        about_borders = find_notices(self._statuses, self._recognition.is_certain, self.map_name)
        return [*self._store.notices, *self._place_notices, *about_borders]

    # ------------------------------------------------------------- the physical map
    def set_map(self, grid: GridMap) -> bool:
        """Adopts a physical map: the first, another, or one that has grown. Returns whether anything changed."""
        map_id = fingerprint(grid)
        if map_id == self.map_id:
            return False
        previous_map = self.physical_map if self.has_map else None
        recognition = self._recognizer.recognize(grid, map_id, previous_map, self._recognition)
        self.map_id = map_id
        self._adopt_map(grid, recognition)
        if recognition.place:
            name = self._expected_name
            try:
                self._database.remember_place(recognition.place)
                if name and recognition.is_certain and not self.map_name:
                    self._database.rename_place(recognition.place, name)
                self._place_notices = []
            except CodedError as error:
                self._place_notices = [Notice.from_error(error, Severity.WARNING)]
        return True

    def _adopt_map(self, grid: GridMap, recognition: PlaceRecognition) -> None:
        """Puts a place's borders in force on a map: a new one, or the same one after a person's answer about it."""
        self._set_recognition(grid, recognition)
        borders = self._database.borders(recognition.place)
        without_borders = BordersInForce(grid, self._robot_radius)
        self._borders_in_force = compute_borders_in_force(borders, self._locator, without_borders, {})

    def _set_recognition(self, grid: GridMap, recognition: PlaceRecognition) -> None:
        """Sets what the current map was recognised as, and with it the locator of borders on it."""
        maps = self._database.maps_of(recognition.place)
        self._locator = BorderLocator(grid, self.map_id, maps, recognition.transform, recognition.other_transform)
        self._recognition = recognition

    # ------------------------------------------------------------- which place the map shows
    def confirm(self, is_same_place: bool, name: str, map_id: str = "") -> ChangeResult:
        """Adopts a person's answer about what the current map shows.

        Args:
            is_same_place: the map shows the place whose borders are in force, and they are right; else a new place.
            name: the place's new name; empty: unchanged.
            map_id: id of the map that the answer is about; empty: whichever is current.

        Raises:
            CodedError: "no_map", "map_changed", "bad_name", "name_taken", "drawn_on_this_map", "cannot_write".
        """
        grid, recognition = self.physical_map, self._recognition
        if map_id and map_id != self.map_id:
            raise CodedError("map_changed")
        stored_map = self._database.maps().get(self.map_id)
        transform = recognition.transform if is_same_place else Transform()
        place = recognition.place if is_same_place else 0
        self._database.check_name(name, place)
        if is_same_place and place and stored_map is not None and stored_map.place == place:
            if name:
                self._database.rename_place(place, name)
            self._database.remember_place(place)
        else:
            is_places_first = stored_map is not None and stored_map.number == stored_map.place
            if is_places_first and not is_same_place and self._database.borders(stored_map.place):
                raise CodedError("drawn_on_this_map")
            place = self._database.add_map(grid, self.map_id, place, transform, name)
        waiting = [status for status in self._statuses if is_same_place and status.can_be_confirmed]
        self._adopt_map(grid, PlaceRecognition(place, transform))
        changes = []
        for status in waiting:  # from now on, what these borders close off here counts as accepted
            accepted = status.map_border.replace(map_id=self.map_id).transform(transform.inverse)
            changes.append(BorderChange(accepted.id, status.stored_border, accepted))
        if changes:
            self._make_change(tuple(changes))
        return ChangeResult()  # which borders were accepted is no news

    def check(self, border: VirtualBorder, robot_positions: Positions = ()) -> BorderCheck:
        """Checks what adding a border, or replacing the one with the same id, would do; changes nothing.

        Raises:
            CodedError: "no_map", "unknown_robot", or as `BordersInForce.check_border`.
        """
        self._check_robots(border)
        return self.borders_in_force.check_border(border, robot_positions)

    def _check_robots(self, border: VirtualBorder) -> None:
        """Refuses a border that names unknown robots, if names are configured."""
        unknown = [robot for robot in border.robots if self._robots and robot not in self._robots]
        if unknown:
            raise IntegrationError("unknown_robot", robot=", ".join(unknown), known=", ".join(self._robots))

    # ------------------------------------------------------------- changes
    # `expected_revision` is the revision that the caller last saw, or 0 for any
    def add(
        self,
        border: VirtualBorder,
        now: float,
        robot_positions: Positions = (),
        expected_revision: int = 0,
        request_id: str = "",
    ) -> ChangeResult:
        """Adds a border; `now` is [s] ROS time. Raises CodedError if it is refused; then nothing has changed.

        Args:
            request_id: a repeated request with the same id adds nothing, and returns the first one's border id.
        """
        earlier = self._database.find_border_of_request(request_id)
        if earlier:
            return ChangeResult((earlier,))
        self._check_revision(expected_revision)
        if border.id:
            raise CodedError("id_not_empty", id=border.id)
        name = border.name or self._find_free_name("wall" if border.is_wall else "border")
        changes = {"id": self._database.next_id, "name": name, "created": now, "modified": now}
        return self._store_drawn(None, border, changes, robot_positions, request_id)

    def _find_free_name(self, kind: str) -> str:
        """Finds the first of "KIND 1", "KIND 2" and so on that no border of the current map has."""
        taken = {border.name for border in self.borders}
        numbered = (f"{kind} {number}" for number in itertools.count(1))
        return next(name for name in numbered if name not in taken)

    def update(
        self, border: VirtualBorder, now: float, robot_positions: Positions = (), expected_revision: int = 0
    ) -> ChangeResult:
        """Replaces the border with the same id. Raises CodedError if it is refused; then nothing has changed.

        If points and seed are unchanged, the map is not checked, so that a border that does not fit can be renamed.
        """
        self._check_revision(expected_revision)
        place, before = self._database.find_border(border.id)
        if place != self._recognition.place:
            raise CodedError("on_another_map", id=border.id)
        changes = {"name": border.name or before.name, "created": before.created, "modified": now}
        return self._store_drawn(before, border, changes, robot_positions)

    def _store_drawn(
        self,
        before: Optional[VirtualBorder],
        border: VirtualBorder,
        changes: Mapping[str, Any],
        robot_positions: Positions,
        request_id: str = "",
    ) -> ChangeResult:
        """Stores a border drawn on the current map, with some of its fields changed, in its place's frame."""
        self._check_robots(border)
        drawn = border.replace(map_id=self.map_id, **changes)
        if before is not None and drawn.has_same_area(self.borders_in_force.statuses[before.id].map_border):
            after = drawn.replace(points=before.points, seed=before.seed, map_id=before.map_id)
            check = None
        else:
            transform = self._recognition.transform
            after = drawn.transform(transform.inverse)
            # A preview is not enough: the map, the borders or the robots may have changed since. The border is checked as
            # it will be read back, because rounding may change it on the way to its place's frame and back.
            check = self.borders_in_force.check_border(after.transform(transform), robot_positions)
            if not self._recognition.is_certain:  # nobody knows yet which place the border would belong to
                raise IntegrationError("confirm_map_first")
            self._remember_map()
        return self._make_change((BorderChange(after.id, before, after),), request_id=request_id, check=check)

    def _remember_map(self) -> None:
        """Stores the current map if it is new: later maps are compared with those on which a person draws."""
        if self.map_id in self._locator.stored_maps:
            return
        place, transform = self._recognition.place, self._recognition.transform
        name = "" if place or self._database.find_place(self._expected_name) else self._expected_name
        place = self._database.add_map(self.physical_map, self.map_id, place, transform, name)
        self._set_recognition(self.physical_map, PlaceRecognition(place, transform))

    def set_enabled(self, border_id: str, enabled: bool, now: float, expected_revision: int = 0) -> ChangeResult:
        """Turns a border of any map on or off; raises CodedError."""
        return self._change_attributes(border_id, now, expected_revision, enabled=enabled)

    def rename(self, border_id: str, name: str, now: float, expected_revision: int = 0) -> ChangeResult:
        """Renames a border of any map; raises CodedError."""
        return self._change_attributes(border_id, now, expected_revision, name=name)

    def _change_attributes(self, border_id: str, now: float, expected_revision: int, **changes: Any) -> ChangeResult:
        self._check_revision(expected_revision)
        place, before = self._database.find_border(border_id)
        after = before.replace(modified=now, **changes)
        return self._make_change((BorderChange(border_id, before, after),), place=place)

    def remove(self, border_id: str, expected_revision: int = 0) -> ChangeResult:
        """Removes a border; raises CodedError "unknown_border"."""
        self._check_revision(expected_revision)
        place, before = self._database.find_border(border_id)
        return self._make_change((BorderChange(border_id, before, None),), place=place)

    def undo(self, request_id: str = "") -> ChangeResult:
        """Undoes the last change, only once per request id; raises CodedError "nothing_to_undo"."""
        return self._undo_or_redo("undo", request_id)

    def redo(self, request_id: str = "") -> ChangeResult:
        """Redoes the last undone change, only once per request id; raises CodedError "nothing_to_redo"."""
        return self._undo_or_redo("redo", request_id)

    def _undo_or_redo(self, kind: str, request_id: str) -> ChangeResult:
        earlier = self._database.find_border_of_request(request_id)
        if earlier:
            return ChangeResult((earlier,))
        return self._make_change(self._database.prepare_undo_or_redo(kind, self._recognition.place), kind, request_id)

    @property
    def available_commands(self) -> List[str]:
        """The commands "undo" and "redo", each only if there is something to undo or redo."""
        return self._database.available_commands(self._recognition.place)

    def _check_revision(self, expected_revision: int) -> None:
        """Refuses a change before there is a map, or one based on an older revision."""
        if not self.has_map:
            raise CodedError("no_map")
        if expected_revision and expected_revision != self.revision:
            raise CodedError("revision_conflict")

    def _make_change(
        self,
        change: Change,
        kind: str = "new",
        request_id: str = "",
        place: int = 0,
        check: Optional[BorderCheck] = None,
    ) -> ChangeResult:
        """Makes a change completely, or raises CodedError and changes nothing.

        Args:
            check: the check of a single border; None for changes whose warnings are the statuses of their borders.
        """
        place = place or self._recognition.place
        borders = self._database.commit(place, change, kind, request_id)
        issues = ()
        if place == self._recognition.place:
            regions = {change[0].id: check.region} if check else {}
            self._borders_in_force = compute_borders_in_force(borders, self._locator, self.borders_in_force, regions)
            statuses = [self.borders_in_force.statuses[entry.id] for entry in change if entry.after is not None]
            issues = tuple(warning(status.code, **status.sentence_values) for status in statuses if status.code)
        return ChangeResult(tuple(entry.id for entry in change), check.issues if check else issues)

    # ------------------------------------------------------------- files
    def save(self, folder: Path, name: str, raw: bool) -> List[Path]:
        """Writes the map with borders as map_server files, and the borders as GeoJSON beside them.

        Raises:
            CodedError: "bad_file_name", "no_map", "cannot_write".
        """
        stem = map_files.safe_path(folder, name)
        files = map_files.write_map(stem, self.map_with_borders, raw)
        borders = Path(f"{stem}.borders.geojson")
        write_atomically(borders, borders_to_geojson(self.borders).encode())
        return files + [borders]
