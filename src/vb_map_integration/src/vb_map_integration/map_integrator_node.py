"""Node: integrates virtual borders into the map that navigation uses."""

from __future__ import annotations

import itertools
import threading
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Callable, List, Tuple

import numpy as np
import rospy
from std_srvs.srv import Trigger, TriggerResponse
from vb_msgs import srv
from vb_msgs.msg import VirtualBorderArray

from vb_core import names
from vb_core.errors import CodedError, ParameterError
from vb_core.navigation_parameters import is_trinary
from vb_core.notices import Notice, Severity
from vb_core.parameters import Parameters, param
from vb_core.ros import messages, node, parameters, robot_profile
from vb_core.ros.notices import NoticePublisher
from vb_core.ros.preview_service import NumpyPreviewBorder, NumpyPreviewBorderResponse
from vb_core.ros.transforms import TransformLookup
from vb_map_integration.border import IntegrationError, VirtualBorder, warning
from vb_map_integration.border_messages import border_from_message, message_from_border, messages_from_issues
from vb_map_integration.map_integrator import ChangeResult, MapIntegrator


@dataclass(frozen=True)
class MapIntegratorParams(Parameters):
    """The node's parameters."""

    database_dir: str = param("~/.ros/virtual_borders")
    map_dir: str = param("~/.ros/virtual_borders/maps")
    map_name: str = param("")
    robots: list = param([])
    robot_frames: str = param("")
    robot_radius: float = param(0.18, "m", low=0.0)


class MapIntegratorNode:
    """Integrates virtual borders into the physical map.

    Subscribed topics:
        /map (nav_msgs/OccupancyGrid): the physical map.
    Published topics, latched, with the same stamp for the same state:
        /virtual_borders/borders (vb_msgs/VirtualBorderArray): all borders of the current map; with every change.
        /virtual_borders/map (nav_msgs/OccupancyGrid): the physical map with all borders in force; as soon as there is
            a map, and in full with every change.
        /<robot>/virtual_borders/map (nav_msgs/OccupancyGrid): the same, with only the borders for one of ~robots.
        /virtual_borders/speed_limits (nav_msgs/OccupancyGrid): speed limits of slow zones [cm/s], whichever robots
            they name, 0: no limit; with every change once there has been a slow zone.
    Published topics:
        /virtual_borders/notices (vb_msgs/NoticeArray): what is wrong with map, borders or files.
    Services (a request that fails answers with code and message, and changes nothing):
        /virtual_borders/add_border (vb_msgs/AddBorder)
        /virtual_borders/update_border (vb_msgs/UpdateBorder)
        /virtual_borders/remove_border (vb_msgs/RemoveBorder)
        /virtual_borders/preview_border (vb_msgs/PreviewBorder)
        /virtual_borders/list_borders (vb_msgs/ListBorders)
        /virtual_borders/set_border_enabled (vb_msgs/SetBorderEnabled): also for a border that does not fit the map.
        /virtual_borders/rename_border (vb_msgs/RenameBorder): likewise.
        /virtual_borders/confirm_map (vb_msgs/ConfirmMap): says which place the current map shows.
        /virtual_borders/undo_redo (vb_msgs/UndoRedo): carried out once per request_id, however often it is sent.
        /virtual_borders/undo, /virtual_borders/redo (std_srvs/Trigger): the same for other programs.
        /virtual_borders/save_map (vb_msgs/SaveMap): writes map_server files, and the borders as GeoJSON beside them.
    Parameters:
        config/map_integrator.yaml
    """

    def __init__(self, params: MapIntegratorParams) -> None:
        self._params = params
        self._map_dir = Path(params.map_dir).expanduser()
        if rospy.resolve_name(names.PHYSICAL_MAP) == rospy.resolve_name(names.MAP_WITH_BORDERS):
            raise ParameterError(names.MAP_WITH_BORDERS, "the physical and the virtual map need different topics")
        root = Path(params.database_dir).expanduser() if params.database_dir else None
        robots = [str(name) for name in params.robots]
        radius = max(robot_profile.read_radius(name, params.robot_radius) for name in robots or [""])
        self._integrator = MapIntegrator(root, params.map_name, robots, radius)
        self._lock = threading.RLock()
        self._notices = NoticePublisher()
        self._map_notices: List[Notice] = []  # about the last map, if it was refused
        self._show_notices()
        self._last_stamp = rospy.Time(0)
        self._transforms = TransformLookup() if params.robot_frames else None

        latched = partial(rospy.Publisher, data_class=messages.NumpyOccupancyGrid, queue_size=1, latch=True)
        self._map_out = latched(names.MAP_WITH_BORDERS)
        self._robot_maps = {name: latched(f"/{name}{names.MAP_WITH_BORDERS}") for name in robots}
        self._speeds_out = latched(names.SPEED_LIMITS)
        self._had_speeds = False
        self._borders_out = rospy.Publisher(names.BORDERS, VirtualBorderArray, queue_size=1, latch=True)
        rospy.Service(names.PREVIEW_BORDER, NumpyPreviewBorder, self._preview)
        rospy.Service(names.ADD_BORDER, srv.AddBorder, self._add)
        rospy.Service(names.UPDATE_BORDER, srv.UpdateBorder, self._update)
        rospy.Service(names.REMOVE_BORDER, srv.RemoveBorder, self._remove)
        rospy.Service(names.SET_BORDER_ENABLED, srv.SetBorderEnabled, self._set_enabled)
        rospy.Service(names.RENAME_BORDER, srv.RenameBorder, self._rename)
        rospy.Service(names.CONFIRM_MAP, srv.ConfirmMap, self._confirm)
        rospy.Service(names.UNDO_REDO, srv.UndoRedo, self._undo_or_redo)
        rospy.Service(names.UNDO, Trigger, lambda _: self._trigger(redo=False))
        rospy.Service(names.REDO, Trigger, lambda _: self._trigger(redo=True))
        rospy.Service(names.LIST_BORDERS, srv.ListBorders, self._list)
        rospy.Service(names.SAVE_MAP, srv.SaveMap, self._save)
        self._maps: node.Mailbox = node.Mailbox()
        node.Worker(self._maps, self._on_map)
        options = {"queue_size": 1, "buff_size": 2**24, "tcp_nodelay": True}
        rospy.Subscriber(names.PHYSICAL_MAP, messages.NumpyOccupancyGrid, self._maps.put, **options)
        node.log_missing_input(f"the map on {names.PHYSICAL_MAP}", lambda: self._integrator.has_map)

    def close(self) -> None:
        """Ends the worker, and releases the database."""
        self._maps.close()
        with self._lock:
            self._integrator.close()

    # ------------------------------------------------------------- the physical map
    def _on_map(self, message: Any) -> None:
        frame = message.header.frame_id.lstrip("/")
        try:
            if frame and frame != names.MAP_FRAME:
                raise CodedError("map_wrong_frame", topic=names.PHYSICAL_MAP, frame=frame, expected=names.MAP_FRAME)
            grid = messages.grid_from_message(message)
            self._map_notices = []
        except CodedError as error:
            self._map_notices = [Notice.from_error(error, Severity.ERROR)]
            self._show_notices()
            return
        with self._lock:
            if not self._integrator.set_map(grid):
                self._show_notices()  # the last map may have been refused
                return
            size = " x ".join(map(str, grid.shape))
            rospy.loginfo("%s: a map of %s cells, %d border(s)", rospy.get_name(), size, len(self._integrator.borders))
            self._publish()

    # ------------------------------------------------------------- one border
    def _preview(self, request: Any) -> Any:
        """Checks a border as `_add` does, and changes nothing."""
        response = NumpyPreviewBorderResponse()
        response.region.data = np.zeros(0, np.int8)
        try:
            border = self._read_border(request)
            with self._lock:
                check = self._integrator.check(border, self._robot_positions(border))
        except CodedError as error:
            return self._refuse(response, error)
        region = check.region
        preview = region.prior.with_data(np.where(region.restricted_cells, np.int8(100), np.int8(0)))
        response.region = messages.message_from_grid(preview, rospy.Time.now(), names.MAP_FRAME)
        response.area_m2 = region.area_m2
        response.line = messages.points_from_array(region.line)
        response.free_parts = check.free_parts
        response.success, response.code = True, "ok"
        response.issues = messages_from_issues((*check.issues, *self._warn_if_soft_cost_is_ignored(border)))
        return response

    def _add(self, request: srv.AddBorderRequest) -> srv.AddBorderResponse:
        add = partial(self._integrator.add, request_id=request.request_id)
        return self._store_drawn(request, add, srv.AddBorderResponse(), enabled=not request.disabled)

    def _update(self, request: srv.UpdateBorderRequest) -> srv.UpdateBorderResponse:
        return self._store_drawn(request, self._integrator.update, srv.UpdateBorderResponse())

    def _store_drawn(self, request: Any, store: Callable[..., ChangeResult], response: Any, **changes: Any) -> Any:
        """Carries out a request to add or update a border, whose fields `changes` replaces."""

        def store_border() -> ChangeResult:
            border = self._read_border(request).replace(**changes)
            robots = self._robot_positions(border)
            result = store(border, rospy.get_time(), robots, request.expected_revision)
            return ChangeResult(result.ids, result.issues + self._warn_if_soft_cost_is_ignored(border))

        return self._carry_out(store_border, response)

    def _read_border(self, request: Any) -> VirtualBorder:
        """Reads the border of a request to preview, add or update one; raises IntegrationError if it is invalid."""
        frame = request.frame_id.lstrip("/")
        if frame and frame != names.MAP_FRAME:
            raise IntegrationError("unknown_frame", frame=frame, expected=names.MAP_FRAME)
        return border_from_message(request.border)

    def _robot_positions(self, border: VirtualBorder) -> List[Tuple[float, float]]:
        """Returns the positions (x, y) [m] of the robots that a border applies to."""
        positions = []
        for frame, name in itertools.zip_longest(self._params.robot_frames.split(), self._robot_maps):
            is_for_others = border.robots and name and name not in border.robots
            if self._transforms is None or frame is None or is_for_others:
                continue
            try:
                pose = self._transforms.lookup(names.MAP_FRAME, frame, rospy.Time(0), 0.0)
            except CodedError:
                continue  # positions only serve for a warning
            positions.append((float(pose[0, 3]), float(pose[1, 3])))
        return positions

    def _warn_if_soft_cost_is_ignored(self, border: VirtualBorder) -> Tuple[Notice, ...]:
        """Warns if a running move_base treats every soft value as free (its default, trinary_costmap)."""
        if border.cell_value in (0, 100):
            return ()
        bases = [f"/{name}/move_base" for name in self._robot_maps] or ["/move_base"]
        costmaps = [f"{base}/{which}_costmap" for base in bases for which in ("global", "local")]
        trinary = [name for name in costmaps if is_trinary(rospy.get_param(name, None))]
        return (warning("soft_border_ignored", costmaps=", ".join(trinary)),) if trinary else ()

    # ------------------------------------------------------------- other changes
    def _remove(self, request: srv.RemoveBorderRequest) -> srv.RemoveBorderResponse:
        remove = partial(self._integrator.remove, request.id, request.expected_revision)
        return self._carry_out(remove, srv.RemoveBorderResponse())

    def _set_enabled(self, request: srv.SetBorderEnabledRequest) -> srv.SetBorderEnabledResponse:
        arguments = request.id, request.enabled, rospy.get_time(), request.expected_revision
        return self._carry_out(partial(self._integrator.set_enabled, *arguments), srv.SetBorderEnabledResponse())

    def _rename(self, request: srv.RenameBorderRequest) -> srv.RenameBorderResponse:
        arguments = request.id, request.name, rospy.get_time(), request.expected_revision
        return self._carry_out(partial(self._integrator.rename, *arguments), srv.RenameBorderResponse())

    def _confirm(self, request: srv.ConfirmMapRequest) -> srv.ConfirmMapResponse:
        is_same_place = request.answer == srv.ConfirmMapRequest.SAME_PLACE
        confirm = partial(self._integrator.confirm, is_same_place, request.name, request.map_id)
        return self._carry_out(confirm, srv.ConfirmMapResponse())

    def _undo_or_redo(self, request: srv.UndoRedoRequest) -> srv.UndoRedoResponse:
        step = self._integrator.redo if request.redo else self._integrator.undo
        return self._carry_out(partial(step, request.request_id), srv.UndoRedoResponse())

    def _trigger(self, redo: bool) -> TriggerResponse:
        answer = self._undo_or_redo(srv.UndoRedoRequest(redo=redo))
        return TriggerResponse(answer.success, answer.message or answer.code)

    def _carry_out(self, command: Callable[[], ChangeResult], response: Any) -> Any:
        """Carries out a command, publishes the map, and fills in the response. A refusal publishes nothing."""
        try:
            with self._lock:
                result = command()
                self._publish()
                revision = self._integrator.revision
        except CodedError as error:
            return self._refuse(response, error)
        for issue in result.issues:
            rospy.logwarn("%s: %s [%s]", rospy.get_name(), issue.message, issue.code)
        rospy.loginfo("%s: changed: %s", rospy.get_name(), ", ".join(result.ids) or "the map's place")
        issues = messages_from_issues(result.issues)
        changed_id = next(iter(result.ids), "")
        return _set_fields(response, success=True, code="ok", id=changed_id, issues=issues, revision=revision)

    def _refuse(self, response: Any, error: CodedError) -> Any:
        """Fills in the response to a refused request, with the warnings found before, and logs it."""
        rospy.logwarn("%s: refused: %s", rospy.get_name(), error)
        issues = [*getattr(error, "warnings", ()), Notice.from_error(error, Severity.ERROR)]
        return _set_fields(
            response,
            success=False,
            code=error.code,
            message=error.message,
            values=messages.values_from_mapping(error.values),
            revision=self._integrator.revision,
            issues=messages_from_issues(issues),
        )

    # ------------------------------------------------------------- what is published
    def _publish(self) -> None:
        stamp = self._last_stamp = next_stamp(rospy.Time.now(), self._last_stamp)
        self._show_notices()
        self._borders_out.publish(self._borders_message(stamp))
        in_force = self._integrator.borders_in_force
        grids = [(self._map_out, in_force.map_with_borders)]
        grids += [(out, self._integrator.map_with_borders_for(name)) for name, out in self._robot_maps.items()]
        self._had_speeds |= bool(in_force.slow_zones)
        if self._had_speeds:
            grids.append((self._speeds_out, in_force.speed_limits))
        for out, grid in grids:
            out.publish(messages.message_from_grid(grid, stamp, names.MAP_FRAME))

    def _borders_message(self, stamp: rospy.Time) -> VirtualBorderArray:
        array = VirtualBorderArray()
        array.header.stamp, array.header.frame_id = stamp, names.MAP_FRAME
        array.revision = self._integrator.revision
        array.map_id, array.map_name = self._integrator.map_id, self._integrator.map_name
        array.needs_confirmation = self._integrator.needs_confirmation
        array.available_commands = self._integrator.available_commands
        array.code, array.message = "ok", ""
        about_all = [notice for notice in self._integrator.notices if not notice.border_id]
        if about_all:
            asks = ("borders_unconfirmed", "borders_to_confirm")
            worst = max(about_all, key=lambda notice: (notice.code in asks, notice.severity))
            array.code, array.message = worst.code, worst.sentence()
            array.values = messages.values_from_mapping(worst.values)
        in_force = self._integrator.borders_in_force
        for key, status in in_force.statuses.items():
            outlines = in_force.outlines(key)
            border = message_from_border(status.map_border, status.area_m2, status.is_in_force, status.reason, outlines)
            array.borders.append(border)
        return array

    def _show_notices(self) -> None:
        with self._lock:
            self._notices.set([*self._map_notices, *self._integrator.notices])

    # ------------------------------------------------------------- lists and files
    def _list(self, _request: Any) -> srv.ListBordersResponse:
        with self._lock:
            if not self._integrator.has_map:
                return srv.ListBordersResponse()
            return srv.ListBordersResponse(self._borders_message(rospy.Time.now()))

    def _save(self, request: Any) -> srv.SaveMapResponse:
        response = srv.SaveMapResponse()
        name = request.name or f"map-{rospy.Time.now().to_nsec() // 10**6}"
        try:
            with self._lock:
                response.files = [str(path) for path in self._integrator.save(self._map_dir, name, request.raw)]
        except CodedError as error:
            return self._refuse(response, error)
        response.success, response.code = True, "ok"
        return response


def next_stamp(now: rospy.Time, last: rospy.Time) -> rospy.Time:
    """Returns a timestamp that no earlier state had: in simulated time several changes may fall into one tick."""
    is_usable = not rospy.Duration(0) <= last - now < rospy.Duration(1)  # it is later, or the clock was set back
    return now if is_usable else last + rospy.Duration(0, 1000)


def _set_fields(response: Any, **values: Any) -> Any:
    """Sets the given fields, as far as the response has them, and returns the response."""
    for key, value in values.items():
        if hasattr(response, key):
            setattr(response, key, value)
    return response


def build() -> MapIntegratorNode:
    """Reads the parameters and makes the node."""
    return MapIntegratorNode(parameters.read(MapIntegratorParams))
