"""Node: simulates a person, who gives commands by the same service as real people and sees what they see."""

from __future__ import annotations

import json
import threading
from dataclasses import dataclass, replace
from typing import Optional, Set

import rospy
from geometry_msgs.msg import Point, Pose2D
from std_msgs.msg import String

from vb_core import names
from vb_core.errors import CodedError
from vb_core.parameters import Parameters, param
from vb_core.ros import commands, node, parameters
from vb_msgs.msg import BorderProgress, InteractionState, LabState, LaserSpot, NoticeArray, ParticipantState
from vb_sim.model_params import load_models
from vb_sim.person.participant_methods import SCRIPTS, make_script
from vb_sim.person.participant_script import ParticipantScript
from vb_sim.person.person import HOLD_STILL, Action, CommandReply, Perception
from vb_sim.world import Point2, load_world


@dataclass(frozen=True)
class ParticipantParams(Parameters):
    """The node's parameters; those of people are in config/models.yaml."""

    world: str = param("")
    scenario: str = param("")
    method: str = param("nrs", choices=tuple(SCRIPTS))
    seed: int = param(1, "", low=0)
    color: str = param("red", choices=("red", "green"))


class ParticipantNode:
    """Connects a simulated person to the system.

    Args:
        script: decides what the person does in each step.
        laser_color: "red" or "green".

    Subscribed topics:
        /sim/lab_state (vb_msgs/LabState): the robot's pose; each message is one step of the person
        /virtual_borders/spots (vb_msgs/LaserSpot): only whether the spot is seen, as sound and LED tell people
        /virtual_borders/progress (vb_msgs/BorderProgress): whether the display shows a seed
        /virtual_borders/state (vb_msgs/InteractionState): the state that the display shows
        /virtual_borders/notices (vb_msgs/NoticeArray): the display's notices about the robots
    Published topics:
        /sim/participant (vb_msgs/ParticipantState): 50 Hz with the lab's clock
        /sim/participant_done (std_msgs/String, latched): JSON with outcome ("saved" or "gave_up") and reason
    Services called:
        /virtual_borders/command (vb_msgs/Command)
    Parameters:
        config/participant.yaml
    """

    def __init__(self, script: ParticipantScript, laser_color: str) -> None:
        self._script = script
        self._laser_color = laser_color
        self._lock = threading.Lock()
        self._percept = Perception()
        self._sees_state = False  # after a restart, the person must know whether an interaction is unfinished
        self._spot: Optional[Point2] = None
        self._state = rospy.Publisher(names.PARTICIPANT, ParticipantState, queue_size=1)
        self._done = rospy.Publisher(names.PARTICIPANT_DONE, String, queue_size=1, latch=True)
        self._lab_states: node.Mailbox = node.Mailbox()
        self._worker = node.Worker(self._lab_states, self._step_person)
        rospy.Subscriber(names.SPOTS, LaserSpot, self._on_spot, queue_size=50)
        rospy.Subscriber(names.PROGRESS, BorderProgress, self._on_progress, queue_size=1)
        rospy.Subscriber(names.STATE, InteractionState, self._on_state, queue_size=5)
        self._sources_asking_to_hold: Set[str] = set()  # names of nodes
        rospy.Subscriber(names.NOTICES, NoticeArray, self._on_notices, queue_size=10)
        rospy.Subscriber(names.LAB_STATE, LabState, self._lab_states.put, queue_size=1, tcp_nodelay=True)
        for label, arrived in (
            (f"the lab's state on {names.LAB_STATE}: is lab_simulator running?", lambda: self._lab_states.received > 0),
            (f"the interaction's state on {names.STATE}: is interaction_manager running?", lambda: self._sees_state),
        ):
            node.log_missing_input(label, arrived, node.INPUT_TIMEOUT)

    def close(self) -> None:
        """Ends the worker."""
        self._lab_states.close()

    # ------------------------------------------------------------ perception
    def _on_spot(self, message: LaserSpot) -> None:
        position = (message.position.x, message.position.y)
        with self._lock:
            self._percept.record_spot(self._spot, message.header.stamp.to_sec(), position, message.mobile)

    def _on_progress(self, message: BorderProgress) -> None:
        with self._lock:
            self._percept.has_seed = message.has_seed

    def _on_notices(self, message: NoticeArray) -> None:
        with self._lock:
            if HOLD_STILL not in [notice.code for notice in message.notices]:
                self._sources_asking_to_hold.discard(message.source)
            elif message.source not in self._sources_asking_to_hold:
                # a notice is repeated each second, but a person notices it when it appears
                self._sources_asking_to_hold.add(message.source)
                self._percept.hold_requested_at = self._percept.now

    def _on_state(self, message: InteractionState) -> None:
        with self._lock:
            self._percept.state = message.name
            self._sees_state = True

    # ------------------------------------------------------------ steps
    def _step_person(self, lab: LabState) -> None:
        now = lab.header.stamp
        with self._lock:
            if not self._sees_state:
                return
            perception = self._percept
            perception.now = now.to_sec()
            if lab.robot_poses:
                pose = lab.robot_poses[0]
                perception.robot = (pose.x, pose.y, pose.theta)
            snapshot = replace(perception)
        was_finished = bool(self._script.outcome)
        action = self._script.step(snapshot)
        with self._lock:
            self._spot = action.laser
        self._publish(action, now)
        if action.command:
            node.start_thread(self._command, action)
        if action.outcome and not was_finished:
            self._report()

    def _publish(self, action: Action, now: rospy.Time) -> None:
        message = ParticipantState(laser_color=self._laser_color, person_present=True, doing=action.doing)
        message.header.stamp = now
        message.header.frame_id = names.MAP_FRAME
        message.laser_on = action.laser is not None
        message.laser = Point(*(action.laser or (0.0, 0.0)), 0.0)
        message.person = Pose2D(*action.pose)
        self._state.publish(message)

    def _command(self, action: Action) -> None:
        try:
            response = commands.send(commands.make_request(action.command, action.source, 18.0), 3.0, 15.0)
            answer = CommandReply(response.success, response.code, response.message)
        except CodedError as error:
            answer = CommandReply(False, error.code, error.message)
        rospy.loginfo("%s: %s: %s", rospy.get_name(), action.command, answer.message or answer.code)
        with self._lock:
            self._percept.answer, self._percept.answered = answer, action.number

    def _report(self) -> None:
        outcome, reason = self._script.outcome, self._script.reason
        self._done.publish(String(json.dumps({"outcome": outcome, "reason": reason})))
        rospy.loginfo("%s: %s %s", rospy.get_name(), outcome, reason)


def build() -> ParticipantNode:
    """Reads the parameters and constructs the node."""
    params = parameters.read(ParticipantParams)
    world = load_world(params.world)
    scenario = world.scenario(params.scenario)
    script = make_script(world, scenario, load_models().participant, params.method, params.seed)
    return ParticipantNode(script, params.color)
