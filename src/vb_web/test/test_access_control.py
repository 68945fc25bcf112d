"""Access: codes, cookies, limits."""

import stat

import pytest
import yaml
from hypothesis import given, strategies as st

from refusals import refused
from vb_web import access_control
from vb_core.rate_limiter import RateLimiter
from vb_web.access_control import COOKIE_DAYS, ConnectionSlots, Role, Sessions, load_access_codes

CODES = {"viewer": "view-er22", "operator": "oper-at33"}


def test_codes_are_made_once_and_private(tmp_path):
    path = tmp_path / "folder" / "codes.yaml"
    first = load_access_codes(path)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert load_access_codes(path) == first
    assert first["viewer"] != first["operator"]


PROTECT_NOTHING = [{"viewer": "short"}, {"operator": ""}, {"operator": "samesame", "viewer": "same-same"}]
PROTECT_NOTHING += [{"more": "x"}, {"viewer": 12345678}]


@pytest.mark.parametrize("change", PROTECT_NOTHING)
def test_a_file_of_codes_that_protects_nothing_is_refused(tmp_path, change):
    path = tmp_path / "codes.yaml"
    path.write_text(yaml.safe_dump({**CODES, **change}))
    path.chmod(0o600)
    with refused("page_codes_bad"):
        load_access_codes(path)


def test_codes_are_accepted_as_people_type_them():
    sessions = Sessions(CODES)
    assert sessions.find(sessions.open(" OPER at 33"))[0] == Role.OPERATOR
    assert sessions.open("oper-at3") is sessions.open("") is None


@pytest.mark.parametrize("role", [Role.VIEWER, Role.OPERATOR])
def test_a_session_has_the_role_of_its_code_until_it_ends(tmp_path, role):
    path = tmp_path / "sessions.json"
    cookie = Sessions(CODES, path).open(CODES[role.name.lower()])
    sessions = Sessions(CODES, path)  # like a restart
    role_found, name = sessions.find(cookie)
    assert role_found == role
    assert name
    assert cookie not in path.read_text()
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    sessions.end(name)
    assert sessions.find(cookie) == Sessions(CODES, path).find(cookie) == (Role.NOBODY, "")


def test_a_new_code_ends_the_sessions_of_the_old_one(tmp_path):
    path = tmp_path / "sessions.json"
    cookies = [Sessions(CODES, path).open(code) for code in CODES.values()]
    changed = Sessions({**CODES, "operator": "new-code55"}, path)
    assert [changed.find(cookie)[0] for cookie in cookies] == [Role.VIEWER, Role.NOBODY]


def test_sessions_expire_and_end_with_a_damaged_file(tmp_path, monkeypatch):
    path = tmp_path / "sessions.json"
    cookie = Sessions(CODES, path).open(CODES["viewer"])
    monkeypatch.setattr(access_control.time, "time", lambda: path.stat().st_mtime + COOKIE_DAYS * 86400 + 60)
    assert Sessions(CODES, path).find(cookie)[0] == Role.NOBODY
    monkeypatch.undo()
    path.write_text(path.read_text()[:-5])
    assert Sessions(CODES, path).find(cookie)[0] == Role.NOBODY


def test_a_disk_that_cannot_be_written_keeps_nobody_out(tmp_path):
    (tmp_path / "file").write_text("")
    errors = []
    sessions = Sessions(CODES, tmp_path / "file" / "sessions.json", lambda error: errors.append(error.code))
    role, name = sessions.find(sessions.open(CODES["operator"]))
    sessions.end(name)
    assert role == Role.OPERATOR
    assert errors == ["cannot_write"] * 2


def test_many_viewers_log_no_operator_out():
    sessions = Sessions(CODES)
    operator, *viewers = [sessions.open(code) for code in (CODES["operator"], *[CODES["viewer"]] * 300)]
    assert sessions.find(operator)[0] == Role.OPERATOR
    assert [bool(sessions.find(cookie)[0]) for cookie in viewers] == [False] * 200 + [True] * 100


@given(st.text(max_size=200))
def test_any_other_text_is_no_cookie(text):
    sessions = Sessions(CODES)
    sessions.open(CODES["operator"])
    assert sessions.find(text) == sessions.find(None) == (Role.NOBODY, "")


class Connection:
    ended = False

    def closed(self):
        return self.ended


def fill_slots(slots, *holders):
    """Returns connections that took a slot one after another, each for one holder or for several ("address session")."""
    connections = [Connection() for _ in holders]
    for connection, names in zip(connections, holders):
        displaced = slots.assign_slot(connection, *names.split())
        if displaced is not None:
            displaced.ended = True
    return connections


def test_who_holds_the_most_gives_up_a_slot_for_others():
    connections = fill_slots(ConnectionSlots(10, yields=False), *["attacker"] * 60, "phone", "wall", "attacker")
    assert [connection.ended for connection in connections] == [True] * 53 + [False] * 10


@pytest.mark.parametrize("holders", [[f"address s{n}" for n in range(30)], [f"a{n} session" for n in range(30)]])
def test_sessions_and_addresses_of_one_person_count_as_one(holders):
    connections = fill_slots(ConnectionSlots(10, yields=False), "phone one", *holders, "wall two")
    assert [connections[index].ended for index in (0, -1)] == [False, False]


@pytest.mark.parametrize("yields, ended", [(True, [True] * 2 + [False] * 10), (False, [False] * 10 + [True] * 2)])
def test_strangers_replace_each_other_but_known_people_stay(yields, ended):
    connections = fill_slots(ConnectionSlots(10, yields), *[f"a{number}" for number in range(12)])
    assert [connection.ended for connection in connections] == ended


def test_a_released_or_closed_slot_is_free():
    slots = ConnectionSlots(2, yields=False)
    first, second = fill_slots(slots, "a", "b")
    first.ended = True
    third = Connection()
    assert slots.assign_slot(third, "c") is None
    slots.release(second)
    assert slots.assign_slot(Connection(), "d") is None
    assert slots.assign_slot(third, "c") is None  # a connection that has a slot keeps it


def test_a_limiter_gives_the_burst_and_then_its_rate():
    limiter = RateLimiter(rate=1.0, burst=3.0)
    assert [limiter.allows("a", 0.0) for _ in range(4)] == [True, True, True, False]
    assert limiter.allows("b", 0.0)
    assert [limiter.allows("a", 1.0) for _ in range(2)] == [True, False]
    # a clock that jumped back allows nothing
    assert not limiter.allows("a", 0.0)


def test_a_limiter_forgets_the_oldest_of_many_keys():
    limiter = RateLimiter(rate=1.0, burst=1.0)
    for number in range(5000):
        limiter.allows(str(number), 0.0)
    assert len(limiter._buckets) == 1000


def test_codes_are_not_written_through_a_link(tmp_path):
    target = tmp_path / "target"
    (tmp_path / "codes.yaml").symlink_to(target)
    load_access_codes(tmp_path / "codes.yaml")
    assert not target.exists()
