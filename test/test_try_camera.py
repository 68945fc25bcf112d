"""Marking corners on a camera's picture, apart from the lab that is started afterwards."""

import asyncio
import json
from types import SimpleNamespace

from tornado.httpclient import AsyncHTTPClient

from vb_bringup import try_camera
from vb_evaluation.child_processes import free_port

RECTANGLE = {"corners": [[100, 100], [500, 100], [500, 400], [100, 400]], "width": 2.0, "depth": 1.5}


def test_corners_marked_before_the_first_picture_are_answered_with_why_there_is_none(monkeypatch):
    camera = SimpleNamespace(start=lambda: None, close=lambda: None, address="/dev/video0")
    monkeypatch.setattr(try_camera, "CameraSource", lambda *_: camera)
    port = free_port()

    async def mark():
        page = asyncio.ensure_future(try_camera.CornerPage("/dev/video0").ask(port))
        url = f"http://127.0.0.1:{port}/floor"
        answer = await AsyncHTTPClient().fetch(url, method="POST", body=json.dumps(RECTANGLE), raise_error=False)
        page.cancel()
        return answer

    assert json.loads(asyncio.run(mark()).body) == {"error": "The camera is being opened."}
