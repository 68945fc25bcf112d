"""Conversions with the real message classes, without a master; transforms with tf2's real buffer."""

import io
import math
import subprocess
import sys

import cv2
import numpy as np
import pytest
import rospy
import tf2_ros
from nav_msgs.msg import OccupancyGrid
from sensor_msgs.msg import CompressedImage, Image, RegionOfInterest

from refusals import refused
from vb_testing import assert_fields
from vb_core import geometry
from vb_core.camera_model import CameraModel
from vb_core.grid_map import GridMap
from vb_core.image_format import PixelReader
from vb_core.ros import images, messages, transforms
from vb_msgs.msg import BorderPreview


def bytes_of(message):
    buffer = io.BytesIO()
    message.serialize(buffer)
    return buffer.getvalue()


def test_maps_round_trip_byte_for_byte():
    cells = np.random.default_rng(1).integers(-1, 101, (30, 40)).astype(np.int8)
    grid = GridMap(cells, 0.05, (-1.0, 2.0, 0.3))
    data = bytes_of(messages.message_from_grid(grid, rospy.Time(7)))
    # the generated message class is the reference
    plain = OccupancyGrid().deserialize(data)
    assert bytes_of(plain) == data
    for message in (plain, messages.NumpyOccupancyGrid().deserialize(data)):
        decoded = messages.grid_from_message(message)
        assert decoded.same_geometry(grid)
        assert (decoded.data == cells).all()
        assert_fields(message.header, frame_id="map", stamp=rospy.Time(7))


def test_previews_round_trip_byte_for_byte():
    region = messages.message_from_grid(GridMap(np.full((3, 4), 100, np.int8), 0.05), rospy.Time(7))
    data = bytes_of(messages.NumpyBorderPreview(code="ok", area_m2=2.5, region=region))
    assert bytes_of(BorderPreview().deserialize(data)) == data
    assert (messages.NumpyBorderPreview().deserialize(data).region.data == 100).all()


def test_empty_or_missized_maps_are_refused():
    wide = messages.message_from_grid(GridMap(np.zeros((3, 4), np.int8), 0.1), rospy.Time(0))
    wide.info.width = 5
    for message in (wide, OccupancyGrid()):
        with refused("bad_map"):
            messages.grid_from_message(message)


ENCODINGS = "rgb8 rgba8 bgr8 bgra8 mono8 mono16 rgb16 bgra16 yuv422 bayer_rggb8 bayer_gbrg16".split()
ENCODINGS += "8UC1 8SC3 16SC2 32SC4 32FC1 64FC12".split()
FAULTY = [("encoding", "nonsense"), ("encoding", ""), ("encoding", "64UC1"), ("height", 0), ("height", 60), ("step", 0)]


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("is_bigendian", [0, 1])
def test_images_are_read_as_cv_bridge_reads_them(encoding, is_bigendian):
    bridge = pytest.importorskip("cv_bridge").CvBridge()
    dtype, channels = bridge.encoding_to_dtype_with_channels(encoding)
    row = 8 * channels * np.dtype(dtype).itemsize
    data = np.random.default_rng(5).integers(0, 64, 6 * row).astype(np.uint8).tobytes()
    message = Image(height=6, width=8, encoding=encoding, step=row, is_bigendian=is_bigendian, data=data)
    # with numpy 2, Debian 13's cv_bridge raises for the foreign byte order: it gets the same values in native order
    swapped = np.frombuffer(data, dtype).byteswap().tobytes() if is_bigendian else data
    expected = bridge.imgmsg_to_cv2(Image(height=6, width=8, encoding=encoding, step=row, data=swapped), "passthrough")
    pixels = images.array_from_image(message)
    assert pixels.dtype == expected.dtype.newbyteorder("=")
    assert np.array_equal(pixels, expected)


def test_padding_at_the_end_of_rows_is_ignored():
    pixels = np.arange(2 * 3 * 3, dtype=np.uint8).reshape(2, 3, 3)
    padded = np.pad(pixels.reshape(2, 9), ((0, 0), (0, 5))).tobytes()
    message = Image(height=2, width=3, encoding="bgr8", step=14, data=padded)
    assert (images.array_from_image(message) == pixels).all()


def test_nodes_without_images_do_not_load_opencv():
    code = "import sys; from vb_core.ros import messages, node, parameters, transforms; from vb_core import grid_map;"
    code += "print(sorted({'cv2', 'cv_bridge', 'scipy'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], stdout=subprocess.PIPE, check=True, text=True).stdout == "[]\n"


@pytest.mark.parametrize(
    "kind, shape, color_format",
    [
        ("bgr8; jpeg compressed bgr8", (32, 32, 3), "bgr"),
        ("bayer_rggb8; jpeg compressed bgr8", (32, 32, 3), "bgr"),  # converted by the driver
        ("bayer_rggb8; png compressed ", (32, 32), "bayer_rggb"),
        ("mono8; jpeg compressed ", (32, 32), "mono"),
        ("jpeg", (32, 32), "mono"),
    ],
)
def test_a_compressed_image_s_format_says_whether_it_is_a_mosaic(kind, shape, color_format):
    message = CompressedImage(format=kind, data=cv2.imencode(".png", np.zeros(shape, np.uint8))[1].tobytes())
    assert images.decode(message, PixelReader()).color_format == color_format


@pytest.mark.parametrize("encoding", ["16UC1", "32FC1"])
def test_a_depth_image_is_not_a_picture(encoding):
    with refused("unknown_encoding"):
        PixelReader().read(np.zeros((4, 6), np.uint16), encoding)


@pytest.mark.parametrize("name, value", FAULTY)
def test_images_that_cannot_be_read_are_refused(name, value):
    image = images.message_from_image(np.zeros((6, 8), np.uint8), "mono8", rospy.Time(0), "x")
    setattr(image, name, value)
    with refused("bad_image"):
        images.array_from_image(image)


def test_bytes_that_are_not_a_picture_are_refused():
    with refused("bad_image"):
        images.array_from_compressed_image(CompressedImage(data=b"not a picture"))


def make_info(distortion, fisheye=False):
    """Returns a camera, and its message with a region of interest that is the whole image."""
    camera = CameraModel(640, 480, CameraModel.ideal(640, 480, 577.0).matrix, np.array(distortion), fisheye)
    info = images.info_from_camera(camera, rospy.Time(1), "x")
    info.roi.width, info.roi.height = 640, 480
    return camera, info


@pytest.mark.parametrize("distortion, fisheye", [([0.1, -0.2, 0, 0, 0.01], False), ([-0.02, 0.004, 0, 0], True)])
def test_cameras_round_trip(distortion, fisheye):
    camera, info = make_info(distortion, fisheye)
    decoded = images.camera_from_info(info)
    assert np.allclose(decoded.matrix, camera.matrix)
    assert np.allclose(decoded.distortion, camera.distortion)
    assert decoded.fisheye == fisheye


@pytest.mark.parametrize(
    "values, code",
    [
        ({"roi": RegionOfInterest(width=320, height=480)}, "unsupported_camera"),
        ({"distortion_model": "equidistant", "D": [0.1] * 5}, "bad_camera_info"),
        ({"D": [], "K": [0.0] * 9, "width": 0, "height": 0, "roi": RegionOfInterest()}, "bad_camera_info"),
    ],
    ids=["part of the image", "too many coefficients", "not calibrated"],
)
def test_a_camera_that_cannot_be_used_is_refused(values, code):
    _, info = make_info([0.0] * 5)
    for name, value in values.items():
        setattr(info, name, value)
    with refused(code):
        images.camera_from_info(info)


def test_transforms_round_trip():
    T = geometry.transform_from_pose2d(1.0, -2.0, 2.5)
    T[2, 3] = 0.7
    stamped = messages.message_from_transform(T, "map", "base_link", rospy.Time(2))
    assert np.allclose(messages.transform_from_message(stamped.transform), T)


def test_a_transform_that_is_not_a_number_is_refused():
    stamped = messages.message_from_transform(np.eye(4), "map", "base_link", rospy.Time(2))
    stamped.transform.rotation.x = float("nan")
    with refused("bad_transform"):
        messages.transform_from_message(stamped.transform)


@pytest.mark.parametrize("points", [[[1.0, 2.0], [3.0, -4.0]], np.zeros((0, 2))])
def test_points_round_trip(points):
    assert np.array_equal(messages.array_from_points(messages.points_from_array(np.array(points))), points)


def test_poses_round_trip():
    assert np.allclose(messages.pose2d_from_message(messages.message_from_pose2d(1, 2, 3)), (1, 2, 3))


# ------------------------------------------------------------------ transforms
CAMERA = geometry.make_transform(geometry.rotation_from_rpy(math.pi, 0, 0.3), (1.0, 2.0, 3.0))
LOOP = [("camera", "a"), ("a", "b"), ("b", "a"), ("other", "map")]


@pytest.fixture
def lookup(monkeypatch):
    monkeypatch.setattr(tf2_ros, "TransformListener", lambda buffer: None)
    # a buffer asks for the time, and no node provides it here
    monkeypatch.setattr(rospy, "get_rostime", lambda: rospy.Time(10))
    monkeypatch.setattr(rospy.Time, "now", staticmethod(lambda: rospy.Time(10)))
    monkeypatch.setattr(tf2_ros.Buffer, "__init__", tf2_ros.BufferCore.__init__)
    return transforms.TransformLookup()


def place(lookup, child, T=CAMERA, parent="map", stamp=5, static=True):
    message = messages.message_from_transform(T, parent, child, rospy.Time(stamp))
    (lookup._buffer.set_transform_static if static else lookup._buffer.set_transform)(message, "test")


def test_static_transforms_are_enough_for_a_fixed_camera(lookup):
    place(lookup, "camera")
    assert lookup.lookup("map", "camera", rospy.Time(0), 0.0) == pytest.approx(CAMERA)
    # a later transform on /tf_static replaces it
    place(lookup, "camera", np.eye(4))
    assert lookup.lookup("map", "camera", rospy.Time(0), 0.0) == pytest.approx(np.eye(4))


@pytest.mark.parametrize("placed, words", [([], ["camera", "calibrated"]), (LOOP, ["loop"])], ids=["missing", "a loop"])
def test_unconnected_frames_are_refused_with_a_reason(lookup, placed, words):
    for child, parent in placed:
        place(lookup, child, parent=parent)
    with refused("no_transform") as raised:
        lookup.lookup("map", "camera", rospy.Time(0), 0.0)
    assert all(word in str(raised.value) for word in words)


def test_an_unknown_time_is_refused(lookup):
    place(lookup, "camera", static=False, stamp=5)
    place(lookup, "camera", static=False, stamp=6)
    assert lookup.lookup("map", "camera", rospy.Time(5.5), 0.0) == pytest.approx(CAMERA)
    with refused("no_transform"):
        lookup.lookup("map", "camera", rospy.Time(9), 0.0)


@pytest.mark.parametrize("max_age, expected", [(3.0, pytest.approx((1.0, 2.0, 0.5))), (1.5, None)])
def test_a_frames_pose_on_the_map_expires(lookup, max_age, expected):
    assert lookup.pose_on_map("base", max_age) is None
    pose = geometry.transform_from_pose2d(1.0, 2.0, 0.5)
    place(lookup, "base", pose, stamp=8, static=False)  # it is 10 s now
    assert lookup.pose_on_map("base", max_age) == expected


@pytest.mark.parametrize("x, expected", [(3.0, pytest.approx((3.0, 2.0, 0.5))), (math.inf, None)])
def test_a_fixed_frames_pose_never_expires(lookup, x, expected):
    place(lookup, "fixed", geometry.transform_from_pose2d(x, 2.0, 0.5))
    assert lookup.pose_on_map("fixed", 0.0) == expected
