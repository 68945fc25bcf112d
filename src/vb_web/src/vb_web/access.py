"""Decides who may do what on the page: codes, roles, signed cookies, origins and rate limits.

The idea: the page is closed unless the request proves otherwise. On the loopback interface the proof is a loopback name
in the Host header; elsewhere it is a cookie that only the holder of a code gets.
"""

from __future__ import annotations

import enum
import hmac
import ipaddress
import os
import secrets
import stat
from collections import OrderedDict
from dataclasses import dataclass
from pathlib import Path
from typing import Dict, Optional, Tuple
from urllib.parse import urlsplit

import yaml
from tornado.web import create_signed_value, decode_signed_value

from vb_core.errors import CodedError

COOKIE = "virtual_borders_page"
COOKIE_DAYS = 30
# without letters and digits that look alike; 8 of 31 are 40 bits, and `Limiter` allows a few tries a minute
_ALPHABET = "23456789abcdefghjkmnpqrstuvwxyz"
_CODE_LENGTH = 8


class Role(enum.IntEnum):
    """Each role may do what those below it may."""

    NOBODY = 0
    VIEWER = 1  # looks
    OPERATOR = 2  # commands, changes borders, sees the cameras' images


def normalize(code: str) -> str:
    """Drops case, spaces and dashes from a code as typed."""
    return "".join(letter for letter in code.lower() if letter.isalnum())


@dataclass(frozen=True)
class AccessCodes:
    """The secrets of one installation.

    Attributes:
        viewer, operator: the codes that people type.
        cookie_key: signs the cookies; a new one logs everybody out.
    """

    viewer: str
    operator: str
    cookie_key: str

    def role_of(self, code: str) -> Role:
        """Returns the role that a code gives; compares in constant time."""
        typed = normalize(code).encode("utf-8")
        roles = ((self.operator, Role.OPERATOR), (self.viewer, Role.VIEWER))
        found = [role for known, role in roles if hmac.compare_digest(typed, normalize(known).encode("utf-8"))]
        return found[0] if found else Role.NOBODY

    def make_cookie(self, role: Role) -> str:
        """Returns a cookie's value: the role and a name for this browser, signed and dated."""
        return create_signed_value(self.cookie_key, COOKIE, f"{int(role)}:{secrets.token_hex(8)}").decode("ascii")

    def read_cookie(self, value: Optional[str]) -> Tuple[Role, str]:
        """Returns (role, browser's name) of a cookie's value; (NOBODY, "") if it is missing, forged or too old."""
        if not value:
            return Role.NOBODY, ""
        raw = decode_signed_value(self.cookie_key, COOKIE, value, max_age_days=COOKIE_DAYS, min_version=2)
        role, _, browser = (raw or b"").decode("ascii", "replace").partition(":")
        if role not in {str(int(known)) for known in Role}:
            return Role.NOBODY, ""
        return Role(int(role)), browser


def _new_code() -> str:
    letters = "".join(secrets.choice(_ALPHABET) for _ in range(_CODE_LENGTH))
    return f"{letters[:4]}-{letters[4:]}"


def load_codes(path: Path) -> AccessCodes:
    """Reads the codes from a file that only its owner can read; makes the file if there is none.

    Raises:
        CodedError: "page_codes_open" if others can read the file, "page_codes_bad" if it is unusable.
    """
    if not path.exists():
        keys = AccessCodes(_new_code(), _new_code(), secrets.token_hex(32))
        text = "# The codes of the page; delete this file and restart the page to replace all of them.\n"
        text += yaml.safe_dump(vars(keys), sort_keys=True)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with os.fdopen(os.open(str(path), os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
                file.write(text)
        except OSError as error:
            raise CodedError("page_codes_bad", file=path, reason=error) from None
        return keys
    try:
        if stat.S_IMODE(path.stat().st_mode) & 0o077:
            raise CodedError("page_codes_open", file=path)
        found = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, yaml.YAMLError, UnicodeDecodeError) as error:
        raise CodedError("page_codes_bad", file=path, reason=error) from None
    names = ("viewer", "operator", "cookie_key")
    if not isinstance(found, dict) or set(found) != set(names) or not all(isinstance(found[n], str) for n in names):
        raise CodedError("page_codes_bad", file=path, reason=f"it needs the texts {', '.join(names)}")
    keys = AccessCodes(**found)
    if min(len(normalize(keys.viewer)), len(normalize(keys.operator))) < _CODE_LENGTH or len(keys.cookie_key) < 32:
        reason = f"codes need {_CODE_LENGTH} letters or digits at least, the cookie_key 32"
        raise CodedError("page_codes_bad", file=path, reason=reason)
    if normalize(keys.viewer) == normalize(keys.operator):
        raise CodedError("page_codes_bad", file=path, reason="viewer and operator need different codes")
    return keys


def is_loopback(host: str) -> bool:
    """Returns whether a host's name or address, without a port, means this computer itself."""
    if host.rstrip(".").lower() == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def host_of(header: str) -> str:
    """Returns the host in a Host header, without the port; "" if there is none."""
    try:
        return urlsplit(f"//{header}").hostname or ""
    except ValueError:
        return ""


def same_origin(origin: Optional[str], scheme: str, host: str) -> bool:
    """Returns whether a browser's Origin header is this page's own; a missing one is not.

    Args:
        scheme: "http" or "https", of the request.
        host: the request's Host header, with its port.
    """
    try:
        parts = urlsplit(origin or "")
    except ValueError:
        return False
    return bool(host) and parts.scheme == scheme and parts.netloc.lower() == host.lower()


class Limiter:
    """Token buckets, one for each key: `burst` at once, then `rate` a second. Keeps the newest 1000 keys."""

    def __init__(self, rate: float, burst: float) -> None:
        self._rate, self._burst = rate, burst
        self._buckets: "OrderedDict[str, Tuple[float, float]]" = OrderedDict()

    def allows(self, key: str, now: float) -> bool:
        """Uses up a token at a time [s] of a monotonic clock; returns False if there is none."""
        tokens, then = self._buckets.pop(key, (self._burst, now))
        tokens = min(self._burst, tokens + self._rate * max(0.0, now - then))
        allowed = tokens >= 1.0
        self._buckets[key] = (tokens - 1.0 if allowed else tokens, now)
        while len(self._buckets) > 1000:
            self._buckets.popitem(last=False)
        return allowed


class LoginLimiter:
    """Limits wrong codes: per address, and of all addresses together."""

    def __init__(self) -> None:
        self._each = Limiter(rate=5.0 / 60.0, burst=5.0)
        self._all = Limiter(rate=30.0 / 60.0, burst=60.0)

    def allows(self, address: str, now: float) -> bool:
        """Returns whether a code from this address may be tried at a time [s], and counts the try."""
        return self._each.allows(address, now) and self._all.allows("", now)


def security_headers(secure: bool) -> Dict[str, str]:
    """Returns headers for every answer: nothing from elsewhere runs in the page, and the page runs in no frame."""
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
