"""The borders that there are, with a history."""
from __future__ import annotations

import copy
from typing import Dict, Iterable, List, NamedTuple, Optional, Sequence, Tuple

from vb_core.errors import CodedError
from vb_map_integration.border import VirtualBorder


class Entry(NamedTuple):
    """One border's state before or after a change; None where it did not exist."""

    id: str
    before: Optional[VirtualBorder]
    after: Optional[VirtualBorder]


# what one command changed
Change = Tuple[Entry, ...]


class BorderStore:
    """Borders by id, in the order in which they were made, with undo and redo without limit.

    A store never changes: `changed` gives another one. The history holds only what each change touched, so it
    stays small.

    Attributes:
        revision: grows with every change.
        undoable, redoable: what `undoing` and `redoing` go back to, the next one last.
    """

    def __init__(
        self,
        borders: Iterable[VirtualBorder] = (),
        next_number: int = 1,
        revision: int = 0,
        undoable: Sequence[Change] = (),
        redoable: Sequence[Change] = (),
    ) -> None:
        self._borders: Dict[str, VirtualBorder] = {}
        self.undoable: List[Change] = list(undoable)
        self.redoable: List[Change] = list(redoable)
        self._next = next_number
        self.revision = revision
        for border in borders:
            self._put(Entry(border.id, None, border))

    # ------------------------------------------------------------- what there is
    @property
    def borders(self) -> Tuple[VirtualBorder, ...]:
        """All borders, the oldest first."""
        return tuple(self._borders[key] for key in sorted(self._borders, key=_number_of))

    @property
    def next_number(self) -> int:
        """The number in the id that the next border gets. Numbers are never used twice."""
        return self._next

    def __len__(self) -> int:
        return len(self._borders)

    def get(self, border_id: str) -> VirtualBorder:
        """The border of an id.

        Raises:
            CodedError: "unknown_border".
        """
        try:
            return self._borders[border_id]
        except KeyError:
            raise CodedError("unknown_border", f"there is no border with the id '{border_id}'") from None

    # ------------------------------------------------------------- changes
    # each method only prepares a change; `changed` makes it

    def adding(self, border: VirtualBorder, now: float) -> Change:
        """The change that adds a border under a new id; without a name it becomes "border N".

        Raises:
            CodedError: "id_not_empty", "already_expired".
        """
        if border.id:
            text = f"a new border gets its id from the store, this one came with '{border.id}'"
            raise CodedError("id_not_empty", text)
        _check_expiry(border, now)
        key = f"b{self._next}"
        name = border.name or f"border {self._next}"
        return (Entry(key, None, border.replace(id=key, name=name, created=now, modified=now)),)

    def updating(self, border: VirtualBorder, now: float) -> Change:
        """The change that replaces the border of the same id.

        Raises:
            CodedError: "unknown_border", "already_expired".
        """
        before = self.get(border.id)
        _check_expiry(border, now)
        after = border.replace(name=border.name or before.name, created=before.created, modified=now)
        return (Entry(border.id, before, after),)

    def removing(self, border_id: str) -> Change:
        """The change that removes a border; raises CodedError "unknown_border"."""
        return (Entry(border_id, self.get(border_id), None),)

    def enabling(self, border_id: str, enabled: bool, now: float, expires: float = 0.0) -> Change:
        """The change that turns a border on or off, for ever or until `expires`."""
        return self.updating(self.get(border_id).replace(enabled=enabled, expires=expires), now)

    def clearing(self) -> Change:
        """The change that removes all borders; raises CodedError "nothing_to_clear"."""
        if not self._borders:
            raise CodedError("nothing_to_clear", "there are no borders")
        return tuple(Entry(border.id, border, None) for border in self.borders)

    def expiring(self, now: float) -> Change:
        """The change that turns over all borders whose time has come; empty if there are none."""
        return tuple(
            Entry(border.id, border, border.replace(enabled=not border.enabled, expires=0.0, modified=now))
            for border in self.borders
            if 0.0 < border.expires <= now
        )

    def undoing(self) -> Change:
        """The change that takes the last one back; raises CodedError "nothing_to_undo"."""
        if not self.undoable:
            raise CodedError("nothing_to_undo", "there is nothing to undo")
        return tuple(Entry(e.id, e.after, e.before) for e in reversed(self.undoable[-1]))

    def redoing(self) -> Change:
        """The change that makes again what was undone last; raises CodedError "nothing_to_redo"."""
        if not self.redoable:
            raise CodedError("nothing_to_redo", "there is nothing to redo")
        return self.redoable[-1]

    def with_history(self, undoable: Sequence[Change], redoable: Sequence[Change]) -> "BorderStore":
        """The same borders with another history."""
        return BorderStore(self.borders, self._next, self.revision, undoable, redoable)

    def changed(self, change: Change, kind: str = "new") -> "BorderStore":
        """The store after a change; this one stays as it is.

        Args:
            kind: "new" (undone things are forgotten), "undo", "redo", or "quiet" (no place in the history).
        """
        result = copy.copy(self)
        result._borders = dict(self._borders)
        result.undoable, result.redoable = list(self.undoable), list(self.redoable)
        for entry in change:
            result._put(entry)
        if kind == "undo" and self.undoable:
            result.redoable.append(result.undoable.pop())
        elif kind == "redo" and self.redoable:
            result.undoable.append(result.redoable.pop())
        elif kind == "new":
            result.undoable.append(change)
            result.redoable.clear()
        result.revision += 1
        return result

    def _put(self, entry: Entry) -> None:
        if entry.after is None:
            self._borders.pop(entry.id, None)
            return
        self._borders[entry.id] = entry.after
        self._next = max(self._next, _number_of(entry.id) + 1)


def _number_of(border_id: str) -> int:
    """The number in an id that the store gave; the higher, the younger."""
    digits = border_id[1:]
    return int(digits) if border_id[:1] == "b" and digits.isdigit() and len(digits) < 10 else 0


def _check_expiry(border: VirtualBorder, now: float) -> None:
    if 0.0 < border.expires <= now:
        text = f"the border's time is over: it expires at {border.expires:.1f} s, now is {now:.1f} s"
        raise CodedError("already_expired", text)
