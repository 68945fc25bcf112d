"""The session between person and system: its clock and its record.

Times are injected, in seconds, and may pause or jump back. `interaction` builds the states on it.
"""

from __future__ import annotations

import json
import math
import uuid
from dataclasses import asdict, dataclass, field
from typing import Dict, List, Mapping, Optional, Sequence, Tuple

from vb_core import sentences
from vb_core.errors import CodedError
from vb_core.parameters import Parameters, param
from vb_core.stop_latch import StopLatch
from vb_core.vocabulary import BORDER, CANCEL, DEFAULT, GUIDE, SEED, STATES, State

from vb_voice_wizard.confirmation import CONFIRM_WITHIN, Question

# [s] without a spot in Border or Seed: a person has begun by then, or draws with a laser that no camera sees
UNSEEN_AFTER = 10.0
# [s] before an interaction ends by itself people are warned, at the latest half way
_WARNED_BEFORE = 60.0
# [s] since its last spot, a laser is on
LASER_ON = 1.0

SAVED = "saved"
CANCELLED = "cancelled"
ABANDONED = "abandoned"
UNANSWERED = "unanswered"


@dataclass(frozen=True)
class InteractionParams(Parameters):
    """Parameters of an interaction; config/interaction_manager.yaml explains them."""

    robot: bool = param(True)
    idle_timeout: float = param(300.0, "s", low=1.0, high=86400.0)


@dataclass(frozen=True)
class Answer:
    """The answer to the person: whether it was done, and the code and values of the sentence.

    Attributes:
        said: another node's English sentence, whose code our catalogue may not have.
    """

    success: bool
    code: str
    values: Mapping[str, str] = field(default_factory=dict)
    said: str = ""

    @property
    def message(self) -> str:
        """The sentence in English."""
        return sentences.translate(self.code, self.values, default=self.said)

    @staticmethod
    def refusal(error: CodedError) -> "Answer":
        """Makes an answer from an error."""
        return Answer(False, error.code, {name: str(value) for name, value in error.values.items()}, error.message)


@dataclass(frozen=True)
class Record:
    """One interaction that has ended; times in seconds."""

    interaction_id: str
    outcome: str
    border_id: str
    started: float
    ended: float
    guide_s: float
    border_s: float
    seed_s: float
    total_s: float
    sources: Tuple[str, ...]

    def line(self, method: str, cameras: Sequence[str]) -> str:
        """Writes it as one line of JSON, without the line's end."""
        fields = {name: round(value, 3) if isinstance(value, float) else value for name, value in asdict(self).items()}
        return json.dumps({**fields, "method": method, "cameras": list(cameras)})


class Session:
    """The memory and the clock of one interaction after the other. Not thread safe.

    Args:
        latch: whether robots are stopped, which outlives every interaction.
    """

    def __init__(self, params: InteractionParams = InteractionParams(), latch: Optional[StopLatch] = None) -> None:
        self._params = params
        self.question = Question()
        self.state = DEFAULT
        self.interaction_id = ""
        self.started = 0.0
        self.entered = 0.0
        self.pending = ""  # the command that another node is carrying out
        self.last_command = ""
        self.last_source = ""
        self.last_answer = Answer(True, "")
        self.last_answered = 0.0
        self.last_outcome = ""
        self.last_border_id = ""
        self.unanswered_save = False  # whether a border was sent and never answered
        self._active = 0.0
        self._durations = {state: 0.0 for state in STATES.values() if state.robots_act}
        self._counted_until = 0.0
        self._sources: List[str] = []
        self._visited: List[State] = []
        self._spots = {BORDER: 0, SEED: 0, GUIDE: 0}
        self._laser_seen = -math.inf
        self._pending_source = ""
        self._sent = False  # whether the pending border is on its way to the map
        self._unanswered_before = False  # `unanswered_save`, as it was then
        self.latch = latch or StopLatch()
        self.history: List[str] = []  # "undo" and "redo", each if the borders have something to undo or redo
        self._record: Optional[Record] = None

    # ------------------------------------------------------------------ the clock and what was seen
    def durations(self, now: float) -> Dict[State, float]:
        """Returns the time [s] per active state up to now; in Default, of the interaction that ended last."""
        result = dict(self._durations)
        if self.state in self._durations and now > self._counted_until:
            result[self.state] += now - self._counted_until
        return result

    def advance(self, now: float) -> None:
        """Counts the time up to now. Time that jumped back is counted from there on, nothing is taken off."""
        self._durations = self.durations(now)
        self._counted_until = now
        self.started, self.entered = min(self.started, now), min(self.entered, now)
        self.last_answered, self._active = min(self.last_answered, now), min(self._active, now)
        if not 0.0 <= now - self.question.asked <= CONFIRM_WITHIN:
            self.question = Question()

    def see_laser(self, now: float) -> None:
        """Stores that a camera saw a spot at a time [s], whatever the state."""
        self._laser_seen = now

    def laser_is_on(self, now: float) -> bool:
        """Returns whether somebody points with the laser."""
        return abs(now - self._laser_seen) <= LASER_ON

    def count_spots(self, border: int, seed: int, others: int, now: float) -> None:
        """Stores how many spots this interaction has had so far: for the border, for the seed, and for neither."""
        spots = {BORDER: border, SEED: seed, GUIDE: others}
        if spots != self._spots:
            # the person draws, points or guides
            self._spots, self._active = spots, now

    @property
    def unseen(self) -> bool:
        """Returns whether the person should have drawn or pointed by now, and no spot was seen."""
        return (
            bool(self.state.collects)
            and not self.pending
            and not self._spots[self.state]
            and self._counted_until >= self.entered + UNSEEN_AFTER
        )

    @property
    def ends_at(self) -> float:
        """[s] when the interaction ends by itself if nothing happens; 0 if not soon, paused, or if there is none."""
        if not self.state.robots_act or self.pending:
            return 0.0
        ends = self._active + self._params.idle_timeout
        return ends if self._counted_until >= ends - min(_WARNED_BEFORE, self._params.idle_timeout / 2.0) else 0.0

    def end_if_idle(self, now: float) -> bool:
        """Ends an interaction abandoned for too long; returns whether it did."""
        self.advance(now)
        if not self.ends_at or now < self.ends_at:
            return False
        self._end(UNANSWERED if self.unanswered_save else ABANDONED, "")
        minutes = f"{self._params.idle_timeout / 60.0:g}"
        self._answered(CANCEL, "timeout", Answer(False, "abandoned", {"minutes": minutes}))
        return True

    def take_record(self) -> Optional[Record]:
        """Returns the record of an interaction that has just ended, once; None if there is none."""
        record, self._record = self._record, None
        return record

    def missing(self) -> List[str]:
        """Lists the parts of a border that the person has not begun yet: "border", "seed"."""
        return [state.collects for state in (BORDER, SEED) if state not in self._visited]

    # ------------------------------------------------------------------ inside
    def _begin(self) -> None:
        self.interaction_id = uuid.uuid4().hex[:8]
        self.started = self.entered = self._active = self._counted_until
        self._durations = {state: 0.0 for state in self._durations}
        self._sources, self._visited = [], []
        self._spots = {state: 0 for state in self._spots}
        self.unanswered_save = False

    def _end(self, outcome: str, border_id: str) -> None:
        durations = self._durations
        self._record = Record(
            interaction_id=self.interaction_id,
            outcome=outcome,
            border_id=border_id,
            started=self.started,
            ended=self._counted_until,
            guide_s=durations[GUIDE],
            border_s=durations[BORDER],
            seed_s=durations[SEED],
            total_s=sum(durations.values()),
            sources=tuple(self._sources),
        )
        self.state = DEFAULT
        self.interaction_id = ""
        self.pending = ""
        self.question = Question()
        self.unanswered_save = False
        self.started, self.entered = 0.0, self._counted_until
        self._visited = []
        self.last_outcome, self.last_border_id = outcome, border_id

    def _note(self, source: str) -> None:
        if source and source not in self._sources:
            self._sources.append(source)

    def _answered(self, name: str, source: str, answer: Answer) -> Answer:
        self.last_command, self.last_source, self.last_answer = name, source, answer
        self.last_answered = self._counted_until
        return answer
