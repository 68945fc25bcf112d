"""What the node tests share: a map server, and borders."""

from __future__ import annotations

import numpy as np
import rospy
from geometry_msgs.msg import Point
from vb_core.grid_map import GridMap
from vb_core.ros.messages import OccupancyGridArray, message_from_grid
from vb_msgs.msg import VirtualBorder


def lab(width=160, height=100):
    """An 8 m x 5 m room at (-4, -2) with a wall of unknown cells in it."""
    data = np.zeros((height, width), np.int8)
    data[[0, -1]] = 100
    data[:, [0, -1]] = 100
    data[60:70, 20:30] = -1
    return GridMap(data, 0.05, (-4.0, -2.0, 0.0))


class MapServer:
    """Latches a map on /map."""

    def __init__(self, grid):
        self.publisher = rospy.Publisher("/map", OccupancyGridArray, queue_size=1, latch=True)
        self.publish(grid)

    def publish(self, grid):
        self.grid = grid
        self.publisher.publish(message_from_grid(grid, rospy.Time.now()))


def polygon(x=0.0, y=0.0, size=1.0, **fields):
    """A square to be restricted inside."""
    corners = [(x, y), (x + size, y), (x + size, y + size), (x, y + size)]
    return VirtualBorder(
        points=[Point(*corner, 0.0) for corner in corners],
        enabled=True,
        seed=Point(x + size / 2, y + size / 2, 0.0),
        **{"kind": VirtualBorder.POLYGON, "occupancy": 1.0, **fields},
    )
