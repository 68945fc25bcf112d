"""Marking corners on a camera's picture, before a lab is started."""

import asyncio
import json
from types import SimpleNamespace

from tornado.httpclient import AsyncHTTPClient

from vb_bringup import try_camera
from vb_core.child_processes import free_port


def test_corners_without_a_picture_get_the_reason(monkeypatch):
    camera = SimpleNamespace(start=lambda: None, close=lambda: None)
    monkeypatch.setattr(try_camera, "CameraSource", lambda *_: camera)
    rectangle = json.dumps({"corners": [[0, 0], [9, 0], [9, 9], [0, 9]], "width": 1.0, "depth": 1.0})

    async def judge(port):
        page = asyncio.ensure_future(try_camera.CornerPage("/dev/video0").ask(port))
        answer = await AsyncHTTPClient().fetch(f"http://127.0.0.1:{port}/floor", method="POST", body=rectangle)
        page.cancel()
        return json.loads(answer.body)

    assert asyncio.run(judge(free_port())) == {"error": "The camera is being opened."}
