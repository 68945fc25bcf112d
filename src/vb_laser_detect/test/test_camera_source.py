"""A camera's images: which are decoded, and which are left out because the computer is too slow or they are damaged."""

import contextlib
import errno
import re
import socketserver
import struct
import threading
import time
from fractions import Fraction
from unittest.mock import Mock

import av
import cv2
import numpy as np
import pytest

from refusals import refused
from vb_testing import wait_until
from vb_laser_detect.camera import camera_source as camera_source
from vb_laser_detect.camera.camera_source import CameraSource, CapturedImage, without_password
from vb_laser_detect.camera.v4l2_controls import CaptureParams
from vb_laser_detect.detection.spot_detector import SpotDetector

RATE, FRAMES, KEY_EVERY = 25, 250, 25
SDP = "v=0\r\no=- 0 0 IN IP4 127.0.0.1\r\ns=-\r\nt=0 0\r\nm=video 0 RTP/AVP 96\r\na=rtpmap:96 H264/90000\r\n"


@pytest.fixture(scope="module")
def packets():
    """Returns H.264 packets with a key frame every KEY_EVERY images; each image's brightness is its number."""
    codec = av.CodecContext.create("libx264", "w")
    codec.width, codec.height, codec.pix_fmt = 64, 64, "yuv420p"
    codec.framerate, codec.time_base = RATE, Fraction(1, RATE)
    codec.options = {"g": str(KEY_EVERY), "tune": "zerolatency", "qp": "4", "sc_threshold": "0"}
    encoded = []
    for number in range(FRAMES):
        frame = av.VideoFrame.from_ndarray(np.full((64, 64, 3), number, np.uint8), format="bgr24")
        frame.pts = number
        encoded += codec.encode(frame)
    return encoded + codec.encode(None)


@pytest.fixture
def film(packets, tmp_path):
    return write_film(tmp_path / "count.mp4", packets)


def write_film(path, packets, damaged=()):
    """Writes a film; packets whose number is in `damaged` lack their beginning."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=RATE)
        stream.width, stream.height, stream.pix_fmt = 64, 64, "yuv420p"
        for number, content in enumerate(packets):
            packet = av.Packet(bytes(content)[:4] + bytes(content)[20:] if number in damaged else bytes(content))
            packet.stream, packet.is_keyframe = stream, content.is_keyframe
            packet.time_base = Fraction(1, RATE)
            packet.pts = packet.dts = number
            container.mux(packet)
    return str(path)


@pytest.fixture
def camera(packets):
    """Yields the address of a network camera that sends its images when they are due, even if the reader is late."""

    class Rtsp(socketserver.StreamRequestHandler):
        def handle(self):
            with contextlib.suppress(OSError):  # the client has closed the connection
                self.serve()

        def serve(self):
            for line in self.rfile:
                method = line.split(b" ")[0].decode()
                fields = dict(line.decode().split(": ", 1) for line in iter(self.rfile.readline, b"\r\n"))
                body = SDP if method == "DESCRIBE" else ""
                head = f"RTSP/1.0 200 OK\r\nCSeq: {fields['CSeq'].strip()}\r\nSession: 1\r\nContent-Type: application/sdp\r\n"
                head += f"Transport: {fields.get('Transport', '').strip()}\r\nContent-Length: {len(body)}\r\n\r\n"
                self.wfile.write((head + body).encode())
                if method == "PLAY":
                    break
            began, count = time.monotonic(), 0
            for number, packet in enumerate(packets):
                time.sleep(max(0.0, began + number / RATE - time.monotonic()))
                units = re.split(b"\0*\0\0\1", bytes(packet))[1:]
                for unit in units:  # each in one RTP packet, interleaved in the RTSP connection
                    rtp = struct.pack(">BBHII", 0x80, 96 | (unit is units[-1]) << 7, count, number * 90000 // RATE, 1)
                    self.wfile.write(struct.pack(">cBH", b"$", 0, len(rtp + unit)) + rtp + unit)
                    count += 1

    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), Rtsp) as server:
        server.daemon_threads, server.block_on_close = True, False
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"rtsp://127.0.0.1:{server.server_address[1]}/video"
        server.shutdown()


def reading(address, handle, report=print):
    """Reads a camera for the duration of the `with` block, to whose `as` it is bound."""
    source = CameraSource(address, CaptureParams(), handle, report)
    source.start()
    return contextlib.closing(source)


def read_slowly(address, pause_s, count):
    """Returns brightness and times of the images that reach a reader with pauses, and why others were left out."""
    images, skipped_codes, is_over = [], [], threading.Event()

    def handle(image):
        brightness = float(image.picture().pixels.mean())
        if len(images) < count and (not images or brightness > images[-1][0] - 6.0):  # else the film has begun again
            images.append((brightness, image.stamp))
            skipped_codes.extend(image.skipped_codes)
            time.sleep(pause_s)
        else:
            is_over.set()

    with reading(address, handle):
        wait_until(is_over.is_set, "the last image")
    return (*np.array(images).T, skipped_codes)


@pytest.mark.parametrize("pause_s", [0.0, 0.2])
def test_a_file_is_read_without_leaving_images_out(film, pause_s):
    brightness, taken, skipped_codes = read_slowly(film, pause_s, 30)
    assert not skipped_codes and np.abs(brightness - np.arange(30)).max() < 6.0
    # no closer than in the film, and at the end no more than a second behind the clock
    assert np.diff(taken).min() > 1 / RATE - 1e-6
    assert taken[-1] - taken[0] > 29 * max(1 / RATE, pause_s) - 1.0 - 1e-6


def test_late_network_images_are_left_out_until_a_key_frame(camera):
    # the reader is at least five times too slow: if none were left out, the last number seen would be their count
    numbers, _, skipped_codes = read_slowly(camera, 0.2, 30)  # an image's brightness is its number
    assert len(skipped_codes) > 50 and set(skipped_codes) == {"late_image"}
    assert numbers[-1] > 3 * len(numbers)
    # the first image after a gap is complete: it has the brightness of a key frame
    after_gap = numbers[1:][np.diff(numbers) > 3.0]
    assert len(after_gap) and np.abs((after_gap + KEY_EVERY / 2) % KEY_EVERY - KEY_EVERY / 2).max() < 4.0


def test_images_are_left_out_from_a_damaged_one_to_the_next_key_frame(packets, tmp_path, monkeypatch):
    monkeypatch.setattr(camera_source, "_STALL_TIMEOUT", 60.0)  # for busy computers
    numbers, _, skipped_codes = read_slowly(write_film(tmp_path / "damaged.mp4", packets, damaged=(5,)), 0.0, 20)
    assert skipped_codes == ["bad_image"] * (KEY_EVERY - 5)
    assert np.abs(numbers - [*range(5), *range(KEY_EVERY, KEY_EVERY + 15)]).max() < 6.0


def first_reports(address, handle):
    """Returns the first three codes that a camera's reader reports, or None when images come."""
    codes = []
    with reading(address, handle, lambda error: codes.append(error and error.code)):
        wait_until(lambda: len(codes) > 2, lambda: f"a third report after {codes}")
    return codes[:3]


def test_a_camera_without_a_whole_image_for_long_is_opened_again(packets, tmp_path, monkeypatch):
    monkeypatch.setattr(camera_source, "_STALL_TIMEOUT", 0.4)
    film = write_film(tmp_path / "damaged.mp4", packets, damaged=(5,))
    assert first_reports(film, lambda image: None) == [None, "camera_stalled", None]


def test_internal_error_is_reported_and_the_camera_reopened(film):
    assert first_reports(film, Mock(side_effect=KeyError("a bug"))) == [None, "internal_error", None]


def test_a_new_delay_counts_from_the_next_image_on(film):
    taken = []

    def handle(image):
        taken.append(image.stamp)
        source.params = CaptureParams(delay_ms=5000.0 * (len(taken) > 2))

    with reading(film, handle) as source:
        wait_until(lambda: len(taken) > 4, "five images")
    assert (np.diff(taken[:5]) > 0.0).tolist() == [True, True, False, True]


@pytest.mark.parametrize(
    "address, shown",
    [
        ("rtsp://cam.lab:554/video?channel=1", "rtsp://cam.lab:554/video?channel=1"),
        ("rtsp://user:secret@cam.lab/a@b", "rtsp://cam.lab/a@b"),
        ("rtsp://user:secr@et@cam.lab/", "rtsp://cam.lab/"),
        ("rtsp://cam.lab/user=admin&password=secret&channel=1", "rtsp://cam.lab/user=admin&password=***&channel=1"),
        ("http://cam.lab/video?usr=admin&PWD=secret", "http://cam.lab/video?usr=admin&PWD=***"),
        ("/dev/video0", "/dev/video0"),
    ],
)
def test_no_password_is_shown(address, shown):
    assert without_password(address) == shown


def test_a_device_without_motion_jpeg_is_read_in_its_own_format_and_the_usual_size(tmp_path, monkeypatch):
    (tmp_path / "yuyv").write_bytes(bytes([90, 128]) * (1280 * 720 * 3))
    open_file, images = av.open, []

    def open_device(address, format, container_options):
        av.error.err_check(-errno.EINVAL if "input_format" in container_options else 0)
        options = {"pixel_format": "yuyv422", "video_size": container_options["video_size"]}
        return open_file(str(tmp_path / "yuyv"), format="rawvideo", options=options)

    monkeypatch.setattr(av, "open", open_device)
    with reading("/dev/video0", lambda image: images.append(image.picture().pixels)):
        wait_until(lambda: len(images) > 2, "three images")
    assert images[2].shape == (720, 1280, 3)
    assert abs(images[2].mean() - 86.0) < 1.0  # black is 16, white 235


@pytest.mark.parametrize(
    "number, code",
    [
        (errno.EBUSY, "camera_busy"),
        (errno.ENODEV, "camera_unplugged"),
        (errno.EACCES, "camera_forbidden"),
        (errno.EINVAL, "camera_fault"),
    ],
)
def test_why_a_device_cannot_be_opened_is_reported(number, code, monkeypatch):
    monkeypatch.setattr(av, "open", lambda *_, **__: av.error.err_check(-number))
    with refused(code):
        CameraSource("/dev/video0", CaptureParams(), print, print)._read()


def test_half_a_jpeg_is_no_image():
    jpeg = cv2.imencode(".jpg", np.zeros((1080, 1920, 3), np.uint8))[1].tobytes()
    for broken in (jpeg[:100], b"none"):
        with refused("bad_image"):
            SpotDetector().detect(CapturedImage(0.0, jpeg=broken).picture(), 0.0)
