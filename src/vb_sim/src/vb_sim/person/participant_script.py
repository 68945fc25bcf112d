"""The course of a participant's run, from coming in to walking away, whatever the method."""

from __future__ import annotations

from typing import Generator

from vb_sim.person.person import DEFAULT, Action, CommandReply, DrawingSlip, ParticipantGaveUp, Perception, Person, Step

CONFIRM_SAVE = "confirm_save"  # code of an answer that asks whether the command was meant
WALK_AWAY_TIME = 10.0  # [s] after which the run ends, even if the person is still walking


class ParticipantScript:
    """The course of a run. Subclasses implement how the person prepares, draws and shows the seed.

    Attributes:
        source: what gives the commands, "participant" for the voice or "buttons".
        outcome: "saved" or "gave_up" at the end of the run; empty before.
        reason: why the person gave up, in words.
        tries: number of attempts to draw the border, the present one included.
    """

    source = "participant"

    def __init__(self, person: Person) -> None:
        self.person = person
        self.outcome = self.reason = ""
        self.tries = 0
        self._course = self._run_course()

    def step(self, perception: Perception) -> Action:
        """Lets the person perceive and act once."""
        self.person.step(perception, self._course)
        return self.person.action(self.outcome)

    # ------------------------------------------------------------ for subclasses
    def prepare(self) -> Step:
        """Prepares to draw: walks to the border, or guides the robot there."""
        raise NotImplementedError

    def trace_border(self) -> Step:
        """Traces the border with the spot. The state is Border."""
        raise NotImplementedError

    def show_seed(self) -> Step:
        """Gives the command to define the seed, and points at it."""
        raise NotImplementedError

    # ------------------------------------------------------------ the common course
    def _run_course(self) -> Step:
        """Tries until a border is saved or the person gives up, walks away, and keeps this outcome from then on."""
        person = self.person
        while not person.perception.now:
            yield
        start = person.perception.now
        course = self._attempt_repeatedly()
        try:
            for _ in course:
                if person.perception.now - start > person.model.time_limit:
                    raise ParticipantGaveUp(f"it took longer than {person.model.time_limit:g} s")
                yield
            outcome = "saved"
        except ParticipantGaveUp as reason:
            course.close()
            outcome = "gave_up"
            self.reason = str(reason)
            person.spot = None
            yield from person.give_command("cancel", self.source)
        person.spot = None
        person.doing = "walks away"
        person.walker.walk_to(person.walker.find_position_near(person.walker.position, 0.8, 1.5, person.rng))
        yield from person.arrive(WALK_AWAY_TIME)
        person.walker.stop()
        person.doing = "is done"
        self.outcome = outcome
        while True:
            yield

    def _attempt_repeatedly(self) -> Step:
        person = self.person
        if person.perception.state != DEFAULT:
            # another person, or this one before a restart, left an interaction unfinished
            person.doing = "starts over"
            yield from person.repeat_command("cancel", self.source)
        for number in range(1, person.model.tries + 1):
            self.tries = number
            try:
                if (yield from self._attempt()):
                    return
                refusal = person.last_answer
            except DrawingSlip:
                refusal = CommandReply(False, "slipped", "it went wrong")
            if person.perception.state != DEFAULT:
                person.doing = "starts over"
                person.spot = None
                yield from person.repeat_command("cancel", self.source)
        raise ParticipantGaveUp(f"not saved: {refusal.message} [{refusal.code}]")

    def _attempt(self) -> Generator[None, None, bool]:
        """Makes one attempt to draw, show the seed and save. Returns whether a border was saved.

        Raises:
            DrawingSlip: if the person notices a mistake.
        """
        person = self.person
        yield from self.prepare()
        yield from self.trace_border()
        yield from person.look()
        for _ in range(person.model.tries):
            yield from self.show_seed()
            person.spot = None
            yield from person.look()
            yield from person.react()
            yield from self._save()
            if person.last_answer.success or "seed" not in person.last_answer.code:
                break
        return person.last_answer.success

    def _save(self) -> Step:
        for _ in range(4):
            yield from self.person.give_command("save", self.source)
            if self.person.last_answer.code == CONFIRM_SAVE:
                # the person checks on the display which area would be restricted, and confirms
                yield from self.person.react()
            elif self.person.last_answer.code == "busy":
                yield from self.person.wait(1.5)
            else:
                return
