#!/usr/bin/env python3
"""The interaction manager over a real roscore with stubs for its neighbours; the console in a pseudo-terminal."""

import contextlib
import json
import os
import signal
import tempfile
import unittest
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import rospy
import rostest
from std_msgs.msg import Header
from vb_core import sentences
from neighbors import StubNeighbors, point
from terminal import Terminal
from vb_testing import Newest, Process, assert_ends_with_one_line, assert_fields, wait_until
from vb_msgs.msg import BorderIssue, BorderPreview, BorderProgress, DriverState, InteractionState, LaserSpot
from vb_msgs.msg import NoticeArray, Stop, VirtualBorderArray
from vb_msgs.srv import Command

FOLDER = tempfile.mkdtemp(prefix="vb_interaction_")
LOG = os.path.join(FOLDER, "interactions.jsonl")
# all of them each time, as parameters stay on the server for the next node of this name
ARGUMENTS = [f"_log_file:={LOG}", f"_stop_file:={FOLDER}/stop", "_method:=a_method", "_idle_timeout:=300"]


def manager(*arguments):
    return Process("vb_interaction", "interaction_manager", "__name:=interaction_manager", *ARGUMENTS, *arguments)


class InteractionManagerTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node("rostest_interaction_manager")
        cls.stub = StubNeighbors()
        cls.stub.offer()
        cls.progress = rospy.Publisher("/virtual_borders/progress", BorderProgress, queue_size=1, latch=True)
        cls.borders = rospy.Publisher("/virtual_borders/borders", VirtualBorderArray, queue_size=1, latch=True)
        cls.state = Newest("/virtual_borders/state", InteractionState)
        cls.preview = Newest("/virtual_borders/preview", BorderPreview)
        cls.pool = ThreadPoolExecutor()
        cls.node = manager()
        cls.addClassCleanup(lambda: cls.node.stop())
        rospy.wait_for_service("/virtual_borders/command", 60)

    def setUp(self):
        # a failed test may have left the stub or the node in any state
        self.stub.withdraw()
        self.stub.offer()
        rospy.wait_for_service("/virtual_borders/command", 60)
        wait_until(lambda: self.command("resume").success, "a manager that answers")
        wait_until(lambda: self.command("cancel").success, "the default state")

    def command(self, name, source="test", **more):
        more.setdefault("seen_stop", self.state.message.stop_number if name == "resume" else "")
        return rospy.ServiceProxy("/virtual_borders/command", Command)(command=name, source=source, **more)

    def save(self):
        """Saves as a person does, again if a neighbour did not answer in time."""

        def saved():
            answer = self.command("save")
            self.assertIn(answer.code, ("saved", "no_service", "no_response", "save_unanswered"), answer.message)
            return answer.success

        wait_until(saved, "the saved border")

    def records(self):
        return [json.loads(line) for line in Path(LOG).read_text().splitlines()]

    def in_state(self, name):
        return self.state.wait(lambda message: message.name == name, f"state {name}")

    def begin(self):
        """Begins border and seed; returns the interaction's id."""
        self.command("define_border")
        self.command("define_seed")
        return self.in_state("seed").interaction_id

    @contextlib.contextmanager
    def another(self, *arguments):
        """Replaces the usual manager with one of other parameters: even in a namespace it would use the same names."""
        self.node.kill()
        del self.state.all[:]
        other = manager(*arguments)
        try:
            wait_until(lambda: self._answers("cancel"), "the other manager")
            yield other
        finally:
            other.kill()
            self.node.start()

    def test_an_interaction_ends_with_its_border_saved_and_recorded(self):
        self.assertTrue(self.command("define_border", "voice").success)
        drawing = self.in_state("border")
        self.assertTrue(drawing.interaction_id)
        self.assertFalse(drawing.started.is_zero())
        # elapsed times grow without a command
        self.state.wait(lambda message: message.border_s > drawing.border_s, "time that runs")
        self.progress.publish(interaction_id=drawing.interaction_id, border_spots=5)
        wait_until(lambda: self.command("save").code == "missing_seed", "the spots in the answer")
        self.assertTrue(self.command("define_seed").success)
        before = len(self.stub.added)
        saved = self.command("save", "wizard")
        assert_fields(saved, success=True, code="saved")
        self.assertEqual(self.stub.candidates[-1].interaction_id, drawing.interaction_id)
        self.assertEqual(len(self.stub.added), before + 1)
        request = self.stub.added[-1]
        self.assertEqual(request.source, "wizard")
        assert_fields(request.border, id="", enabled=True, occupancy=1.0)
        self.assertEqual(len(request.border.points), 3)
        done = self.in_state("default")
        assert_fields(done, last_outcome="saved", last_border_id="b1", last_command="save", interaction_id="")
        self.assertTrue(done.started.is_zero())
        record = self.records()[-1]
        assert_fields(record, interaction_id=drawing.interaction_id, outcome="saved", method="a_method")
        self.assertEqual(record["sources"], ["voice", "test", "wizard"])

    def draw(self, identity, dx=0.0):
        """Publishes progress with border and seed, as the border fusion does."""
        progress = BorderProgress(interaction_id=identity, code="ok", border_spots=5, seed_spots=5, has_seed=True)
        progress.chain = [point(0, 0), point(1, 0), point(1, 1)]
        progress.seed = point(0.5 + dx, 0.5)
        self.progress.publish(progress)

    def begin_and_draw(self):
        """Begins border and seed, and draws them; returns the preview."""
        identity = self.begin()
        self.draw(identity)
        return self.preview.wait(lambda shown: shown.available and shown.interaction_id == identity, "the preview")

    def test_the_preview_shows_what_is_drawn(self):
        self.command("define_border")
        identity = self.in_state("border").interaction_id
        nothing = self.preview.wait(lambda message: message.interaction_id == identity, "a preview of nothing yet")
        self.assertFalse(nothing.available)
        shown = self.begin_and_draw()
        assert_fields(shown, success=True, code="ok", area_m2=0.5, free_parts=1)
        self.assertEqual(shown.header.frame_id, "map")
        self.assertEqual(list(shown.region.data), [100, 0])
        self.assertEqual(len(shown.border.points), 3)
        self.assertEqual(self.stub.previews[-1].border.points, shown.border.points)

    def test_a_moved_seed_and_borders_that_others_change_cause_a_new_preview(self):
        identity = self.begin_and_draw().interaction_id
        with self.stub.refusing("preview", "no_separation"):
            self.stub.preview.issues = [BorderIssue(severity=BorderIssue.ERROR, code="no_separation")]
            self.draw(identity, dx=0.2)
            refused = self.preview.wait(lambda message: message.code == "no_separation", "the refusal")
            assert_fields(refused, available=True, success=False)
            self.assertEqual(len(refused.issues), 1)
        self.borders.publish(revision=77)
        self.preview.wait(lambda message: message.success, "the preview in another map")

    def test_a_neighbour_that_is_missing_from_the_preview_is_reported_and_asked_again(self):
        identity = self.begin_and_draw().interaction_id
        self.stub.withdraw()
        self.draw(identity, dx=0.4)
        # a request that was on its way when the services ended gets no response; the next one finds no service
        away = self.preview.wait(lambda message: message.code == "no_service", "the missing neighbour")
        self.assertFalse(away.available)
        self.assertIn("is not running", away.message)
        self.stub.offer()
        self.preview.wait(lambda message: message.available, "the neighbour that is back")

    def test_the_border_that_the_preview_shows_is_saved_without_a_new_extraction(self):
        shown = self.begin_and_draw()
        asked = len(self.stub.candidates)
        self.save()
        saved = self.stub.added[-1].border
        assert_fields(saved, points=shown.border.points, seed=shown.border.seed)
        self.assertEqual(len(self.stub.candidates), asked)
        self.preview.wait(lambda message: not message.interaction_id and not message.available, "the cleared preview")

    def test_a_preview_without_an_answer_holds_nobody_up(self):
        with self.stub.hanging("preview") as called:
            self.draw(self.begin())
            self.assertTrue(called.wait(60))
            self.assertTrue(self.command("guide_robot").success)
            self.save()
        self.preview.wait(lambda message: not message.interaction_id and not message.available, "the cleared preview")

    def test_refusals_of_neighbours_reach_the_person(self):
        identity = self.begin()
        with self.stub.refusing("candidate", "too_few"):
            answer = self.command("save")
        assert_fields(answer, success=False, code="too_few", message="Refused.")
        with self.stub.refusing("add", "no_separation"):
            answer = self.command("save")
        assert_fields(answer, code="no_separation", message=sentences.translate("no_separation"))
        state = self.state.wait(lambda message: message.last_code == "no_separation", "the refusal in the state")
        assert_fields(state, name="seed", interaction_id=identity, last_success=False)

    @contextlib.contextmanager
    def hanging_save(self):
        """Saves while the integrator does not answer before the block ends; yields the future answer."""
        self.begin()
        with self.stub.hanging("add") as called:
            saving = self.pool.submit(self.command, "save")
            self.assertTrue(called.wait(60))
            yield saving

    def test_a_save_without_an_answer_is_repeated_under_the_same_id(self):
        count = len(self.stub.added)
        with self.hanging_save() as saving:
            # other commands are refused, and stop is obeyed
            self.assertEqual(self.command("cancel").code, "busy")
            self.assertEqual(self.command("stop").code, "stopped")
            stopped = self.state.wait(lambda message: message.stopped, "the stop while saving")
            assert_fields(stopped, stopped_by="test", name="seed")
            self.assertEqual(saving.result().code, "save_unanswered")
        wait_until(lambda: len(self.stub.added) == count + 1, "the late border")
        # with the laser still on, the second candidate differs: only the id shows that it is the same border
        self.stub.candidate.border.points[0].x += 0.05
        self.save()
        first, second = self.stub.added[-2:]
        self.assertEqual(first.request_id, second.request_id)
        self.assertEqual(self.in_state("default").last_border_id, "b1")
        self.assertTrue(self.state.message.stopped)
        self.assertNotEqual(self.stub.added[count - 1].request_id if count else "", second.request_id)

    def test_a_command_that_is_sent_again_is_carried_out_once(self):
        first, again = [self.command("undo", id="one") for _ in range(2)]
        assert_fields(first, success=again.success, code=again.code, values=again.values)
        self.assertEqual(first.code, "border_removed")
        self.assertEqual(first.values[0].value, "Nursery")
        self.assertEqual(self.stub.undone, 1)
        refused = self.command("undo", id="two")
        assert_fields(refused, success=False, code="nothing_to_undo")

    def test_a_hung_manager_does_not_carry_out_old_commands(self):
        self.command("define_border")
        self.in_state("border")
        self.node.process.send_signal(signal.SIGSTOP)
        expires = rospy.Time.now() + rospy.Duration(0.05)
        late = [self.pool.submit(self.command, name, id=name, expires=expires) for name in ("cancel", "stop")]
        wait_until(lambda: rospy.Time.now() > expires, "the time")
        self.node.process.send_signal(signal.SIGCONT)
        self.assertEqual([answer.result().code for answer in late], ["expired", "stopped"])
        self.assertEqual(self.state.message.name, "border")

    def test_unclear_commands_are_asked_about(self):
        self.begin()
        asked = self.command("save", uncertain=True)
        assert_fields(asked, success=False, code="confirm_save")
        self.state.wait(lambda message: message.confirm_save, "the question")
        spots = rospy.Publisher("/virtual_borders/spots", LaserSpot, queue_size=1)
        wait_until(spots.get_num_connections, "the manager's eye")

        def pointing():
            spots.publish(LaserSpot(header=Header(stamp=rospy.Time.now(), frame_id="map")))
            if self.command("guide_robot", uncertain=True).code == "confirm_command":
                return True
            self.command("define_border")  # the command was carried out, as it came before the spot
            return False

        wait_until(pointing, "the question whether a robot should follow the laser that is on")
        asked = self.command("save", source="voice", uncertain=True)
        self.assertIn("yes save", [value.value for value in asked.values])
        self.assertEqual(self.command("yes save", source="voice", uncertain=True).code, "saved")

    def test_a_killed_node_begins_again_and_a_stop_holds(self):
        topic = rospy.Publisher("/virtual_borders/stop", Stop, queue_size=1)
        wait_until(topic.get_num_connections, "the manager's ear")
        self.command("define_border", "voice")
        self.command("define_seed", "voice")
        topic.publish(source="a red button")
        before = self.state.wait(lambda message: message.stopped, "the stop by topic")
        self.assertEqual(before.name, "seed")
        self.assertEqual(before.available_commands[0], "resume")
        # robots hear of the stop before the file is written; until then only they hold it
        wait_until(lambda: before.stop_number in Path(f"{FOLDER}/stop").read_text(), "the stop's file")
        self.node.kill()
        del self.state.all[:]
        self.node.start()
        again = self.in_state("default")
        assert_fields(again, stopped=True, stopped_by="a red button")
        wait_until(lambda: self._answers("define_border"), "the restarted node's service")
        self.assertNotEqual(self.in_state("border").interaction_id, before.interaction_id)
        self.assertEqual(self.command("guide_robot").code, "guide_stopped")
        self.assertTrue(self.command("resume").success)
        self.state.wait(lambda message: not message.stopped, "robots that may drive")

    def test_stop_heard_by_one_robot_stops_all_until_resumed(self):
        robot = rospy.Publisher("/virtual_borders/drivers", DriverState, queue_size=1)
        wait_until(robot.get_num_connections, "the manager's ear")
        robot.publish(robot="ada", stops=["heard while the manager was away"])
        stopped = self.state.wait(lambda message: message.stopped, "the robot's stop")
        self.assertEqual(stopped.stopped_by, "ada")
        self.assertEqual(self.command("resume").code, "resumed")
        released = self.state.wait(lambda message: not message.stopped, "robots that may drive")
        self.assertIn("heard while the manager was away", released.stops)

    def test_resume_waiting_behind_a_save_releases_no_newer_stop(self):
        self.command("stop")
        seen = self.state.wait(lambda message: message.stopped, "the first stop").stop_number
        with self.hanging_save() as saving:
            self.command("stop", id="newer")
            self.assertEqual(self.command("resume", seen_stop=seen).code, "stopped_since")
        saving.result()
        self.assertTrue(self.state.wait(lambda message: message.last_outcome == "saved", "the save").stopped)

    def test_a_stop_that_cannot_be_stored_is_reported_and_holds_after_a_crash(self):
        notices = Newest("/virtual_borders/notices", NoticeArray)
        folder = os.path.join(FOLDER, "full")
        os.makedirs(folder, exist_ok=True)
        with self.another(f"_stop_file:={folder}/stop") as other:
            # not even root can then create a file, but an existing one can be emptied: the same as on a full disk
            os.rename(f"{folder}/stop", f"{folder}/kept")
            os.mkdir(f"{folder}/stop")
            # the answer waits only briefly for the disk, the notice comes in any case
            self.assertTrue(self.command("stop").success)
            code = "stop_not_stored"
            wait_until(lambda: code in [n.code for said in notices.all for n in said.notices], "the notice")
            other.kill()
            del self.state.all[:]
            other.start()
            self.state.wait(lambda message: message.stopped, "a stop in doubt")

    def _answers(self, name):
        try:
            return self.command(name).success
        except rospy.ServiceException:
            return False

    def test_an_abandoned_interaction_ends_with_a_warning(self):
        notices = Newest("/virtual_borders/notices", NoticeArray)
        with self.another("_idle_timeout:=3"):
            wait_until(lambda: notices.all, "the impatient node's notices")
            self.assertTrue(self.command("define_border").success)
            # on a slow machine they may be over when it looks, so all messages count
            wait_until(lambda: any(not message.ends_at.is_zero() for message in self.state.all), "the warning")
            alone = ["interaction_ends_soon"]
            wait_until(lambda: alone in [[n.code for n in said.notices] for said in notices.all], "the notice")
            self.state.wait(lambda message: message.last_outcome == "abandoned", "the end")
            wait_until(lambda: self.records()[-1]["outcome"] == "abandoned", "the record")

    def test_an_interaction_by_keys_while_the_manager_dies_and_comes_back(self):
        terminal = Terminal()
        terminal.shows("READY")
        terminal.press("s")
        terminal.shows("nothing to save")
        terminal.press("b")
        drawing = self.state.wait(lambda message: message.name == "border", "the border state")
        self.assertEqual(drawing.last_source, "wizard")
        spots = {"border_spots": 321, "cameras_seeing_spot": ["red"]}
        self.progress.publish(interaction_id=drawing.interaction_id, code="ok", **spots)
        terminal.shows("321 border")
        length = len(terminal.text)  # the console waited at its start, too
        self.node.kill()
        terminal.shows("waiting for the interaction manager", length)
        length = len(terminal.text)
        self.node.start()
        terminal.shows("READY", length)
        terminal.press("z\x1b[a")
        terminal.press("u")
        terminal.shows("Removed from the map: Nursery")
        terminal.press(" ")
        terminal.shows("STOPPED")
        self.state.wait(lambda message: message.stopped and message.stopped_by == "wizard", "the stop")
        terminal.press("p")
        self.state.wait(lambda message: not message.stopped, "the end of the stop")
        self.assertEqual(self.stub.undone, 1)
        self.assertNotIn("Traceback", terminal.text)
        self.assertEqual(terminal.leave(), (0, True))

    def test_the_console_is_refused_without_a_terminal(self):
        assert_ends_with_one_line("vb_voice_wizard", "wizard_console", [([], "needs a terminal")])


if __name__ == "__main__":
    rostest.rosrun("vb_interaction", "interaction_manager", InteractionManagerTest)
