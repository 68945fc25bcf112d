"""Situations of an interaction, and interactions that are in one; what the tests of the state machine share."""

import pytest

from vb_core.interaction_tables import BORDER, DEFAULT, GUIDE, SEED, YES_ANSWERS
from vb_interaction.command_answers import Answer
from vb_interaction.interaction import Interaction, InteractionParams

# commands given before, the state after them, and how define_border, define_seed and save are answered there
SITUATIONS = [
    ("", DEFAULT, "draw_border", "point_seed", "nothing_to_save"),
    ("define_border", BORDER, "draw_border_again", "point_seed", "missing_seed"),
    ("define_seed", SEED, "draw_border", "point_seed_again", "missing_border"),
    ("guide_robot", GUIDE, "draw_border", "point_seed", "missing_border_and_seed"),
    ("define_border define_seed", SEED, "draw_border_again", "point_seed_again", "saving"),
    ("define_seed define_border", BORDER, "draw_border_again", "point_seed_again", "saving"),
    ("define_border guide_robot", GUIDE, "draw_border_again", "point_seed", "missing_seed"),
    ("guide_robot define_border", BORDER, "draw_border_again", "point_seed", "missing_seed"),
    ("define_seed guide_robot", GUIDE, "draw_border", "point_seed_again", "missing_border"),
    ("guide_robot define_seed", SEED, "draw_border", "point_seed_again", "missing_border"),
    ("define_border define_seed guide_robot", GUIDE, "draw_border_again", "point_seed_again", "saving"),
    ("define_seed define_border guide_robot", GUIDE, "draw_border_again", "point_seed_again", "saving"),
    ("define_border guide_robot define_seed", SEED, "draw_border_again", "point_seed_again", "saving"),
    ("guide_robot define_border define_seed", SEED, "draw_border_again", "point_seed_again", "saving"),
    ("define_seed guide_robot define_border", BORDER, "draw_border_again", "point_seed_again", "saving"),
    ("guide_robot define_seed define_border", BORDER, "draw_border_again", "point_seed_again", "saving"),
]
ALL_SITUATIONS = [before for before, *_ in SITUATIONS]
BEGUN = ALL_SITUATIONS[1:]
COMPLETE = "define_border define_seed"

in_all_situations = pytest.mark.parametrize("before", ALL_SITUATIONS)


def interaction_after(before: str, **params) -> Interaction:
    """Returns an interaction in which these commands were given, one a second, and cameras saw spots."""
    interaction = Interaction(InteractionParams(**params))
    for second, command in enumerate(before.split()):
        assert command_knowing_stops(interaction, command, "test", float(second)).success
    interaction.set_spot_counts(3, 2, 1, float(len(before.split())))
    return interaction


def command_knowing_stops(interaction, said, source, now, **more) -> Answer:
    """Gives a command, or the answer that confirms one, as a person who knows of every stop."""
    more.update(confirms=said in YES_ANSWERS, seen_stop=interaction.latch.number)
    return interaction.command(YES_ANSWERS.get(said, said), source, now, **more)


def drawing_of(interaction):
    """Returns what must not get lost: the interaction's id, its state, and the parts of the border not begun yet."""
    return interaction.interaction_id, interaction.state, interaction.missing_parts()
