"""What a person or an attacker does with the page over https; for page_hostile.py."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import json
import os
import ssl

from tornado.httpclient import HTTPRequest
from tornado.websocket import websocket_connect

ANY = ssl.create_default_context()
ANY.check_hostname, ANY.verify_mode = False, ssl.CERT_NONE


class Page:
    """The page's address, and what a person or an attacker does with it."""

    def __init__(self, port, codes):
        self.port, self.codes = port, codes
        self.origin = f"https://127.0.0.1:{port}"

    async def connect(self, address="127.0.0.1", secure=ANY):
        return await asyncio.open_connection("127.0.0.1", self.port, ssl=secure, local_addr=(address, 0))

    async def ask(self, text, address):
        """Sends a request and returns the connection with the head of its answer, "" if the server hung up."""
        reader, writer = await self.connect(address)
        writer.write(text.encode())
        with contextlib.suppress(asyncio.IncompleteReadError, OSError):
            return reader, writer, (await reader.readuntil(b"\r\n\r\n")).decode()
        return reader, writer, ""

    async def log_in(self, code, address="127.0.0.1"):
        """Returns the answer's status, and the cookie."""
        body = json.dumps({"code": code})
        head = f"POST /session HTTP/1.1\r\nHost: 127.0.0.1:{self.port}\r\nOrigin: {self.origin}\r\n"
        _, writer, answer = await self.ask(f"{head}Content-Length: {len(body)}\r\n\r\n{body}", address)
        writer.close()
        cookie = next((line[12:].split(";")[0] for line in answer.split("\r\n") if line.startswith("Set-Cookie: ")), "")
        return int((answer or "x 0 ").split()[1]), cookie

    async def hold_link(self, cookie, address):
        """Opens a WebSocket and returns its connection; nothing of it is read."""
        key = base64.b64encode(os.urandom(16)).decode()
        upgrade = f"Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: {key}"
        head = f"GET /link HTTP/1.1\r\nHost: 127.0.0.1:{self.port}\r\nOrigin: {self.origin}\r\nCookie: {cookie}"
        return await self.ask(f"{head}\r\n{upgrade}\r\n\r\n", address)

    async def link(self, cookie):
        request = HTTPRequest(
            f"wss://127.0.0.1:{self.port}/link",
            headers={"Origin": self.origin, "Cookie": cookie},
            ssl_options=ANY,
            connect_timeout=5.0,
        )
        return await websocket_connect(request)


async def answer(link, **request):
    """Sends a request and returns its answer."""
    request = {"id": os.urandom(6).hex(), **request}
    await link.write_message(json.dumps(request))
    while True:
        text = await link.read_message()
        if text is None:
            raise OSError("the server hung up")
        found = json.loads(text)
        if found.get("re") == request["id"]:
            return found
