"""Which requests are from this computer, and which from the page itself."""

import pytest

from vb_core.request_origin import is_loopback, is_same_origin, may_use_local_page

OWN_HOSTS = ["localhost", "LOCALHOST.", "127.0.0.1", "127.9.9.9", "::1", "[::1]"]
STRANGE_HOSTS = ["localhost.evil.example", "127.0.0.1.evil.example", "192.168.1.2", "0.0.0.0", "", "evil"]


@pytest.mark.parametrize("host", [*OWN_HOSTS, *STRANGE_HOSTS])
def test_this_computer_has_its_own_names_and_no_others(host):
    assert is_loopback(host) is (host in OWN_HOSTS)


# of another scheme, port or host, missing, hiding another host or invalid
STRANGE_ORIGINS = ["https://lab:8420", "http://lab", "http://lab:8421", "http://evil", "null", "", None]
STRANGE_ORIGINS += ["http://lab:8420@evil", "http://["]


@pytest.mark.parametrize("origin", STRANGE_ORIGINS)
def test_only_the_pages_own_origin_counts(origin):
    assert not is_same_origin(origin, "http", "lab:8420")
    assert is_same_origin("http://lab:8420", "http", "lab:8420")
    assert is_same_origin("http://LAB:8420", "http", "lab:8420")


OWN = "http://localhost:8420"


@pytest.mark.parametrize(
    "method, host, origin, may",
    [
        ("GET", "localhost:8420", None, True),
        ("GET", "evil.example:8420", None, False),  # a name of its own for this computer
        ("GET", "", None, False),
        ("POST", "localhost:8420", OWN, True),
        ("POST", "localhost:8420", "http://evil.example", False),
        ("POST", "localhost:8420", None, False),
        ("POST", "evil.example", "http://evil.example", False),
    ],
)
def test_other_sites_may_neither_read_nor_change_a_local_page(method, host, origin, may):
    assert may_use_local_page(method, host, origin) is may
