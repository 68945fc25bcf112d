"""A network camera that can fail: motion JPEG over HTTP, as phones and cheap cameras send it."""

import contextlib
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer


class Server(ThreadingHTTPServer):
    request_queue_size = 64


class MjpegServer:
    """Serves JPEG images in turn, at a rate, to every client, from the first one on, or from image N for /video?N."""

    def __init__(self, jpegs, rate=25.0, port=0):
        self.jpegs, self.rate = jpegs, rate  # both may be changed at any time
        self.status = 200  # HTTP status of each answer; unless it is 200, no images follow
        self.stalled = threading.Event()  # while set, connections stay open and nothing is sent
        self.broken = threading.Event()  # while set, connections are closed at once
        self.closed = threading.Event()
        self.sent = []  # [s] when images were sent
        camera = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self):
                self.send_response(camera.status)
                self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
                self.end_headers()
                with contextlib.suppress(OSError):  # the client has closed the connection
                    camera.send_images(self.wfile, int(self.path.partition("?")[2] or 0))

            def log_message(self, *_):
                pass

        self.server = Server(("127.0.0.1", port), Handler)
        self.port = self.server.server_address[1]
        threading.Thread(target=self.server.serve_forever, daemon=True).start()

    def address(self, path="video"):
        return f"http://127.0.0.1:{self.port}/{path}"

    def send_images(self, stream, number):
        """Sends images to a client, from this number on, until it or this camera closes the connection."""
        due = time.monotonic()
        while self.status == 200 and not self.broken.is_set() and not self.closed.is_set():
            if not self.stalled.is_set():
                jpeg = self.jpegs[number % len(self.jpegs)]
                head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n".encode()
                self.sent.append(time.time())
                stream.write(head + jpeg + b"\r\n")
                number += 1
            due += 1.0 / self.rate
            self.closed.wait(max(0.0, due - time.monotonic()))

    def close(self):
        self.closed.set()
        self.server.shutdown()
        self.server.server_close()
