"""Codes, cookies, origins, limits: who gets in."""

import os
import stat

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from vb_core.errors import CodedError
from vb_web import access
from vb_web.access import AccessCodes, Limiter, LoginLimiter, Role

KEYS = AccessCodes("view-er22", "oper-at33", "k" * 64)


def test_keys_are_made_once_and_only_their_owner_can_read_them(tmp_path):
    path = tmp_path / "folder" / "codes.yaml"
    first = access.load_codes(path)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert access.load_codes(path) == first
    assert len({first.viewer, first.operator, first.cookie_key}) == 3
    assert first.role_of(first.operator) == Role.OPERATOR and first.role_of(first.viewer) == Role.VIEWER


@pytest.mark.parametrize(
    "change",
    [
        {"viewer": "short"},
        {"operator": ""},
        {"cookie_key": "k"},
        {"operator": "samesame", "viewer": "same-same"},
        {"more": "x"},
        {"viewer": 12345678},
    ],
)
def test_a_file_of_codes_that_protects_nothing_is_refused(tmp_path, change):
    path = tmp_path / "codes.yaml"
    path.write_text(yaml.safe_dump({**vars(KEYS), **change}))
    path.chmod(0o600)
    with pytest.raises(CodedError) as found:
        access.load_codes(path)
    assert found.value.code == "page_codes_bad"


def test_a_file_of_codes_that_others_can_read_is_refused(tmp_path):
    path = tmp_path / "codes.yaml"
    access.load_codes(path)
    path.chmod(0o644)
    with pytest.raises(CodedError) as found:
        access.load_codes(path)
    assert found.value.code == "page_codes_open"


def test_codes_are_taken_as_people_type_them():
    assert KEYS.role_of(" OPER at 33") == Role.OPERATOR
    assert KEYS.role_of("oper-at3") == Role.NOBODY
    assert KEYS.role_of("") == Role.NOBODY


@pytest.mark.parametrize("role", [Role.VIEWER, Role.OPERATOR])
def test_a_cookie_gives_its_role_and_only_with_the_same_key(role):
    cookie = KEYS.make_cookie(role)
    found, browser = KEYS.read_cookie(cookie)
    assert found == role and browser
    other = AccessCodes(KEYS.viewer, KEYS.operator, "x" * 64)
    assert other.read_cookie(cookie) == (Role.NOBODY, "")


@given(place=st.integers(min_value=0, max_value=200), letter=st.characters(min_codepoint=33, max_codepoint=126))
def test_a_changed_cookie_is_nobodys(place, letter):
    cookie = KEYS.make_cookie(Role.VIEWER)
    place %= len(cookie)
    forged = cookie[:place] + letter + cookie[place + 1 :]
    if forged != cookie:
        assert KEYS.read_cookie(forged)[0] == Role.NOBODY


@given(st.text(max_size=200))
def test_any_other_text_is_no_cookie(text):
    assert KEYS.read_cookie(text) == (Role.NOBODY, "")


@pytest.mark.parametrize(
    "host, expected",
    [
        ("localhost", True),
        ("LOCALHOST.", True),
        ("127.0.0.1", True),
        ("127.9.9.9", True),
        ("::1", True),
        ("[::1]", True),
        ("localhost.evil.example", False),
        ("127.0.0.1.evil.example", False),
        ("192.168.1.2", False),
        ("0.0.0.0", False),
        ("", False),
        ("evil", False),
    ],
)
def test_loopback(host, expected):
    assert access.is_loopback(host) is expected


@pytest.mark.parametrize(
    "origin, expected",
    [
        ("http://lab:8420", True),
        ("http://LAB:8420", True),
        ("https://lab:8420", False),
        ("http://lab", False),
        ("http://lab:8421", False),
        ("http://evil", False),
        ("null", False),
        ("", False),
        (None, False),
        ("http://lab:8420@evil", False),
        ("http://[", False),
    ],
)
def test_only_the_pages_own_origin_counts(origin, expected):
    assert access.same_origin(origin, "http", "lab:8420") is expected


def test_a_limiter_gives_the_burst_and_then_its_rate():
    limiter = Limiter(rate=1.0, burst=3.0)
    assert [limiter.allows("a", 0.0) for _ in range(4)] == [True, True, True, False]
    assert limiter.allows("b", 0.0)
    assert limiter.allows("a", 1.0) and not limiter.allows("a", 1.0)
    # a clock that jumped back gives nothing
    assert not limiter.allows("a", 0.0)


def test_a_limiter_forgets_the_oldest_of_many_keys():
    limiter = Limiter(rate=1.0, burst=1.0)
    for number in range(5000):
        limiter.allows(str(number), 0.0)
    assert len(limiter._buckets) == 1000


def test_codes_cannot_be_tried_fast_from_one_address_nor_from_many():
    logins = LoginLimiter()
    assert sum(logins.allows("a", 0.0) for _ in range(50)) == 5
    assert sum(logins.allows(str(number), 0.0) for number in range(500)) < 100


def test_headers_let_nothing_in_from_elsewhere():
    headers = access.security_headers(secure=False)
    assert (
        "default-src 'none'" in headers["Content-Security-Policy"]
        and "unsafe" not in headers["Content-Security-Policy"]
    )
    assert "frame-ancestors 'none'" in headers["Content-Security-Policy"]


def test_files_of_others_cannot_be_overwritten_through_a_link(tmp_path):
    target = tmp_path / "target"
    os.symlink(str(target), str(tmp_path / "codes.yaml"))
    with pytest.raises(CodedError):
        access.load_codes(tmp_path / "codes.yaml")
    assert not target.exists()
