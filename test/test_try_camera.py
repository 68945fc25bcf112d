"""Marking corners on a camera's picture, before a lab is started."""

import asyncio
import json
from types import SimpleNamespace

import pytest
from tornado.httpclient import AsyncHTTPClient

from vb_bringup import try_camera
from vb_core.child_processes import free_port

RECTANGLE = json.dumps({"corners": [[0, 0], [9, 0], [9, 9], [0, 9]], "width": 1.0, "depth": 1.0})


@pytest.fixture
def ask(monkeypatch):
    """Sends a rectangle to the page as one of this origin does, and returns the answer's status and body."""
    camera = SimpleNamespace(start=lambda: None, close=lambda: None)
    monkeypatch.setattr(try_camera, "CameraSource", lambda *_: camera)
    port = free_port()

    async def send(origin, host):
        page = asyncio.ensure_future(try_camera.CornerPage("/dev/video0").ask(port))
        headers = {"Origin": origin.format(port), "Host": host.format(port)}
        options = {"method": "POST", "body": RECTANGLE, "headers": headers, "raise_error": False}
        answer = await AsyncHTTPClient().fetch(f"http://127.0.0.1:{port}/floor", **options)
        page.cancel()
        return answer.code, answer.body

    return lambda origin, host: asyncio.run(send(origin, host))


def test_corners_without_a_picture_get_the_reason(ask):
    status, body = ask("http://127.0.0.1:{}", "127.0.0.1:{}")
    assert (status, json.loads(body)) == (200, {"error": "The camera is being opened."})


@pytest.mark.parametrize("host", ["127.0.0.1:{}", "evil.example"])
def test_other_sites_cannot_send_corners(ask, host):
    assert ask("http://evil.example", host)[0] == 403
