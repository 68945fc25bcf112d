"""The interaction between person and system as a state machine (paper, Sect. 4.2).

Its commands and states are those of vb_core.vocabulary. Every command is answered in every state; a repeated command
continues where the person left off and erases nothing. Only `cancel`, a completed `save` and a long silence end an
interaction; no silence ends one that is paused. `stop` comes before everything else and holds until a `resume` that was
given after it. Time is injected, in seconds, and may pause or jump back.

Use it to add an input method or to test one: a command's name goes in, an answer with a code comes out. The node
`interaction_manager` wraps one instance.

>>> interaction = Interaction()
>>> interaction.command(DEFINE_BORDER, source="console", now=0.0).success
True
>>> interaction.state.name, interaction.suggested_commands()
('border', ['define_seed', 'guide_robot', 'pause', 'cancel', 'stop'])
"""

from __future__ import annotations

from typing import List, Optional

from vb_core.sentences import spelled_out
from vb_core.stop_latch import new_id
from vb_core.vocabulary import CANCEL, CONTINUE, DEFINE_BORDER, DEFINE_SEED, GUIDE_ROBOT, PAUSE, REDO, RESUME, SAVE
from vb_core.vocabulary import COMMANDS, DEFAULT, GUIDE, PAUSED, STATES, STOP, UNDO, State, normalize

from vb_voice_wizard.confirmation import ANSWERS, Question, would_matter
from vb_voice_wizard.session import CANCELLED, SAVED, UNANSWERED, Answer, Session


class Interaction(Session):
    """The state machine. Not thread safe.

    `save`, `undo` and `redo` take two steps, since other nodes carry them out: `command(...)` checks and, if it
    succeeds, leaves `pending` set; then `finish` must be called.
    """

    @property
    def saving(self) -> bool:
        """Returns whether a border is on its way to the map."""
        return self.pending == SAVE

    # ------------------------------------------------------------------ commands
    def command(
        self,
        name: str,
        source: str,
        now: float,
        uncertain: bool = False,
        doubtful_border: bool = False,
        identity: str = "",
        seen_stop: str = "",
    ) -> Answer:
        """Carries out a command and returns the answer; never raises, and never ignores a command.

        Args:
            name: one of COMMANDS, or of ANSWERS to the question whether one was meant; anything else is answered with
                "unknown_command".
            source: who sends it, for the record.
            now: [s].
            uncertain: whether it may have been misheard.
            doubtful_border: whether the preview of what would be saved has issues.
            identity: of a stop; "": it gets one.
            seen_stop: number of the newest stop that the sender knew of; a command that is older than a stop is void.
        """
        self.advance(now)
        said = normalize(name)
        name = ANSWERS.get(said, said)
        if name == STOP:
            return self._stop(identity or new_id(), source)
        void = bool(seen_stop) and seen_stop != self.latch.number
        if self.pending and (void or name != RESUME):
            # not kept as the last answer: the current command's will be
            return self._stopped_since(name) if void else Answer(False, "busy")
        answer = self._stopped_since(name) if void else self._unknown(name)
        if answer is None:
            self._active = now
            if self.state != DEFAULT:
                self._note(source)
            # before any question: nobody should confirm what is refused anyway
            answer = self._check(name, seen_stop) or self._ask(said, name, source, uncertain, doubtful_border)
            if answer is None or not answer.code.startswith("confirm_"):
                self.question = Question()
        return self._answered(name, source, answer or self._carry_out(name, source, seen_stop))

    def send_save(self) -> None:
        """Says that the border goes out to the map now; until `finish`, nobody knows whether it has arrived."""
        self._sent, self._unanswered_before, self.unanswered_save = True, self.unanswered_save, True

    def finish(self, answer: Answer, now: float, border_id: str = "") -> Answer:
        """Completes a pending command with the answer of those that carried it out.

        A save that succeeded, with the new border's id, ends the interaction and stops its timer. One that failed loses
        nothing, the state stays; one that was not answered may have succeeded, and is remembered as such.
        """
        self.advance(now)
        command, self.pending = self.pending, ""
        if command == SAVE and answer.success:
            self._end(SAVED, border_id)
        elif command == SAVE:
            if self._sent:
                # an error of the service itself tells that no earlier request has arrived either
                arrived = {"no_response": True, "internal_error": True, "no_service": self._unanswered_before}
                self.unanswered_save = arrived.get(answer.code, False)
            if self.unanswered_save and answer.code in ("no_response", "no_service"):
                answer = Answer(False, "save_unanswered", answer.values)
        return self._answered(command, self._pending_source, answer)

    def _stop(self, identity: str, source: str) -> Answer:
        self.question = Question()
        self._active = self._counted_until
        before = self.latch.stopped
        new = self.latch.stop(identity, source)
        # one press may come twice, on the topic and as a command: it is one stop, and is reported once
        answer = Answer(True, "stopped" if self.latch.stopped else "stop_released")
        return self._answered(STOP, source, answer) if new and not before else answer

    @staticmethod
    def _stopped_since(name: str) -> Answer:
        return Answer(False, "stopped_since", {"command": spelled_out(name)})

    def _ask(self, said: str, name: str, source: str, uncertain: bool, doubtful_border: bool) -> Optional[Answer]:
        """Returns the question whether this command is meant, or None if it was answered or need not be asked."""
        if self.question[:2] == (name, source) and (said in ANSWERS or not uncertain):
            return None
        if said in ANSWERS:
            return Answer(False, "nothing_asked", {"command": spelled_out(name)})
        points_elsewhere = self.laser_is_on(self._counted_until) and self._target(name) != self.state
        matters = would_matter(name, len(self.missing()) < 2, self.latch.stopped, points_elsewhere)
        if not (uncertain and matters) and not (name == SAVE and doubtful_border):
            return None
        self.question = Question(name, source, self._counted_until)
        answer = spelled_out(name if not uncertain else "yes_" + name)
        code = "confirm_save" if name == SAVE else "confirm_command"
        return Answer(False, code, {"command": spelled_out(name), "answer": answer})

    def _carry_out(self, name: str, source: str, seen_stop: str) -> Answer:
        if COMMANDS[name].carried_out_elsewhere:
            self.pending, self._pending_source, self._sent = name, source, False
            return Answer(True, "saving" if name == SAVE else "changing")
        if name == CANCEL:
            return self._cancel()
        if name == RESUME:
            code = "resumed" if self.latch.stopped else "not_stopped"
            # a stop may have come while this was decided
            return Answer(True, code) if self.latch.resume(seen_stop) else self._stopped_since(RESUME)
        return self._enter(name, source)

    def _target(self, name: str) -> State:
        """Returns the state after a command; `continue` goes back to where the person was."""
        return self._visited[-1] if name == CONTINUE else STATES.get(COMMANDS[name].enters, self.state)

    def _enter(self, name: str, source: str) -> Answer:
        target = self._target(name)
        again = target in self._visited
        if self.state == DEFAULT:
            self._begin()
            self._note(source)
        if self.state != target:
            self.state, self.entered = target, self._counted_until
        if target.robots_act:
            self._visited = [state for state in self._visited if state != target] + [target]
        more = "_stopped" * self.latch.stopped if target.guides else "_again" * again
        return Answer(True, target.prompt + more)

    def _cancel(self) -> Answer:
        if self.state == DEFAULT:
            return Answer(True, "nothing_to_cancel")
        # the border that was sent may be in the map after all: only the map integrator knows
        lost = self.unanswered_save
        self._end(UNANSWERED if lost else CANCELLED, "")
        return Answer(True, "cancelled_unanswered" if lost else "cancelled")

    def _unknown(self, name: str) -> Optional[Answer]:
        """Says that there is no such command here, or returns None."""
        if name not in COMMANDS:
            return Answer(False, "unknown_command", {"commands": ", ".join(map(spelled_out, COMMANDS))})
        return Answer(False, "no_robot_to_guide") if name == GUIDE_ROBOT and not self._params.robot else None

    def _check(self, name: str, seen_stop: str) -> Optional[Answer]:
        """Says why a command cannot be carried out now, or returns None."""
        if name in (UNDO, REDO) and self.state != DEFAULT:
            # the newest change of the map is not what the person is drawing
            return Answer(False, "not_while_drawing", {"command": spelled_out(name)})
        if name == RESUME and self.latch.stopped and not seen_stop:
            return Answer(False, "resume_which_stop", {"stop": self.latch.number})
        if name == PAUSE and self.state == DEFAULT:
            return Answer(False, "nothing_to_pause")
        if name == CONTINUE and self.state != PAUSED:
            return Answer(False, "not_paused")
        if name != SAVE:
            return None
        if self.state == DEFAULT:
            return Answer(False, "nothing_to_save")
        missing = self.missing()
        if len(missing) == 1 and not any(self._spots.values()):
            # the person may have drawn all the same: what is missing first is a camera that sees it
            return Answer(False, "missing_spots")
        return Answer(False, "missing_" + "_and_".join(missing)) if missing else None

    # ------------------------------------------------------------------ queries
    def suggested_commands(self) -> List[str]:
        """Lists the commands that make sense now, most likely first; among them `stop` or, once stopped, `resume`."""
        last = [RESUME] if self.latch.stopped else [STOP]
        guide = [GUIDE_ROBOT] if self._params.robot else []
        if self.pending:
            return last
        if self.state == DEFAULT:
            steps = [DEFINE_BORDER, *guide, *self.history[:1]]
            return [*(last + steps if self.latch.stopped else steps + last), *self.history[1:]]
        missing = self.missing()
        steps = [CONTINUE] * (self.state == PAUSED) + [SAVE] * (not missing)
        drawing = [DEFINE_BORDER, DEFINE_SEED]
        # missing parts come before what could be done again
        others = [step for step in drawing if COMMANDS[step].enters != self.state.name]
        steps += sorted(others, key=lambda step: STATES[COMMANDS[step].enters] in self._visited)
        if self.state != GUIDE:
            steps += guide
        steps += [PAUSE] * (self.state != PAUSED)
        return [*(last if self.latch.stopped else []), *steps, CANCEL, *([] if self.latch.stopped else last)]
