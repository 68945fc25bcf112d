"""Locks, time and modules of nodes that run in one process."""

from unittest.mock import Mock

import pytest
import rospy
from geometry_msgs.msg import Twist

from vb_core.ros import node
from vb_core.ros.master import read_graph
from vb_sim.in_process_ros.rospy_stand_in import Graph, Node
from vb_sim.in_process_ros.threading_stand_in import Lock, Scheduler, StandIns

SECOND = 10**9


def test_a_lock_goes_to_the_one_that_still_waits():
    said = []
    scheduler = Scheduler(0)
    lock = Lock(scheduler)

    def holder():
        with lock:
            scheduler.wait(3 * SECOND)

    def impatient():
        said.append(("impatient", lock.acquire(timeout=1.0)))
        # releasing the lock must not end this wait
        said.append(("woken", scheduler.wait(5 * SECOND)))

    def patient():
        with lock:
            said.append(("patient", scheduler.now_ns))

    for work in (holder, impatient, patient):
        scheduler.spawn(work)
    scheduler.run(lambda: False, 20 * SECOND)
    assert said == [("impatient", False), ("patient", 3 * SECOND), ("woken", False)]


def test_an_interruption_is_no_fault_of_a_node():
    scheduler = Scheduler(SECOND)
    graph = Graph(scheduler, {})
    with pytest.raises(KeyboardInterrupt), graph.installed():
        graph.start(Node("/a_node", {}), lambda: node.start_thread(Mock(side_effect=KeyboardInterrupt)))
        scheduler.run(lambda: False, 20 * SECOND)


def test_objects_of_an_earlier_run_raise():
    before = Scheduler(0)
    queue = StandIns(before).modules["queue"].Queue()
    before.close()
    after = Scheduler(0)
    after.spawn(lambda: queue.get(timeout=1.0))
    with pytest.raises(RuntimeError, match="earlier run"):
        after.run(lambda: False, 20 * SECOND)


def test_a_node_sees_the_graph_it_is_in_and_no_other():
    """This also holds where no ROS master runs, or that of another graph."""
    graphs = []
    scheduler = Scheduler(0)
    graph = Graph(scheduler, {})

    def driver():
        rospy.init_node("driver")
        rospy.Publisher("cmd_vel", Twist, queue_size=1)
        scheduler.wait(SECOND)
        graphs.append(read_graph())

    def base():
        rospy.init_node("base")
        rospy.Subscriber("cmd_vel", Twist, lambda _: None)
        scheduler.wait(2 * SECOND)

    with graph.installed():
        graph.start(Node("/driver", {}), driver)
        graph.start(Node("/base", {}), base)
        scheduler.run(lambda: bool(graphs), 5 * SECOND)
    (state,) = graphs
    assert dict(state.publishers) == {"/cmd_vel": ["/driver"]}
    assert dict(state.subscribers) == {"/cmd_vel": ["/base"]}
    assert state.types == {"/cmd_vel": "geometry_msgs/Twist"}
