"""Makes the message by which all nodes learn the state of the interaction."""

from __future__ import annotations

import rospy
from vb_msgs.msg import InteractionState

from vb_core import names
from vb_core.interaction_tables import BORDER, GUIDE, SAVE, SEED
from vb_core.ros.messages import values_from_mapping
from vb_core.stop_latch import StopLatch
from vb_interaction.interaction import Interaction


def make_state_message(interaction: Interaction, latch: StopLatch, now: float) -> InteractionState:
    """Makes the message of an interaction's state and of the stop that a latch holds, at the time `now` [s]."""
    durations = interaction.durations(now)
    message = InteractionState()
    message.header.stamp = rospy.Time.from_sec(now)
    message.header.frame_id = names.MAP_FRAME
    message.name = interaction.state.name
    message.interaction_id = interaction.interaction_id
    message.started = rospy.Time.from_sec(interaction.started_at)
    message.entered = rospy.Time.from_sec(interaction.state_entered_at)
    message.guide_s = durations[GUIDE]
    message.border_s = durations[BORDER]
    message.seed_s = durations[SEED]
    message.stopped, message.stopped_by, message.stop_number, message.stops = latch.snapshot()
    message.ends_at = rospy.Time.from_sec(interaction.ends_at)
    message.confirm_save = interaction.question.command == SAVE
    message.available_commands = interaction.suggested_commands()
    message.last_command = interaction.last_command
    message.last_source = interaction.last_source
    message.last_success = interaction.last_answer.success
    message.last_code = interaction.last_answer.code
    message.last_message = interaction.last_answer.message
    message.last_values = values_from_mapping(interaction.last_answer.values)
    message.last_answered = rospy.Time.from_sec(interaction.last_answered)
    message.last_outcome = interaction.last_outcome
    message.last_border_id = interaction.last_border_id
    return message
