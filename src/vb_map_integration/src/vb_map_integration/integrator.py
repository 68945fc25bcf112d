"""Physical map, borders, their database and the map with borders, kept together.

Borders are kept in the frame of the map on which their place's first border was drawn; here they are moved into the
current map's frame. Which borders are in force, and why others are not, is decided in one place: `_recompute`.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, Iterable, List, Mapping, Optional, Sequence, Tuple

import numpy as np

from vb_core import sentences
from vb_core import map_files
from vb_core.errors import CodedError
from vb_core.files import write_atomically
from vb_core.grid_map import GridMap
from vb_core.notices import Notice, Severity
from vb_core.parameters import param
from vb_map_integration.border import SLOW, VirtualBorder
from vb_map_integration.borders.border_files import borders_to_yaml
from vb_map_integration.grid.layered_map import LayeredMap, Region
from vb_map_integration.storage.database import BorderChange, Change, Database, KnownMap, fingerprint
from vb_map_integration.borders.issues import WARNING, Issue, IntegrationError, make_issue
from vb_map_integration.integration import Area, IntegrationParams, restricted_area
from vb_map_integration.storage.legacy_folders import read_folders
from vb_map_integration.places.map_overlay import draw_map_overlay
from vb_map_integration.grid.reachability import Reachability, check_reachability
from vb_map_integration.places.recognition import PlaceRecognition, PlaceRecognizer
from vb_map_integration.places.registration import Registration, Transform, register
from vb_map_integration.borders.schedule import is_scheduled

_NAMED = 3  # borders by which a place is described


@dataclass(frozen=True)
class IntegratorParams(IntegrationParams):
    """The map integrator's parameters."""

    robot_radius: float = param(0.18, "m", low=0.0)
    min_component_area: float = param(0.1, "m^2", low=0.0)
    check_reachability: bool = param(True)
    dock: list = param([], "m")
    robot_name: str = param("")
    robots: list = param([])
    map_name: str = param("")

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.dock) not in (0, 2):
            raise CodedError("bad_parameter", f"dock: expected x and y or nothing, got {self.dock!r}")


@dataclass(frozen=True)
class CheckResult:
    """Effect that adding or changing a border would have.

    Attributes:
        area: what it would restrict.
        issues: warnings, the integration's first.
        reachability: parts of the free space and goals out of reach; None if not requested.
        layered_map: the map with it.
    """

    area: Area
    issues: Tuple[Issue, ...]
    reachability: Optional[Reachability]
    layered_map: LayeredMap


@dataclass(frozen=True)
class ChangeResult:
    """Result of a change.

    Attributes:
        ids: of the borders that changed.
        issues: warnings.
        message: a sentence for the person.
    """

    ids: Tuple[str, ...]
    issues: Tuple[Issue, ...]
    message: str


@dataclass(frozen=True)
class MapMatch:
    """Position that the borders of a known map would have in the current map.

    Attributes:
        place: number of their place.
        transform: from the frame of that place to the current map's.
        registration: what it rests on; None if it was given, or nothing was found.
        image: PNG of both maps and the moved borders.
    """

    place: int
    transform: Transform
    registration: Optional[Registration]
    image: bytes


class MapIntegrator:
    """Physical map plus borders. Every change is checked, written to disk and only then made.

    Regions are always computed on the physical map, so what a border restricts does not depend on others.

    Args:
        params: checked parameters.
        root: folder of the database; None keeps borders in memory only.

    Raises:
        CodedError: "database_in_use".
    """

    def __init__(self, params: IntegratorParams, root: Optional[Path]) -> None:
        self.params = params
        self._database = Database(root)
        self._imported: List[Notice] = []
        if root is not None:
            try:
                self._import_legacy(root)
            except CodedError as error:  # the database says so itself; the next start tries again
                self._imported.append(Notice(error.code, Severity.ERROR, values=error.values))
        self._recognizer = PlaceRecognizer(self._database, params.map_name)
        self._layered_map: Optional[LayeredMap] = None
        self._recognition = PlaceRecognition()
        self._map_id = ""
        self._parts: Optional[int] = None
        # by border: as it is in the current map, whether it is due, why it does not act, what a slow zone covers
        self._moved: Dict[str, VirtualBorder] = {}
        self._due: Dict[str, bool] = {}
        self._reasons: Dict[str, str] = {}
        self._slow: Dict[str, Tuple[Region, float]] = {}

    def reopen(self, now: float = 0.0) -> Optional["MapIntegrator"]:
        """Makes another integrator with the same map, once a disk can be written that could not be at the start of this one.

        Returns None as long as nothing is gained by it; else this one is closed.

        Raises:
            CodedError: as at a start; this one is closed then, too.
        """
        if not self._database.can_reopen():
            return None
        self.close()
        again = MapIntegrator(self.params, self._database.folder)
        if self.has_map:
            again.set_map(self.physical, now)
        return again

    def close(self) -> None:
        """Releases the database."""
        self._database.close()

    def _import_legacy(self, root: Path) -> None:
        """Imports borders of older versions, once; their folders stay as they are."""
        for folder in read_folders(root):
            note = f"taken over: {folder.name}"  # as databases have it
            if self._database.get_value(note):
                continue
            place = self._database.add_map(folder.grid, folder.map_id or folder.name)
            renamed = self._database.import_legacy(place, folder.borders, note)
            self._database.remember_place(place)
            values = {"count": str(len(folder.borders)), "folder": folder.name, "renamed": str(len(renamed))}
            code = "borders_imported" if folder.whole else "borders_imported_damaged"
            severity = Severity.INFO if folder.whole else Severity.WARNING
            self._imported.append(Notice(code, severity, values=values))

    # ------------------------------------------------------------- state
    @property
    def map_with_borders(self) -> GridMap:
        """The physical map with all borders that act; CodedError "no_map" before there is a map."""
        return self._ready().map_with_borders

    def map_with_borders_for(self, robot: str) -> GridMap:
        """Returns the physical map with the borders for one robot: those that name it, or none."""
        others = {border.id: None for border in self.borders if border.robots and robot not in border.robots}
        return self._ready().with_regions(others).map_with_borders if others else self.map_with_borders

    @property
    def speed_limits(self) -> GridMap:
        """The highest speed in each cell [cm/s], 0: no limit; the geometry of the map."""
        cells = np.zeros(self.physical.shape, np.int8)
        for region, speed in self._slow.values():
            part = cells[region.window]
            limit = np.int8(max(1, min(127, round(100.0 * speed))))
            inside = region.mask != 0
            part[inside] = np.where(part[inside] == 0, limit, np.minimum(part[inside], limit))
        return self.physical.with_data(cells)

    @property
    def has_speed_limits(self) -> bool:
        """Returns whether a slow zone is in force."""
        return bool(self._slow)

    @property
    def physical(self) -> GridMap:
        """The physical map; CodedError "no_map" before there is one."""
        return self._ready().physical

    @property
    def has_map(self) -> bool:
        """Returns whether there is a physical map."""
        return self._layered_map is not None

    @property
    def borders(self) -> Tuple[VirtualBorder, ...]:
        """All borders of the current map, in its frame, oldest first."""
        if not self.has_map:
            return ()
        return tuple(self._moved[border.id] for border in self._database.borders(self._recognition.place))

    @property
    def revision(self) -> int:
        """Grows with every change."""
        return self._database.revision

    @property
    def map_id(self) -> str:
        """The current map's fingerprint."""
        return self._map_id

    @property
    def map_name(self) -> str:
        """The name of the place that the current map shows; "" if it has none."""
        return self._database.get_name(self._recognition.place) if self._recognition.place else self.params.map_name

    @property
    def needs_confirmation(self) -> bool:
        """Returns whether the current map may show another place than the one to which the borders in force belong."""
        return not self._recognition.certain

    @property
    def notices(self) -> List[Notice]:
        """What people should know: about the files, the map, and borders that do not fit it."""
        found = [*self._database.notices, *self._imported]
        if self.needs_confirmation:
            values = {"count": str(len(self.borders)), **self._place_in_words()}
            found.append(Notice("borders_unconfirmed", Severity.WARNING, values=values))
        for border in self.borders:
            reason = self.status(border)[1]
            if reason == "inactive_on_this_map":
                why = self._reasons[border.id]
                found.append(Notice(reason, Severity.WARNING, "", border.id, "", {"border": border.name, "why": why}))
        return found

    def _place_in_words(self) -> Dict[str, str]:
        """Describes the place in question to people: by the name that they gave it, else by its borders and their date."""
        if self.map_name:
            return {"place": "$find_place", "map": self.map_name}
        drawn = sorted(self.borders, key=lambda border: border.created)
        if not drawn:
            return {"place": "$place_before"}
        names = ", ".join(border.name for border in drawn[:_NAMED]) + (", ..." if len(drawn) > _NAMED else "")
        return {
            "place": "$place_of_borders",
            "borders": names,
            "date": time.strftime("%Y-%m-%d", time.localtime(drawn[0].created)),
        }

    def area_m2(self, border_id: str) -> float:
        """Returns the area [m^2] that a border restricts now; 0 if it is not in force."""
        slow = self._slow.get(border_id)
        return slow[0].area_m2 if slow else self._ready().area_m2(border_id)

    def status(self, border: VirtualBorder) -> Tuple[bool, str]:
        """Returns whether a border is in force now, and if not why.

        Returns:
            (in force, code): "other_robot", "disabled", "off_schedule", "inactive_on_this_map", "no_effect" or "".
        """
        if not self._applies_here(border):
            return False, "other_robot"
        if not self._due.get(border.id, False):
            return False, "off_schedule" if border.enabled else "disabled"
        if border.id in self._reasons:
            return False, "inactive_on_this_map"
        if border.value == 0 and border.zone != SLOW:
            return False, "no_effect"
        return True, ""

    def _ready(self) -> LayeredMap:
        if self._layered_map is None:
            raise CodedError("no_map")
        return self._layered_map

    # ------------------------------------------------------------- the physical map
    def set_map(self, grid: GridMap, now: float = 0.0) -> Tuple[bool, Tuple[str, ...]]:
        """Adopts the physical map; the first one, another one, or one that has grown.

        Args:
            now: [s] decides what schedules say.

        Returns:
            Whether anything changed, and sentences for the person.
        """
        map_id = fingerprint(grid)
        if map_id == self._map_id:
            return False, ()
        before = self._layered_map.physical if self._layered_map else None
        recognition = self._recognizer.recognize(grid, map_id, before, self._recognition)
        self._map_id = map_id
        self._use(grid, recognition, now)
        if recognition.place:
            name = self.params.map_name
            try:
                self._database.remember_place(recognition.place)
                if name and recognition.certain and not self.map_name:
                    self._database.rename_place(recognition.place, name)
            except CodedError as error:
                return True, (error.message, *(notice.sentence() for notice in self.notices))
        return True, tuple(notice.sentence() for notice in self.notices)

    def _use(self, grid: GridMap, recognition: PlaceRecognition, now: float) -> None:
        self._recognition, self._parts = recognition, None
        self._moved, self._due, self._reasons, self._slow = {}, {}, {}, {}
        self._layered_map = self._recompute(LayeredMap(grid), self._database.borders(recognition.place), now)

    def _recompute(
        self,
        layered_map: LayeredMap,
        stored: Iterable[VirtualBorder],
        now: float,
        gone: Sequence[str] = (),
        check: Optional[CheckResult] = None,
    ) -> LayeredMap:
        """Applies borders to the current map: only here is it decided which act, and why others do not.

        Args:
            stored: borders in the frame of their place.
            gone: ids of borders that were removed.
            check: of the only one of these borders, on the same layered map; nothing is computed twice then.
        """
        regions: Dict[str, Optional[Region]] = {}
        for known in (self._moved, self._due, self._reasons, self._slow):
            for key in gone:
                known.pop(key, None)  # type: ignore[attr-defined]
        for key in gone:
            regions[key] = None
        for border in (one.moved(self._recognition.transform) for one in stored):
            self._moved[border.id] = border
            self._due[border.id] = _is_due(border, now)
            self._reasons.pop(border.id, None)
            self._slow.pop(border.id, None)
            regions[border.id] = None
            if not (self._due[border.id] and self._applies_here(border)):
                continue
            if check is not None and border.zone != SLOW:
                return check.layered_map
            try:
                region = Region.of(restricted_area(layered_map.physical, border, self.params))
            except IntegrationError as error:
                self._reasons[border.id] = error.code
                continue
            if border.zone == SLOW:
                self._slow[border.id] = region, border.max_speed
            else:
                regions[border.id] = region
        return layered_map.with_regions(regions)

    def _applies_here(self, border: VirtualBorder) -> bool:
        return not self.params.robot_name or not border.robots or self.params.robot_name in border.robots

    # ------------------------------------------------------------- which place the map shows
    def confirm(self, same: bool, name: str, now: float) -> ChangeResult:
        """Adopts a person's answer about what the current map shows.

        Args:
            same: the place whose borders are in force, moved as they are now; else a new place, without borders.
            name: for the place; empty: as it is.

        Raises:
            CodedError: "no_map", "name_taken", "drawn_on_this_map", "cannot_write".
        """
        grid, recognition = self.physical, self._recognition
        known = self._database.find_map(self._map_id)
        if same:
            place = recognition.place
            if not place or known is None or known.place != place:
                place = self._database.add_map(grid, self._map_id, place, recognition.transform)
            transform = recognition.transform
        else:
            if known is not None and known.id == known.place and self._database.count(known.place):
                raise CodedError("drawn_on_this_map")
            if self._database.find_place(name):
                raise CodedError("name_taken", name=name)
            place, transform = self._database.add_map(grid, self._map_id), Transform()
        if name:
            self._database.rename_place(place, name)
        self._use(grid, PlaceRecognition(place, transform), now)
        self._database.remember_place(place)
        return ChangeResult((), (), sentences.translate("map_confirmed", {"count": len(self.borders)}))

    def propose_transfer(self, which: str, transform: Optional[Transform] = None) -> MapMatch:
        """Finds where the borders of a known map would be in the current one; changes nothing.

        Args:
            which: the fingerprint or the name of their map; empty: of the place whose borders are in force.
            transform: from that place's frame to the current map's; None: by registration.

        Raises:
            CodedError: "no_map", "unknown_map".
        """
        grid = self.physical
        source = self._source(which)
        found: Optional[Registration] = None
        if transform is None:
            found = register(source.grid, grid) if source.grid is not None else None
            transform = found.transform.after(source.transform) if found else Transform()
        moved = [border.moved(transform) for border in self._database.borders(source.place)]
        image = draw_map_overlay(source.grid, grid, transform.after(source.transform.inverse), moved)
        return MapMatch(source.place, transform, found, image)

    def transfer(self, proposal: MapMatch, now: float) -> ChangeResult:
        """Transfers the borders of another map to the current one; from now on both show the same place.

        Raises:
            CodedError: "place_has_borders", "cannot_write".
        """
        known = self._database.find_map(self._map_id)
        if known is not None and known.id == known.place:
            if proposal.place == known.place or self._database.count(known.place):
                raise CodedError("place_has_borders")
        self._database.add_map(self.physical, self._map_id, proposal.place, proposal.transform)
        self._use(self.physical, PlaceRecognition(proposal.place, proposal.transform), now)
        self._database.remember_place(proposal.place)
        return ChangeResult((), (), sentences.translate("borders_transferred", {"count": len(self.borders)}))

    def _source(self, which: str) -> KnownMap:
        maps = self._database.maps()
        if not which:
            chosen = [one for one in maps if one.place == self._recognition.place]
        else:
            chosen = [one for one in maps if which in (one.fingerprint, one.name)]
        if not chosen:
            raise CodedError("unknown_map", map=which)
        return chosen[0]

    # ------------------------------------------------------------- checks
    def check(
        self,
        border: VirtualBorder,
        places: Optional[Mapping[str, Sequence[float]]] = None,
        goals: Optional[Sequence[Sequence[float]]] = None,
    ) -> CheckResult:
        """Checks what adding a border, or replacing the one of the same id, would do; changes nothing.

        Args:
            places: positions [m] by name ("robot"); being inside is a warning.
            goals: (N, 2) [m], places whose reachability is checked.

        Raises:
            CodedError: "no_map", or an IntegrationError with all issues.
        """
        before = self._ready()
        self._check_robots(border)
        places = dict(places or {})
        if self.params.dock:
            places["dock"] = self.params.dock
        area = restricted_area(before.physical, border, self.params, places)
        after = before.with_regions({border.id: None if border.zone == SLOW else Region.of(area)})
        issues = list(area.issues)
        found: Optional[Reachability] = None
        if goals is not None or self.params.check_reachability:
            options = {
                "robot": places.get("robot"),
                "radius": self.params.robot_radius,
                "min_component_area": self.params.min_component_area,
                "occupied_threshold": self.params.occupied_threshold,
            }
            if self._parts is None:
                self._parts = check_reachability(before.map_with_borders, **options).free_parts
            found = check_reachability(after.map_with_borders, () if goals is None else goals, **options)
            if found.free_parts > self._parts:
                issues.append(make_issue(WARNING, "splits_free_space"))
            if found.free_parts == 0 and self._parts > 0:
                issues.append(make_issue(WARNING, "no_free_space_left"))
        return CheckResult(area, tuple(issues), found, after)

    def _check_robots(self, border: VirtualBorder) -> None:
        known = self.params.robots
        unknown = [robot for robot in border.robots if known and robot not in known]
        if unknown:
            raise IntegrationError("unknown_robot", robot=", ".join(unknown), known=", ".join(map(str, known)))

    # ------------------------------------------------------------- changes
    # `expected` is the revision that the caller has seen; 0: any
    def add(
        self,
        border: VirtualBorder,
        now: float,
        places: Optional[Mapping[str, Sequence[float]]] = None,
        expected: int = 0,
        request_id: str = "",
    ) -> ChangeResult:
        """Adds a border; `now` is [s] ROS time. Raises CodedError if it is refused; then nothing changed.

        Args:
            request_id: a repetition of the same request adds nothing and returns the first one's id.
        """
        known = self._database.find_border_of_request(request_id)
        if known:
            return ChangeResult((known,), (), sentences.translate("already_added"))
        self._expect(expected)
        self._check_time(border, now)
        new = self._database.new_border(border, now, self._recognition.place)
        check = self.check(new, places)
        self._check_confirmed()
        self._keep_map()
        self._commit(
            self._recognition.place,
            (BorderChange(new.id, None, self._to_place_frame(new)),),
            "new",
            now,
            request_id,
            check,
        )
        return ChangeResult((new.id,), check.issues, f"'{new.name}' restricts {check.area.area_m2:.2f} m2")

    def update(
        self,
        border: VirtualBorder,
        now: float,
        places: Optional[Mapping[str, Sequence[float]]] = None,
        expected: int = 0,
    ) -> ChangeResult:
        """Replaces the border of the same id; raises CodedError if it is refused; then nothing changed.

        A border whose points and seed stay as they are is not refused because it does not fit the map.
        """
        self._ready()
        self._expect(expected)
        place, before = self._database.find(border.id)
        if place != self._recognition.place:
            raise CodedError("on_another_map", id=border.id)
        self._check_time(border, now)
        self._check_robots(border)
        check: Optional[CheckResult] = None
        after = border.replace(name=border.name or before.name, created=before.created, modified=now)
        if border.same_area(self._moved[border.id]):
            after = after.replace(points=before.points, seed=before.seed)
        else:
            check = self.check(border, places)
            self._check_confirmed()
            self._keep_map()
            after = self._to_place_frame(after)
        issues = self._commit(place, (BorderChange(border.id, before, after),), "new", now, "", check)
        return ChangeResult((border.id,), check.issues if check else issues, f"'{after.name}' was changed")

    def set_enabled(
        self, border_id: str, enabled: bool, now: float, expires: float = 0.0, expected: int = 0
    ) -> ChangeResult:
        """Turns a border of any map on or off, for ever or until `expires` [s]; raises CodedError."""
        return self._adjust(border_id, now, expected, enabled=enabled, expires=expires)

    def rename(self, border_id: str, name: str, now: float, expected: int = 0) -> ChangeResult:
        """Renames a border of any map; raises CodedError."""
        return self._adjust(border_id, now, expected, name=name)

    def _adjust(self, border_id: str, now: float, expected: int, **changes: Any) -> ChangeResult:
        self._ready()
        self._expect(expected)
        place, before = self._database.find(border_id)
        after = before.replace(modified=now, **changes)
        self._check_time(after, now)
        return self._make_change(((BorderChange(border_id, before, after)),), "new", "changed", now, place)

    def remove(self, border_id: str, now: float = 0.0, expected: int = 0) -> ChangeResult:
        """Removes a border; raises CodedError "unknown_border"."""
        self._ready()
        self._expect(expected)
        place, before = self._database.find(border_id)
        return self._make_change((BorderChange(border_id, before, None),), "new", "removed", now, place)

    def clear(self, now: float = 0.0) -> ChangeResult:
        """Removes all borders of the current map; raises CodedError "nothing_to_clear"."""
        stored = self._database.borders(self._recognition.place)
        if not stored:
            raise CodedError("nothing_to_clear")
        return self._make_change(
            tuple(BorderChange(border.id, border, None) for border in stored), "new", "removed", now
        )

    def undo(self, now: float = 0.0) -> ChangeResult:
        """Undoes the last change; raises CodedError "nothing_to_undo"."""
        return self._make_change(self._database.prepare_undo(self._recognition.place), "undo", "changed back", now)

    def redo(self, now: float = 0.0) -> ChangeResult:
        """Redoes what was undone last; raises CodedError "nothing_to_redo"."""
        return self._make_change(self._database.prepare_redo(self._recognition.place), "redo", "changed again", now)

    @property
    def available_commands(self) -> List[str]:
        """Lists "undo" and "redo", each if there is something to undo or redo."""
        return self._database.available_commands(self._recognition.place)

    def expire(self, now: float) -> Optional[ChangeResult]:
        """Toggles borders that expire, begins and ends scheduled times; None if nothing changed."""
        stored = self._database.borders(self._recognition.place)
        change = tuple(
            BorderChange(border.id, border, border.replace(enabled=not border.enabled, expires=0.0, modified=now))
            for border in stored
            if 0.0 < border.expires <= now
        )
        refused: Optional[CodedError] = None
        if change:
            try:  # an expiry is no command: undo goes on to what a person did
                return self._make_change(change, "quiet", "expired and toggled", now)
            except CodedError as error:
                refused = error
        # whether a border is due does not wait for the disk
        turned = [border for border in stored if _is_due(border, now) != self._due.get(border.id)]
        if turned:
            self._layered_map, self._parts = self._recompute(self._ready(), turned, now), None
            names = ", ".join(f"'{border.name}'" for border in turned)
            return ChangeResult(tuple(border.id for border in turned), (), f"on or off by time: {names}")
        if refused is not None:
            raise refused
        return None

    def _expect(self, expected: int) -> None:
        if expected and expected != self.revision:
            raise CodedError("revision_conflict")

    def _check_confirmed(self) -> None:
        """Refuses changes while it is unknown which place the map shows: what is drawn would belong to no place."""
        if self.needs_confirmation:
            raise IntegrationError("confirm_map_first")

    @staticmethod
    def _check_time(border: VirtualBorder, now: float) -> None:
        if 0.0 < border.expires <= now:
            raise CodedError("already_expired")

    def _to_place_frame(self, border: VirtualBorder) -> VirtualBorder:
        """Returns a border of the current map in the frame of its place."""
        return border.moved(self._recognition.transform.inverse)

    def _keep_map(self) -> None:
        """Keeps the map on which a person draws: later ones are compared with it."""
        if self._database.find_map(self._map_id) is None:
            place = self._database.add_map(
                self.physical,
                self._map_id,
                self._recognition.place,
                self._recognition.transform,
                "" if self._recognition.place else self._free_name(),
            )
            self._database.remember_place(place)
            self._recognition = PlaceRecognition(place, self._recognition.transform)

    def _free_name(self) -> str:
        return "" if self._database.find_place(self.params.map_name) else self.params.map_name

    def _make_change(self, change: Change, kind: str, what: str, now: float, place: int = 0) -> ChangeResult:
        issues = self._commit(place or self._recognition.place, change, kind, now)
        names = ", ".join(f"'{(entry.after or entry.before).name}'" for entry in change)  # type: ignore[union-attr]
        return ChangeResult(tuple(entry.id for entry in change), issues, f"{what}: {names}")

    def _commit(
        self,
        place: int,
        change: Change,
        kind: str,
        now: float,
        request_id: str = "",
        check: Optional[CheckResult] = None,
    ) -> Tuple[Issue, ...]:
        """Makes a change, all of it or, with a CodedError, nothing; returns warnings about borders that do not act."""
        ready = self._ready()
        self._database.commit(place, change, kind, request_id)
        if place != self._recognition.place:
            return ()
        stored = [entry.after for entry in change if entry.after is not None]
        gone = [entry.id for entry in change if entry.after is None]
        self._layered_map, self._parts = self._recompute(ready, stored, now, gone, check), None
        if check is not None and check.reachability is not None and self.status(self._moved[change[0].id])[0]:
            self._parts = check.reachability.free_parts
        found = [self._moved[border.id] for border in stored if border.id in self._reasons]
        values = [{"border": border.name, "why": self._reasons[border.id]} for border in found]
        return tuple(make_issue(WARNING, "inactive_on_this_map", **one) for one in values)

    # ------------------------------------------------------------- files
    def save(self, folder: Path, name: str, raw: bool) -> List[Path]:
        """Writes the map with borders as map_server files, and the borders as YAML beside it.

        Raises:
            CodedError: "bad_file_name", "no_map", "cannot_write".
        """
        stem = map_files.safe_path(folder, name)
        files = map_files.write_map(stem, self.map_with_borders, raw)
        borders = Path(f"{stem}.borders.yaml")
        write_atomically(borders, borders_to_yaml(self.borders).encode())
        return files + [borders]


def _is_due(border: VirtualBorder, now: float) -> bool:
    """Returns whether a border is on at a time [s], also if it expired and that could not be written yet."""
    expired = 0.0 < border.expires <= now
    return border.enabled != expired and is_scheduled(border.schedule, now)
