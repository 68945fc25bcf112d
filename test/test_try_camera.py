"""Marking corners on a camera's picture, before a lab is started."""

import asyncio
import json
from types import SimpleNamespace

import pytest
from tornado.httpclient import AsyncHTTPClient

from vb_bringup import try_camera
from vb_core.child_processes import free_port

OPENING = b'{"error": "The camera is being opened."}'


@pytest.mark.parametrize("origin, status, reason", [("127.0.0.1:{}", 200, OPENING), ("evil.example", 403, None)])
def test_corners_without_a_picture_get_the_reason_and_other_sites_nothing(monkeypatch, origin, status, reason):
    camera = SimpleNamespace(start=lambda: None, close=lambda: None)
    monkeypatch.setattr(try_camera, "CameraSource", lambda *_: camera)
    rectangle = json.dumps({"corners": [[0, 0], [9, 0], [9, 9], [0, 9]], "width": 1.0, "depth": 1.0})

    async def judge(port):
        page = asyncio.ensure_future(try_camera.CornerPage("/dev/video0").ask(port))
        headers = {"Origin": "http://" + origin.format(port)}
        options = {"method": "POST", "body": rectangle, "headers": headers, "raise_error": False}
        answer = await AsyncHTTPClient().fetch(f"http://127.0.0.1:{port}/floor", **options)
        page.cancel()
        return answer

    answer = asyncio.run(judge(free_port()))
    assert answer.code == status
    assert reason in (None, answer.body)
