"""Node: sends the commands of buttons."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Optional

import rospy
from sensor_msgs.msg import Joy
from vb_core import names
from vb_core.errors import CodedError
from vb_core.parameters import Parameters, param
from vb_core.ros import commands, parameters
from vb_msgs.msg import InteractionState
from vb_msgs.srv import CommandRequest, CommandResponse

from vb_voice_wizard.buttons import ButtonMap


@dataclass(frozen=True)
class ButtonsParams(Parameters):
    """Parameters of buttons; config/buttons.yaml explains them."""

    mapping: dict = param({})
    by_state: dict = param({})


class ButtonsNode:
    """Sends a command for each press of a button, which is on a presenter or, in the baseline method, on the robot.

    Subscribed topics:
        joy (sensor_msgs/Joy): a command is sent once per press, not repeatedly while the button is held.
        /virtual_borders/state (vb_msgs/InteractionState): the newest stop, and the state, on which a button may depend.
        /virtual_borders/drivers (vb_msgs/DriverState), /virtual_borders/robots (vb_msgs/RobotStatusArray): who holds a stop.

    Published topics:
        /virtual_borders/stop (vb_msgs/Stop): on `stop`

    Services called:
        /virtual_borders/command (vb_msgs/Command)

    Parameters:
        config/buttons.yaml
    """

    def __init__(self, params: ButtonsParams) -> None:
        self._map = ButtonMap(params.mapping, params.by_state)
        self._state = "default"
        self._command_sender = commands.CommandSender("buttons", self._on_answer)
        rospy.Subscriber(names.STATE, InteractionState, self._on_state, queue_size=1)
        rospy.Subscriber("joy", Joy, self._on_joy, queue_size=20)

    def _on_state(self, message: InteractionState) -> None:
        self._state = message.name

    def _on_joy(self, message: Joy) -> None:
        for command in self._map.update(message.buttons, self._state):
            if not self._command_sender.submit(command):
                rospy.logwarn_throttle(5.0, "buttons: pressed faster than commands are answered; some are lost")

    @staticmethod
    def _on_answer(
        request: CommandRequest, _context: Any, answer: Optional[CommandResponse], error: Optional[CodedError]
    ) -> None:
        if answer is not None:
            rospy.loginfo("%s: %s [%s]", request.command, answer.message, answer.code)
        else:
            rospy.logwarn("%s is lost: %s", request.command, error)


def build() -> ButtonsNode:
    """Reads the parameters and constructs the node."""
    return ButtonsNode(parameters.read(ButtonsParams))
