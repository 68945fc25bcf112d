"""Recognises requests of this computer's browsers and of a page itself: other sites too can make browsers send some.

A host name of another site may lead to this computer (DNS rebinding). That site could then read what a local page has.
"""

from __future__ import annotations

import ipaddress
from typing import Optional
from urllib.parse import urlsplit


def is_loopback(host: str) -> bool:
    """Returns whether a host's name or address, without a port, means this computer itself."""
    if host.rstrip(".").lower() == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def parse_host(header: str) -> str:
    """Returns the host in a Host header, without the port, or "" if there is none."""
    try:
        return urlsplit(f"//{header}").hostname or ""
    except ValueError:
        return ""


def is_same_origin(origin: Optional[str], scheme: str, host: str) -> bool:
    """Returns whether a browser's Origin header is this page's own. A missing one is not.

    Args:
        scheme: "http" or "https", of the request.
        host: the request's Host header, with its port.
    """
    try:
        parts = urlsplit(origin or "")
    except ValueError:
        return False
    return bool(host) and parts.scheme == scheme and parts.netloc.lower() == host.lower()


def may_use_local_page(method: str, host: str, origin: Optional[str]) -> bool:
    """Returns whether a request came by a name of this computer, and from the page itself unless it only reads.

    Args:
        host, origin: the request's headers; the connection must be from this computer, with http.
    """
    is_local = is_loopback(parse_host(host))
    is_reading = method in ("GET", "HEAD")
    return is_local and (is_reading or is_same_origin(origin, "http", host))
