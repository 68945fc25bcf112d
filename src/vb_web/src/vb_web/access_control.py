"""Decides who may do what on the page, and how much of it: codes, roles, sessions and slots for connections.

A request is refused unless it proves its rights. On the loopback interface, a loopback name in the Host header is proof
enough. In a network, the proof is the cookie of a session, which nobody gets without a code. Connections are limited:
each role has its own slots, and when all of a role's slots are taken, the client that holds the most gives one up.
"""

from __future__ import annotations

import contextlib
import enum
import hashlib
import json
import secrets
import threading
import time
from collections import Counter
from pathlib import Path
from typing import Any, Callable, Dict, Optional, Tuple

import yaml

from vb_core.errors import CodedError
from vb_core.files import write_atomically

COOKIE = "virtual_borders_page"
COOKIE_DAYS = 30
_ALPHABET = "23456789abcdefghjkmnpqrstuvwxyz"  # without letters and digits that look alike
_CODE_LENGTH = 8  # 40 bits: at 1000 tries a second, finding a code takes 14 years on average
_MAX_SESSIONS = 100  # per code, so that holders of one code cannot log out those of the other


class Role(enum.IntEnum):
    """What a client may do. Each role may also do everything that the lower roles may."""

    NOBODY = 0
    VIEWER = 1  # sees the page
    OPERATOR = 2  # commands, changes borders, sees the cameras' images


def normalize_code(code: str) -> str:
    """Removes case, spaces and dashes from a code as typed."""
    return "".join(letter for letter in code.lower() if letter.isalnum())


def _new_code() -> str:
    letters = "".join(secrets.choice(_ALPHABET) for _ in range(_CODE_LENGTH))
    return f"{letters[:4]}-{letters[4:]}"


def load_access_codes(path: Path) -> Dict[str, str]:
    """Reads the access codes of "viewer" and "operator" from a file that only its owner can read. Creates it if needed.

    Raises CodedError "page_codes_bad" if the file is unusable, "cannot_write" if it cannot be created.
    """
    names = ("viewer", "operator")
    try:
        if not path.exists():
            text = "# The codes of the page; delete this file and restart the page to replace both and log everybody out.\n"
            text += yaml.safe_dump({name: _new_code() for name in names})
            write_atomically(path, text.encode("utf-8"), private=True)
        codes = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, yaml.YAMLError, UnicodeDecodeError) as error:
        raise CodedError("page_codes_bad", file=path, reason=error) from None
    has_both = isinstance(codes, dict) and set(codes) == set(names)
    if not has_both or not all(isinstance(code, str) for code in codes.values()):
        raise CodedError("page_codes_bad", file=path, reason=f"it needs the texts {', '.join(names)}")
    normalized_codes = [normalize_code(code) for code in codes.values()]
    if min(map(len, normalized_codes)) < _CODE_LENGTH:
        raise CodedError("page_codes_bad", file=path, reason=f"codes need {_CODE_LENGTH} letters or digits at least")
    if len(set(normalized_codes)) < len(names):
        raise CodedError("page_codes_bad", file=path, reason="viewer and operator need different codes")
    return codes


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8")).hexdigest()


class Sessions:
    """Opens, finds and ends sessions. A cookie without an entry here is worth nothing. Thread safe.

    Args:
        codes: the codes by role, as `load_access_codes` returns them.
        path: the file of the sessions, beside that of the codes. None keeps them in memory only.
        on_fault: called with the error if the file cannot be written. The sessions in memory stay valid.

    The file contains a digest of each session's cookie, and one of the code that opened it. Therefore changing a code
    ends the sessions that were opened with the old one.
    """

    def __init__(self, codes: Dict[str, str], path: Optional[Path] = None, on_fault: Callable = print) -> None:
        self._path = path
        self._on_fault = on_fault
        self._roles = {_digest(normalize_code(code)): Role[name.upper()] for name, code in codes.items()}
        self._lock = threading.Lock()
        self._open: Dict[str, Tuple[str, float]] = {}  # by session: the digest of its code, the time of opening [s]
        # if the file is damaged, everybody logs in again
        with contextlib.suppress(OSError, ValueError, TypeError, AttributeError):
            if path is not None and path.exists():
                entries = json.loads(path.read_text()).items()
                self._open = {str(name): (str(code), float(opened_at)) for name, (code, opened_at) in entries}

    def open(self, typed: str) -> Optional[str]:
        """Opens a session with a code as typed. Returns the value of its cookie, or None if the code is wrong.

        Only digests are compared, so that the duration of the comparison reveals nothing about the code.
        """
        code = _digest(normalize_code(typed))
        cookie = secrets.token_urlsafe(24)
        if code not in self._roles:
            return None
        previous_sessions = [name for name, (opener, _) in self._open.items() if opener == code]
        surplus_sessions = previous_sessions[: 1 - _MAX_SESSIONS]  # the oldest ones
        self._change({_digest(cookie): (code, time.time())}, surplus_sessions)
        return cookie

    def find(self, cookie: Optional[str]) -> Tuple[Role, str]:
        """Returns the role and the name of the session with this cookie, or (NOBODY, "") if there is no such session."""
        name = _digest(cookie or "")
        code, opened_at = self._open.get(name, ("", 0.0))
        role = self._roles.get(code, Role.NOBODY)
        is_fresh = 0.0 <= time.time() - opened_at < COOKIE_DAYS * 86400
        if role == Role.NOBODY or not is_fresh:
            return Role.NOBODY, ""
        return role, name

    def end(self, name: str) -> None:
        """Ends a session."""
        self._change({}, [name])

    def _change(self, new_entries: Dict[str, Tuple[str, float]], ended: Any) -> None:
        with self._lock:
            entries = {**self._open, **new_entries}
            self._open = {name: entry for name, entry in entries.items() if name not in ended}
            if self._path is not None:
                try:
                    write_atomically(self._path, json.dumps(self._open).encode("ascii"), private=True)
                except CodedError as error:
                    self._on_fault(error)


class ConnectionSlots:
    """A limited number of slots for connections. When all are taken, whoever holds the most gives one up for a newcomer.

    Args:
        size: the number of slots.
        yields: decides if several hold the most. If True, the slot that was unused for the longest time is given up;
            otherwise the newcomer gives up one that it holds, if it is among them.
    """

    def __init__(self, size: int, yields: bool) -> None:
        self._size = size
        self._yields = yields
        self._holders: Dict[Any, Tuple[str, ...]] = {}  # by connection, the one that was unused for longest first

    def release(self, connection: Any) -> None:
        """Gives up a connection's slot, if it has one."""
        self._holders.pop(connection, None)

    def assign_slot(self, connection: Any, *holders: str) -> Optional[Any]:
        """Gives a connection a slot. Returns the connection that must be closed for it, which may be the same one.

        Args:
            connection: any object with a method `closed()`. A closed connection gives up its slot.
            holders: who holds the connection, for instance an address and a session. The one with more slots counts.
        """
        self.release(connection)
        self._holders[connection] = holders
        if len(self._holders) > self._size:
            self._holders = {peer: names for peer, names in self._holders.items() if not peer.closed()}
        if len(self._holders) <= self._size:
            return None
        counts = Counter(holder for names in self._holders.values() for holder in names)
        shares = {peer: max(counts[holder] for holder in names) for peer, names in self._holders.items()}
        largest = [peer for peer, share in shares.items() if share == max(shares.values())]
        own = [peer for peer in largest if set(self._holders[peer]) & set(holders)]
        candidates = own if own and not self._yields else largest
        displaced = candidates[0]
        self.release(displaced)
        return displaced


def security_headers(secure: bool) -> Dict[str, str]:
    """Returns the headers of every answer. With them, the page loads nothing from other sites, and no frame shows it."""
    policy = (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
        "manifest-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )
    headers = {
        "Content-Security-Policy": policy,
        "X-Content-Type-Options": "nosniff",
        "X-Frame-Options": "DENY",
        "Referrer-Policy": "no-referrer",
        "Cross-Origin-Resource-Policy": "same-origin",
        "Cross-Origin-Opener-Policy": "same-origin",
        "Permissions-Policy": "camera=(), microphone=(), geolocation=()",
    }
    if secure:
        headers["Strict-Transport-Security"] = "max-age=31536000"
    return headers
