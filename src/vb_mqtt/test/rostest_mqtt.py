#!/usr/bin/env python3
"""The smart home's hub over a real roscore and a real broker, with the real nodes of map, borders and interaction.

VB_BROKER_KILLS=50 scripts/test --only rostest mqtt     kills the broker 50 times instead of 3
"""

import collections
import os
import random
import sys
import tempfile
import time
import unittest

import cv2
import numpy as np
import rospy
import rostest
from geometry_msgs.msg import Point

from mosquitto import Hub, Mosquitto
from vb_testing import TIMEOUT, Process, assert_fields, listen, wait_until
from vb_core import names
from vb_core.notices import Notice, Severity
from vb_core.ros.notices import NoticePublisher
from vb_mqtt.incoming_requests import MAX_AGE
from vb_msgs.msg import BorderPreview, BorderProgress, InteractionState, Stop, VirtualBorder, VirtualBorderArray
from vb_msgs.srv import AddBorder, Command, CommandResponse, GetDrawnBorder, GetDrawnBorderResponse, RemoveBorder

KILLS = int(os.environ.get("VB_BROKER_KILLS", "3"))
SEED = int(os.environ.get("VB_BROKER_SEED", "1"))
CARPET = [Point(x, y, 0.0) for x, y in ((3.12, 0.8), (5.12, 0.8), (5.12, 2.05), (3.12, 2.05))]
MIDDLE = Point(4.0, 1.4, 0.0)


def start(port, device, *remaps):
    """Starts the node in a process of its own, so that a test can kill it."""
    broker = (f"_broker:=127.0.0.1:{port}", f"_device:={device}", "_connection_file:=/none")
    return Process("vb_mqtt", "mqtt", f"__name:=mqtt_{device}", *broker, "_cameras:=[red]", *remaps)


class CommandLog:
    """Gives commands through a hub, and stands in for the manager that carries them out: notes both times by id."""

    def __init__(self, hub):
        self._hub = hub
        self.given_times = {}
        self.stops_given = 0
        self.done_times = collections.defaultdict(list)
        self.stop_times = collections.defaultdict(list)
        self.service = rospy.Service("/kills/command", Command, self._on_command)

    def give(self, command):
        self.stops_given += command == "stop"
        identity = f"k{len(self.given_times)}"
        self.given_times[identity] = time.time()
        self._hub.send("kills/command", {"command": command, "at": self.given_times[identity], "id": identity})
        return identity

    def _on_command(self, request):
        times = self.stop_times if request.command == "stop" else self.done_times
        times[request.id.partition(":")[2]].append(time.time())
        return CommandResponse(success=True, code="ok")


class MqttTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node("rostest_mqtt")
        kinds = {names.STATE: InteractionState, names.BORDERS: VirtualBorderArray, names.STOP: Stop}
        cls.heard = listen({**kinds, names.PREVIEW: BorderPreview})
        cls.progress = rospy.Publisher(names.PROGRESS, BorderProgress, queue_size=1)
        cls.drawn = rospy.Service(names.GET_DRAWN_BORDER, GetDrawnBorder, cls.on_drawn)
        cls.server = Mosquitto(tempfile.mkdtemp(prefix="vb_mqtt_"))
        cls.addClassCleanup(cls.server.kill)
        cls.hub = Hub(cls.server.port)
        cls.addClassCleanup(cls.hub.close)
        cls.node = start(cls.server.port, "home")
        cls.addClassCleanup(lambda: cls.node.stop())
        rospy.wait_for_service(names.COMMAND, 60)

    @staticmethod
    def on_drawn(_request):
        border = VirtualBorder(kind=VirtualBorder.POLYGON, points=CARPET, seed=MIDDLE)
        return GetDrawnBorderResponse(success=True, code="ok", border=border)

    def setUp(self):
        self.hub.wait("home/health", lambda health: health["manager"] == health["integrator"] == "online", "all nodes")
        if self.shown("stopped")["stopped"]:
            number = self.heard[names.STATE].stop_number
            wait_until(lambda: self.is_done("resume", seen_stop=number), "robots that may drive")
            self.wait("stopped", lambda value: not value["stopped"], "robots that may drive")
        wait_until(lambda: self.is_done("cancel"), "an end")
        self.wait("state", lambda value: value["state"] == "default", "the default state")

    # ------------------------------------------------------------------ as a hub
    def shown(self, key):
        return self.hub.value(f"home/{key}")

    def wait(self, key, condition, awaited, timeout=TIMEOUT):
        return self.hub.wait(f"home/{key}", condition, awaited, timeout)

    def send(self, timeout=TIMEOUT, **fields):
        """Sends a message and waits for its answer."""
        fields = {"at": time.time(), "id": f"{random.getrandbits(64):x}", **fields}
        self.hub.send("home/command", fields)
        return self.wait("answer", lambda answer: answer["id"] == fields["id"], f"an answer to {fields}", timeout)

    def give(self, command, **fields):
        return self.send(command=command, **fields)

    def is_done(self, command, **fields):
        """Gives a command and waits a second for success; in a flood a command may get no answer."""
        try:
            return self.give(command, timeout=1.0, **fields)["event_type"] == "done"
        except AssertionError:
            return False

    def add_border(self, name):
        border = VirtualBorder(name=name, kind=VirtualBorder.POLYGON, points=CARPET, seed=MIDDLE, occupancy=1.0)
        return rospy.ServiceProxy(names.ADD_BORDER, AddBorder)(border=border, source="test").id

    def remove_border(self, identity):
        self.assertTrue(rospy.ServiceProxy(names.REMOVE_BORDER, RemoveBorder)(id=identity, source="test").success)

    # ------------------------------------------------------------------ what is shown
    def test_the_hub_shows_a_border_and_the_map(self):
        identity = self.add_border("Nursery")
        key = f"border_{identity}"
        config = self.hub.wait(f"homeassistant/switch/home/{key}/config", lambda _: True, "the switch")
        self.assertEqual(config["name"], "Nursery")
        border = self.wait(key, lambda value: value["in_force"], "the border's state")
        assert_fields(border, enabled=True, border="Nursery")
        self.assertAlmostEqual(border["area_m2"], 2.5, delta=0.2)
        self.assertEqual(self.hub.messages["home/availability"], b"online")
        self.assertTrue(self.shown("camera_red")["problem"])  # no detector is running

        def red():
            picture = cv2.imdecode(np.frombuffer(self.hub.messages.get("home/map", b"0"), np.uint8), cv2.IMREAD_COLOR)
            return picture is not None and int(((picture[..., 2] > 180) & (picture[..., 0] < 100)).sum())

        with_border = wait_until(red, "a picture with the border")
        self.remove_border(identity)
        wait_until(lambda: red() is not None and red() < with_border / 2, "a picture without the border")
        wait_until(lambda: not self.hub.messages.get(f"homeassistant/switch/home/{key}/config"), "the switch to go")
        wait_until(lambda: not self.hub.messages.get(f"home/{key}"), "its state to go")

    def test_a_border_is_switched_off_and_on(self):
        identity = self.add_border("Nursery")
        key = f"border_{identity}"
        self.wait(key, lambda value: value["enabled"], "the border")
        for enabled, text in ((False, "Nursery was switched off."), (True, "Nursery was switched on.")):
            answer = self.send(border=key, enabled=enabled)
            assert_fields(answer, event_type="done", text=text)
            self.wait(key, lambda value: value["enabled"] is enabled, f"enabled: {enabled}")
        self.assertEqual(self.send(border="border_none", enabled=True)["code"], "mqtt_no_border")
        self.remove_border(identity)

    # ------------------------------------------------------------------ the same rules as for everybody
    def test_save_waits_for_an_answer_if_there_is_doubt(self):
        count = len(self.heard[names.BORDERS].borders)
        self.assertEqual(self.give("save")["code"], "nothing_to_save")
        self.give("define_border")
        state = self.wait("state", lambda value: value["state"] == "border", "the state border")
        self.assertIn("cancel", state["available_commands"])
        self.give("define_seed")
        interaction = wait_until(lambda: self.heard[names.STATE].interaction_id, "an interaction")
        progress = BorderProgress(interaction_id=interaction, chain=CARPET, seed=MIDDLE, has_seed=True, code="ok")
        progress.header.stamp = rospy.Time.now()
        doubt = NoticePublisher()
        doubt.set([Notice("strokes_left_out", Severity.WARNING)])

        def doubtful():
            self.progress.publish(progress)
            preview = self.heard.get(names.PREVIEW, BorderPreview())
            return [issue for issue in preview.issues if issue.code == "strokes_left_out"]

        wait_until(doubtful, "the issue in the preview")
        self.assertEqual(self.give("save")["code"], "confirm_save")
        doubt.close()
        question = self.wait("question", lambda value: value["command"] == "save", "the question")
        self.assertEqual(question["asked"], "home_assistant")
        self.wait("health", lambda health: health["confirm"] == "online", "the button that answers")
        self.assertEqual(len(self.heard[names.BORDERS].borders), count)
        self.assertEqual(self.give(question["answer"])["code"], "saved")
        wait_until(lambda: len(self.heard[names.BORDERS].borders) == count + 1, "the border")
        self.wait("question", lambda value: value["command"] == "", "the question to be closed")
        self.remove_border(self.heard[names.BORDERS].borders[-1].id)

    def test_resume_releases_only_the_stop_that_was_shown(self):
        self.give("stop")
        state = self.wait("stopped", lambda value: value["stopped"], "the stop")
        self.assertEqual(state["stopped_by"], "home_assistant")
        self.assertEqual(self.heard[names.STOP].source, "home_assistant")
        # somebody else stops the robots too
        rospy.ServiceProxy(names.COMMAND, Command)(command="stop", source="test", id="newer")
        self.wait("stopped", lambda value: value["stop_number"] != state["stop_number"], "the newer stop")
        self.assertEqual(self.give("resume", seen_stop=state["stop_number"])["code"], "stopped_since")
        self.assertEqual(self.give("resume")["code"], "resume_which_stop")
        self.assertTrue(self.shown("stopped")["stopped"])
        newest = self.shown("stopped")["stop_number"]
        self.assertEqual(self.give("resume", seen_stop=newest)["code"], "resumed")
        self.wait("stopped", lambda value: not value["stopped"], "robots that may drive")

    def test_after_a_restart_nothing_old_is_done_or_shown(self):
        self.assertEqual(self.give("define_border", at=time.time() - 60.0)["code"], "expired")
        identity = self.add_border("Nursery")
        switch = f"homeassistant/switch/home/border_{identity}/config"
        self.hub.wait(switch, lambda _: True, "the switch")
        # the retained command comes with the next connection, and is then deleted from the broker
        self.node.kill()
        wait_until(lambda: self.hub.messages["home/availability"] == b"offline", "the will")
        self.remove_border(identity)
        self.hub.messages.pop("home/answer", None)
        self.hub.send("home/command", "stop", retain=True).wait_for_publish(5.0)
        self.node.start()
        self.assertEqual(self.wait("answer", lambda _: True, "a refusal")["code"], "mqtt_retained")
        wait_until(lambda: self.hub.messages["home/availability"] == b"online", "the node")
        wait_until(lambda: not self.hub.messages["home/command"], "what was kept to be deleted")
        self.assertFalse(self.heard[names.STATE].stopped)
        wait_until(lambda: not self.hub.messages.get(switch), "the switch of a border that was removed meanwhile to go")

    def test_a_stop_gets_through_a_flood(self):
        for number in range(2000):
            self.hub.send("home/command", {"command": "cancel", "at": time.time(), "id": f"f{number}"}, qos=0)
            if number % 10 == 0:
                self.hub.send("home/command", os.urandom(300), qos=0)
        self.hub.send("home/command", "stop")
        self.wait("stopped", lambda value: value["stopped"], "the stop")
        # the broker itself drops what is too much for it
        for code, count in (("mqtt_too_fast", 500), ("mqtt_bad_message", 50)):
            self.wait("notices", lambda value: value["refused"].get(code, 0) > count, f"{count} of {code}")
        # a new process starts with fresh rate limits
        self.node.kill()
        self.node.start()
        wait_until(lambda: self.is_done("resume", seen_stop=self.shown("stopped")["stop_number"]), "the resume")

    # ------------------------------------------------------------------ a broker that dies
    def test_commands_are_done_once_whenever_the_broker_dies(self):
        """No command is done twice or too late; and commands given while everything runs are done."""
        log = CommandLog(self.hub)
        # the commands of this node reach only the log
        node = start(self.server.port, "kills", f"{names.COMMAND}:=/kills/command", f"{names.STOP}:=/kills/stop")
        self.hub.wait("kills/state", lambda _: True, "the other node")
        luck = random.Random(SEED)
        for _ in range(KILLS):
            self.kill_broker_while_commands_are_given(log, luck)
        oldest = max(times[0] - log.given_times[identity] for identity, times in log.done_times.items())
        twice = [identity for identity, times in log.done_times.items() if len(times) > 1]
        given = len(log.given_times) - log.stops_given
        commands = f"{given} commands given, {len(log.done_times)} done, {len(twice)} twice, oldest {oldest:.2f} s"
        stops = f"{log.stops_given} stops given, {len(log.stop_times)} done"
        print(f"\nbroker killed {KILLS} times, seed {SEED}: {commands}; {stops}", file=sys.stderr)
        self.assertEqual(twice, [])
        self.assertLessEqual(oldest, MAX_AGE)
        # a stop never expires, but one that comes while another is pending may be merged with it
        self.assertEqual(len(log.stop_times) > 0, log.stops_given > 0)
        self.assertLessEqual(len(log.stop_times), log.stops_given)
        node.stop()
        log.service.shutdown()

    def kill_broker_while_commands_are_given(self, log, luck):
        dies = luck.randrange(5)
        for number in range(5):
            log.give(luck.choice(("cancel", "undo", "define_border", "stop")))
            time.sleep(luck.uniform(0.0, 0.2))
            if number == dies:
                self.server.kill()
        # a short outage, or one longer than a command's lifetime
        time.sleep(luck.uniform(0.0, 1.0) if luck.random() < 0.5 else luck.uniform(MAX_AGE, MAX_AGE + 2.0))
        self.server.start()
        wait_until(self.hub.connected, "the hub's connection")
        again = set()

        def is_one_done():
            again.add(log.give("cancel"))
            time.sleep(1.0)
            return again & set(log.done_times)

        wait_until(is_one_done, "a command to be done")


if __name__ == "__main__":
    rostest.rosrun("vb_mqtt", "rostest_mqtt", MqttTest)
