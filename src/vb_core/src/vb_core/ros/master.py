"""Asks a ROS master which nodes run, and which of them could command a robot's base."""

from __future__ import annotations

from typing import Optional, Set, Tuple

import rosgraph
import rospy

from vb_core.node_graph import NodeGraph
from vb_core.robot_profile import Base
from vb_core.ros.node import has_exited


def read_graph(master: Optional[rosgraph.Master] = None) -> NodeGraph:
    """Reads the graph of a master, by default this node's. Raises rosgraph.MasterException or OSError without an answer."""
    master = master or rosgraph.Master(rospy.get_name())
    return NodeGraph(*master.getSystemState(), dict(master.getTopicTypes()))


def find_commanders(driver: str, base: Base) -> Tuple[Set[str], Set[str], bool]:
    """Finds who can command a base. `driver` is the driver node's full name, in the robot's namespace.

    Returns:
        The running nodes that can command the base past the driver; the driver, its muxes and trusted nodes, which may; and
        whether any node subscribes to the driver's commands.

    Raises:
        rosgraph.MasterException, OSError: if the master does not answer.
    """
    namespace = driver.rpartition("/")[0] + "/"
    relative_names = (base.topic, base.output, *base.trusted)
    topic, output, *trusted = [name and rosgraph.names.ns_join(namespace, name) for name in relative_names]
    master = rosgraph.Master(driver)
    graph = read_graph(master)
    other_commanders, muxes = graph.find_other_commanders(driver, topic, output)
    other_commanders = {name for name in other_commanders - set(trusted) if not has_exited(master, name)}
    return other_commanders, {driver, *muxes, *trusted}, graph.has_subscriber(driver, topic)
