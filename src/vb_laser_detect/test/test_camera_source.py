"""A camera's images: how far they are decoded, and what becomes of those for which the computer is too slow."""

import threading
import time

import av
import cv2
import numpy as np
import pytest

from scenes import Scene

from vb_core.errors import CodedError
from vb_laser_detect.camera.source import CameraSource, CaptureParams, Shot

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
            seen.append(float(shot.picture().pixels.mean()))
            time.sleep(pause_s)
        else:
            enough.set()

    source = CameraSource(str(video), CaptureParams(), handle, lambda error: None)
    source.start()
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


def test_a_fault_of_the_program_is_told_and_the_camera_is_opened_again(video):
    told, again = [], threading.Event()

    def handle(shot):
        if len(told) < 2:  # "images come", then the fault
            raise KeyError("a bug")
        again.set()

    source = CameraSource(str(video), CaptureParams(), handle, lambda error: told.append(error and error.code))
    source.start()
    assert again.wait(60.0)
    source.close()
    assert told[:3] == [None, "internal_error", None]


@pytest.mark.parametrize(
    "size, half_size, binning", [((1920, 1080), True, 2), ((1441, 1080), True, 1), ((1280, 720), False, 1)]
)
@pytest.mark.parametrize("jpeg", [True, False])
def test_images_are_searched_at_half_their_size_in_the_same_place(size, half_size, binning, jpeg):
    image = Scene(*size, noise=0.0).render([(201.0, 152.0)], sigma=4.0)
    if jpeg:
        shot = Shot(0.0, jpeg=cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes())
    else:
        shot = Shot(0.0, frame=av.VideoFrame.from_ndarray(image, format="bgr24"))
    picture, found = shot.searched(half_size)
    assert found == binning and picture.pixels.shape == (size[1] // binning, size[0] // binning, 3)
    assert shot.picture().pixels.shape == image.shape
    seen = binning * (middle_of_spot(picture.pixels) + 0.5) - 0.5
    assert np.abs(seen - middle_of_spot(image)).max() < 0.2


def middle_of_spot(image):
    light = np.maximum(image[..., 2].astype(float) - 200.0, 0.0)
    light[:, image.shape[1] // 2 :] = 0.0
    rows, columns = np.indices(light.shape)
    return np.array([(light * columns).sum(), (light * rows).sum()]) / light.sum()


def test_half_a_jpeg_is_no_image():
    jpeg = cv2.imencode(".jpg", np.zeros((1080, 1920, 3), np.uint8))[1].tobytes()
    for broken in (jpeg[:100], b"none"):
        with pytest.raises(CodedError) as error:
            Shot(0.0, jpeg=broken).searched(False)
        assert error.value.code == "bad_image"
