"""Serves the physical map, from a file in map_server's format or from a world of the simulator."""

from __future__ import annotations

from dataclasses import dataclass

import rospy
from nav_msgs.srv import GetMap, GetMapResponse

from vb_core import names
from vb_core.errors import ParameterError
from vb_core.grid_map import GridMap
from vb_core.map_files import path_from_caller, read_map
from vb_core.parameters import Parameters, param
from vb_core.ros import messages, parameters
from vb_sim.floor_plan import physical_map
from vb_sim.world import load_world


@dataclass(frozen=True)
class MapServerParams(Parameters):
    """The map's file. Exactly one of the two must be set."""

    world: str = param("")
    map_yaml: str = param("")


class MapServerNode:
    """Publishes a map that never changes.

    Published topics:
        /map (nav_msgs/OccupancyGrid, latched)
    Services:
        /static_map (nav_msgs/GetMap)
    Parameters:
        config/map_server.yaml: a relative ~map_yaml is relative to the folder in which roslaunch was called
    """

    def __init__(self, grid: GridMap) -> None:
        # the stamp is zero, because simulated time is not known yet and the map is valid at any time
        self._message = messages.message_from_grid(grid, rospy.Time(0))
        self._publisher = rospy.Publisher(names.PHYSICAL_MAP, messages.NumpyOccupancyGrid, queue_size=1, latch=True)
        self._service = rospy.Service("/static_map", GetMap, self._on_static_map)
        self._publisher.publish(self._message)
        rospy.loginfo("%s: a map of %d x %d cells", rospy.get_name(), grid.shape[1], grid.shape[0])

    def _on_static_map(self, _request: GetMap) -> GetMapResponse:
        # services serialise the plain message, which needs a list
        plain = GetMapResponse()
        plain.map.header, plain.map.info = self._message.header, self._message.info
        plain.map.data = self._message.data.tolist()
        return plain


def build() -> MapServerNode:
    """Reads the parameters and constructs the node."""
    params = parameters.read(MapServerParams)
    if bool(params.world) == bool(params.map_yaml):
        raise ParameterError(rospy.resolve_name("~world"), "either this or map_yaml must be set")
    file = params.map_yaml
    return MapServerNode(read_map(path_from_caller(file)) if file else physical_map(load_world(params.world)))
