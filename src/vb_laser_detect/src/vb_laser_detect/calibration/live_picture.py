"""Shows a person at a browser what a camera sees while its lens is calibrated."""

from __future__ import annotations

import http.server
import threading
from typing import Any

import cv2
import numpy as np

from vb_core.request_origin import may_use_local_page

_WIDTH = 960  # [px] of the picture
_PAGE = b"""<!doctype html><title>Lens</title><body style="margin:0;background:#222"><img id=i style="width:100%">
<script>const i=document.getElementById("i");i.onload=i.onerror=()=>setTimeout(()=>i.src="image?"+Date.now(),150);i.src="image"</script>"""


class LivePicture:
    """A page with a changing picture, for browsers on this computer. Its URL is `address`."""

    def __init__(self) -> None:
        self._jpeg = b""
        outer = self

        class Handler(http.server.BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                if not may_use_local_page("GET", self.headers.get("Host", ""), None):
                    self.send_error(403)
                    return
                image = self.path.startswith("/image")
                body = outer._jpeg if image else _PAGE
                self.send_response(200)
                self.send_header("Content-Type", "image/jpeg" if image else "text/html")
                self.send_header("Cache-Control", "no-store")
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, *_: Any) -> None:
                pass

        self._server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.address = f"http://127.0.0.1:{self._server.server_address[1]}/"
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def show(self, image: np.ndarray) -> None:
        """Replaces the picture."""
        small = cv2.resize(image, (_WIDTH, round(image.shape[0] * _WIDTH / image.shape[1])))
        self._jpeg = cv2.imencode(".jpg", small)[1].tobytes()
