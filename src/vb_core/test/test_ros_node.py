import gc
import inspect
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import pytest
import rospy

from vb_testing import assert_fields
from vb_core.errors import CodedError
from vb_core.ros import node
from vb_core.ros.node import Mailbox, Queue, WakeTimer


@pytest.mark.parametrize("size", [1, 2])
def test_the_newest_items_win_and_the_others_are_counted(size):
    added = []
    mailbox = Mailbox(lambda: added.append(1), size)
    for number in range(5):
        mailbox.put(number)
    assert len(added) == size
    assert [mailbox.get() for _ in added] == [3, 4][-size:]
    assert_fields(mailbox, received=5, dropped=5 - size)


def test_closing_a_mailbox_wakes_its_reader():
    mailbox = Mailbox()
    with ThreadPoolExecutor() as pool:
        reading = pool.submit(mailbox.get)
        mailbox.close()
        assert reading.result(10) is None


def test_a_source_can_wait_until_its_item_is_taken():
    mailbox = Mailbox()

    def fill():
        for number in range(50):
            mailbox.put(number)
            mailbox.wait_until_taken()

    with ThreadPoolExecutor() as pool:
        filling = pool.submit(fill)
        assert [mailbox.get() for _ in range(49)] == list(range(49))
        mailbox.close()
        filling.result(10)
    assert mailbox.dropped == 0


def test_a_queue_keeps_the_order_and_says_when_it_is_full():
    queue = Queue(2)
    assert [queue.put(number) for number in range(3)] == [True, True, False]
    assert [queue.get(), queue.get()] == [0, 1]
    assert queue.put(7)
    queue.close()
    # an accepted item is still handled
    assert [queue.get(), queue.get()] == [7, None]


def test_a_timer_wakes_after_its_period_or_an_announcement():
    assert WakeTimer(0.001).get() is False
    timer = WakeTimer(3600.0)
    timer.notify()
    assert timer.get() is True
    timer.close()
    assert timer.get() is None


class FakeClock:
    """Wall time that advances only while the timer waits, and simulated time that runs `pace` times as fast."""

    def __init__(self, monkeypatch, timer, pace):
        self.wall, self.pace, self.waits = 50.0, pace, 0
        monkeypatch.setattr(rospy.rostime, "is_wallclock", lambda: False)
        monkeypatch.setattr(rospy, "get_time", lambda: 1000.0 + self.pace * (self.wall - 50.0))
        monkeypatch.setattr(node.time, "monotonic", lambda: self.wall)
        monkeypatch.setattr(timer, "_wake", self)

    def wait(self, seconds):
        self.waits += 1
        self.wall += seconds
        return False


@pytest.mark.parametrize("pace, expected", [(4.0, 0.25), (1.0, 1.0), (0.5, 1.0), (0.0, 1.0)])
def test_a_timer_follows_the_faster_clock(monkeypatch, pace, expected):
    timer = WakeTimer(1.0)
    clock = FakeClock(monkeypatch, timer, pace)
    assert timer.get() is False  # the timer learns how fast simulated time runs
    began = clock.wall
    clock.waits = 0
    assert [timer.get() for _ in range(20)] == [False] * 20
    assert clock.wall - began == pytest.approx(20 * expected, abs=0.1)
    assert clock.waits <= 2 * 20 + 5, "it sleeps and does not poll"


@pytest.fixture
def logged(monkeypatch):
    """Returns what a node in this process logs; its failures and its end are forgotten after the test."""
    lines = []
    for log in ("logwarn", "logfatal"):
        monkeypatch.setattr(rospy, log, lambda text, *values: lines.append(text % values))
    monkeypatch.setattr(rospy, "logwarn_throttle", lambda _period, text: lines.append(text))
    monkeypatch.setattr(rospy, "signal_shutdown", lines.append)
    monkeypatch.setattr(node, "_failures", [])
    return lines


@pytest.mark.parametrize("is_ending, fault", [(True, ZeroDivisionError), (False, rospy.ROSException)])
def test_a_fault_in_a_worker_ends_the_node(monkeypatch, logged, is_ending, fault):
    ended = threading.Event()
    raised = []
    monkeypatch.setattr(threading, "excepthook", lambda caught: raised.append(caught.exc_type) or ended.set())
    monkeypatch.setattr(rospy, "is_shutdown", lambda: is_ending)

    def handle(error):
        raise error

    waiting = Queue()
    node.Worker(waiting, handle)
    for error in (CodedError("no_map"), rospy.ROSException("a closed topic"), ZeroDivisionError()):
        waiting.put(error)
    assert ended.wait(30)
    assert raised == [fault], "a CodedError is survived, and at the end a topic that has closed"
    assert logged[-1] == "internal_error"


def test_a_waiting_node_logs_why_and_gives_up(monkeypatch, logged):
    monkeypatch.setattr(node, "LOG_DELAY", 0.05)
    looks = iter([False] * 10 + [True])
    node._await("the postman", lambda: next(looks), 60.0)
    assert {line.split(" ", 1)[1] for line in logged} == {"waits for the postman"}
    node._await("godot", lambda: False, 0.3)
    assert logged[-1] == "input_timeout"
    assert [error.code for error in node._failures] == ["input_timeout"]


def test_logging_while_ending_does_not_end_the_successor(monkeypatch):
    # rospy registered the node with each logged line, whereupon the master shut down the newer node of the same name
    registered = []
    master = SimpleNamespace(subscribeParam=lambda *names: registered.append(names) or (1, "", {}))
    proxy = rospy.msproxy.MasterProxy.__new__(rospy.msproxy.MasterProxy)
    proxy.target = master
    monkeypatch.setattr(rospy, "get_param", lambda name, default=None: default)
    monkeypatch.setattr(rospy.client, "_init_param_server", lambda: None)
    monkeypatch.setattr(rospy.client, "_param_server", proxy)
    monkeypatch.setattr(rospy.impl.paramserver, "_param_server_cache", None)
    rospy.client.get_param_cached("/rosout_disable_topics_generation", False)
    assert len(registered) == 1
    node._log_without_registering()
    assert rospy.client.get_param_cached("/rosout_disable_topics_generation", False) is False
    assert len(registered) == 1


class Lamp:
    """Switches a lamp.

    Subscribes:
        /lamp/wanted
    """


def build() -> "Lamp":
    raise AssertionError("it must not be started")


def test_help_prints_the_interface_without_a_ros_master(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["lamp", "--help"])
    monkeypatch.setenv("ROS_MASTER_URI", "http://127.0.0.1:1")
    node.run_node("lamp", build)
    assert capsys.readouterr().out == f"lamp\n\n{inspect.getdoc(Lamp)}\n"


def test_objects_made_at_start_are_not_searched_for_garbage():
    lists = [[number] for number in range(1000)]
    node._freeze_startup_objects()
    try:
        assert set(map(id, gc.get_objects())).isdisjoint(map(id, lists))
    finally:
        gc.unfreeze()
