"""Physical map, borders, their files and the posterior map, kept together."""
from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Dict, List, Mapping, Optional, Sequence, Tuple

from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_core.parameters import param
from vb_map_integration import map_files
from vb_map_integration.border import VirtualBorder
from vb_map_integration.border_files import borders_to_yaml
from vb_map_integration.border_folders import BorderFolder, BorderFolders
from vb_map_integration.composition import Composition, Region
from vb_map_integration.findings import WARNING, Finding, IntegrationError
from vb_map_integration.integration import Area, IntegrationParams, restricted_area
from vb_map_integration.map_binding import compatible, fingerprint
from vb_map_integration.preview import Ways, ways
from vb_map_integration.store import BorderStore, Change


@dataclass(frozen=True)
class IntegratorParams(IntegrationParams):
    """What the map integrator goes by."""

    robot_radius_m: float = param(0.18, "m", low=0.0, doc="robot's radius, for what it can reach; TurtleBot 2")
    least_part_m2: float = param(0.1, "m^2", low=0.0, doc="smaller parts of the free space are not counted")
    check_ways: bool = param(True, doc="whether saving looks for free space that falls into parts")
    dock: list = param([], "m", doc="x and y of the robot's dock; empty: none")
    robot_name: str = param("", doc="whose map this is: borders for other robots are left out; empty: all act")

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.dock) not in (0, 2):
            raise CodedError("bad_parameter", f"dock: expected x and y or nothing, got {self.dock!r}")


@dataclass(frozen=True)
class Check:
    """What adding or changing a border would do.

    Attributes:
        area: what it would restrict.
        findings: warnings, those of the integration first.
        ways: parts of the free space and goals out of reach; None if they were not asked for.
        composition: the map with it.
    """

    area: Area
    findings: Tuple[Finding, ...]
    ways: Optional[Ways]
    composition: Composition


@dataclass(frozen=True)
class Outcome:
    """What a change did.

    Attributes:
        ids: of the borders that changed.
        findings: warnings.
        message: a sentence for the person.
    """

    ids: Tuple[str, ...]
    findings: Tuple[Finding, ...]
    message: str


class MapIntegrator:
    """Physical map plus borders. Every change is checked, written to the disk and only then made.

    Regions are always computed on the physical map, so what a border restricts does not depend on others.

    Args:
        params: checked parameters.
        root: folder for the borders of all maps; None keeps them in memory only.
    """

    def __init__(self, params: IntegratorParams, root: Optional[Path]) -> None:
        self.params = params
        self._folders = BorderFolders(root) if root is not None else None
        self._folder: Optional[BorderFolder] = None
        self._composition: Optional[Composition] = None
        self._store = BorderStore()
        self._map_id = ""
        self._parts: Optional[int] = None

    # ------------------------------------------------------------- state
    @property
    def posterior(self) -> GridMap:
        """The physical map with all borders that act; CodedError "no_map" before there is a map."""
        return self._ready().posterior

    def posterior_for(self, robot: str) -> GridMap:
        """The physical map with those borders that hold for one robot: they name it, or none."""
        others = {border.id: None for border in self.borders if border.robots and robot not in border.robots}
        return self._ready().changed(others).posterior

    @property
    def physical(self) -> GridMap:
        """The physical map; CodedError "no_map" before there is one."""
        return self._ready().physical

    @property
    def has_map(self) -> bool:
        """Whether there is a physical map."""
        return self._composition is not None

    @property
    def borders(self) -> Tuple[VirtualBorder, ...]:
        """All borders, the oldest first."""
        return self._store.borders

    @property
    def revision(self) -> int:
        """Grows with every change."""
        return self._store.revision

    def area_m2(self, border_id: str) -> float:
        """[m^2] that a border restricts now; 0 while it is disabled."""
        return self._ready().area_m2(border_id)

    def _ready(self) -> Composition:
        if self._composition is None:
            raise CodedError("no_map", "there is no physical map yet: is the map server running?")
        return self._composition

    # ------------------------------------------------------------- the physical map
    def set_map(self, grid: GridMap) -> Tuple[bool, Tuple[str, ...]]:
        """Takes the physical map; the first one, another one, or one that has grown.

        Returns:
            Whether anything changed, and sentences for the person.
        """
        map_id = fingerprint(grid)
        if map_id == self._map_id:
            return False, ()
        notes: List[str] = []
        if self._folders is None:
            notes.extend(self._forget_if_elsewhere(grid))
        else:
            try:
                folder, found = self._folders.open(grid)
                notes.extend(found)
                if self._folder is None or folder.folder != self._folder.folder:
                    loaded = folder.load()
                    notes.extend(loaded.notes)
                    self._store = loaded.store
                    self._folder = folder
                self._folder.map_id = map_id
            except CodedError as error:
                self._folder = None
                notes.append(f"{error.message}: borders will be lost when this program ends")
                notes.extend(self._forget_if_elsewhere(grid))
        self._map_id = map_id
        self._parts = None
        self._composition, doubts = self._composed(Composition(grid), {border.id: border for border in self.borders})
        return True, tuple(notes + doubts)

    def _forget_if_elsewhere(self, grid: GridMap) -> List[str]:
        """Without files borders cannot wait for their map to come back: another map begins with none."""
        if not self.borders or compatible(self.physical, grid):
            return []
        self._store = BorderStore()
        return ["this is another map: the borders of the one before are gone"]

    def _composed(
        self, composition: Composition, borders: Mapping[str, Optional[VirtualBorder]]
    ) -> Tuple[Composition, List[str]]:
        """A composition with some borders' regions, and without those that do not act; sentences about misfits."""
        regions: Dict[str, Optional[Region]] = {}
        notes: List[str] = []
        for key, border in borders.items():
            regions[key] = None
            if border is not None and self._acts(border):
                try:
                    regions[key] = Region.of(restricted_area(composition.physical, border, self.params))
                except IntegrationError as error:
                    notes.append(f"the border '{border.name}' does not fit the map and does not act: {error.message}")
        return composition.changed(regions), notes

    def _acts(self, border: VirtualBorder) -> bool:
        mine = not self.params.robot_name or not border.robots or self.params.robot_name in border.robots
        return border.enabled and mine

    # ------------------------------------------------------------- checks
    def check(
        self,
        border: VirtualBorder,
        places: Optional[Mapping[str, Sequence[float]]] = None,
        goals: Optional[Sequence[Sequence[float]]] = None,
    ) -> Check:
        """What adding a border, or replacing the one of the same id, would do; changes nothing.

        Args:
            places: positions [m] by name ("robot"); being inside is a warning.
            goals: (N, 2) [m], places whose reachability is asked about.

        Raises:
            CodedError: "no_map", or an IntegrationError with all findings.
        """
        before = self._ready()
        places = dict(places or {})
        if self.params.dock:
            places["dock"] = self.params.dock
        area = restricted_area(before.physical, border, self.params, places)
        after = before.changed({border.id: Region.of(area)})
        findings = list(area.findings)
        found: Optional[Ways] = None
        if goals is not None or self.params.check_ways:
            options = {
                "robot": places.get("robot"),
                "radius_m": self.params.robot_radius_m,
                "least_part_m2": self.params.least_part_m2,
                "occupied_from": self.params.occupied_from,
            }
            if self._parts is None:
                self._parts = ways(before.posterior, **options).free_parts
            found = ways(after.posterior, () if goals is None else goals, **options)
            if found.free_parts > self._parts:
                text = f"the free space would fall into {found.free_parts} parts, not {self._parts}"
                findings.append(Finding(WARNING, "splits_free_space", text))
            if found.free_parts == 0 and self._parts > 0:
                findings.append(Finding(WARNING, "nothing_left", "no free space would be left for the robot"))
        return Check(area, tuple(findings), found, after)

    # ------------------------------------------------------------- changes
    def add(self, border: VirtualBorder, now: float, places: Optional[Mapping[str, Sequence[float]]] = None) -> Outcome:
        """Adds a border; `now` is [s] ROS time. Raises CodedError if it is refused; then nothing changed."""
        check = self._checked(self._store.adding(border, now), places)
        new = self._store.borders[-1]
        return Outcome((new.id,), check.findings, f"'{new.name}' restricts {check.area.area_m2:.2f} m2")

    def update(
        self, border: VirtualBorder, now: float, places: Optional[Mapping[str, Sequence[float]]] = None
    ) -> Outcome:
        """Replaces the border of the same id; raises CodedError if it is refused; then nothing changed."""
        check = self._checked(self._store.updating(border, now), places)
        return Outcome((border.id,), check.findings, f"'{self._store.get(border.id).name}' was changed")

    def _checked(self, change: Change, places: Optional[Mapping[str, Sequence[float]]]) -> Check:
        """Makes the change of one border if the check allows it."""
        border = change[0].after
        assert border is not None
        check = self.check(border, places)
        if self._acts(border):
            self._commit(change, "new", check.composition)
            self._parts = check.ways.free_parts if check.ways else None
        else:
            self._commit(change, "new")
        return check

    def enable(self, border_id: str, enabled: bool, now: float, expires: float = 0.0) -> Outcome:
        """Turns a border on or off, for ever or until `expires` [s]; raises CodedError."""
        return self._plain(self._store.enabling(border_id, enabled, now, expires), "new", "changed")

    def remove(self, border_id: str) -> Outcome:
        """Removes a border; raises CodedError "unknown_border"."""
        return self._plain(self._store.removing(border_id), "new", "removed")

    def clear(self) -> Outcome:
        """Removes all borders; raises CodedError "nothing_to_clear"."""
        return self._plain(self._store.clearing(), "new", "removed")

    def undo(self) -> Outcome:
        """Takes the last change back; raises CodedError "nothing_to_undo"."""
        return self._plain(self._store.undoing(), "undo", "changed back")

    def redo(self) -> Outcome:
        """Makes again what was undone last; raises CodedError "nothing_to_redo"."""
        return self._plain(self._store.redoing(), "redo", "changed again")

    def expire(self, now: float) -> Optional[Outcome]:
        """Turns over the borders whose time has come; None if there are none."""
        change = self._store.expiring(now)
        # an expiry is no command: undo goes on to what a person did
        return self._plain(change, "quiet", "turned over, their time has come") if change else None

    def _plain(self, change: Change, kind: str, what: str) -> Outcome:
        notes = self._commit(change, kind)
        findings = tuple(Finding(WARNING, "does_not_act", note) for note in notes)
        names = ", ".join(f"'{(entry.after or entry.before).name}'" for entry in change)  # type: ignore[union-attr]
        return Outcome(tuple(entry.id for entry in change), findings, f"{what}: {names}")

    def _commit(self, change: Change, kind: str, composition: Optional[Composition] = None) -> List[str]:
        """Makes a change, all of it or, with a CodedError, nothing; gives sentences about borders that do not fit."""
        notes: List[str] = []
        if composition is None:
            composition, notes = self._composed(self._ready(), {entry.id: entry.after for entry in change})
        store = self._store.changed(change, kind)
        if self._folder is not None:
            self._folder.write(store, change, kind)
        self._store, self._composition, self._parts = store, composition, None
        return notes

    # ------------------------------------------------------------- files
    def save(self, folder: Path, name: str, raw: bool) -> List[Path]:
        """Writes the posterior as map_server files, and the borders as YAML beside it.

        Raises:
            CodedError: "bad_name", "no_map", "cannot_write".
        """
        stem = map_files.safe_path(folder, name)
        files = map_files.write_map(stem, self.posterior, raw)
        borders = Path(f"{stem}.borders.yaml")
        map_files.write_atomically(borders, borders_to_yaml(self.borders).encode())
        return files + [borders]
