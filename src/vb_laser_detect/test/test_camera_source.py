"""A video file that is read as a camera: what becomes of images for which the computer is too slow."""

import threading
import time

import av
import numpy as np
import pytest

from vb_laser_detect.camera.source import CameraSource, CaptureParams

RATE, FRAMES, KEY_EVERY = 25, 250, 25


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    """H.264 whose images stand by themselves once a second; each is as bright as its number."""
    path = tmp_path_factory.mktemp("video") / "count.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream(
            "libx264", rate=RATE, options={"g": str(KEY_EVERY), "tune": "zerolatency", "qp": "4", "sc_threshold": "0"}
        )
        stream.width, stream.height, stream.pix_fmt = 64, 64, "yuv420p"
        for number in range(FRAMES):
            frame = av.VideoFrame.from_ndarray(np.full((64, 64, 3), number, np.uint8), format="bgr24")
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def numbers(video, pause_s, count):
    """Returns which images of the video a reader gets that takes so long for each, and how many were left out."""
    seen, enough = [], threading.Event()

    def handle(shot):
        if len(seen) < count:
            seen.append(float(shot.decoded.mean()))
            time.sleep(pause_s)
        else:
            enough.set()

    source = CameraSource(str(video), CaptureParams(), handle, lambda error: None).start()
    assert enough.wait(60.0)
    source.close()
    return np.array(seen), source.late


def test_a_computer_that_keeps_up_gets_every_image(video):
    seen, late = numbers(video, 0.0, 40)
    assert late == 0 and np.abs(seen - np.arange(40)).max() < 6.0


def test_images_that_come_too_late_are_left_out_until_one_stands_by_itself(video):
    # five times too slow: without leaving any out, the 30th image to be seen would be the video's 30th
    seen, late = numbers(video, 0.2, 30)
    assert late > 50 and seen[-1] > 100
    # what is seen after a gap is whole: it has the brightness of an image that needs no other one
    after = np.flatnonzero(np.diff(seen) > 3.0) + 1
    assert len(after) and np.abs((seen[after] + KEY_EVERY / 2) % KEY_EVERY - KEY_EVERY / 2).max() < 4.0
