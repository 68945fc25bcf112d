"""Every message, parameter and file is taken or refused with a code: examples are drawn from the inputs' own schemas.

There is no list of attacks. The strategy for a message follows from its definition (genpy's slots), for a parameter
class from its fields, and for a file from the bytes of a good one, some of them changed. So the examples cover new
fields without being told. FUZZ_EXAMPLES sets their number per test: few in `make test`, thousands before a release.
"""

import dataclasses
import functools
import importlib
import os

import cv2
import genmsg.msgs
import numpy as np
import pytest
import rospy
import yaml
from geometry_msgs.msg import Pose, Transform
from hypothesis import HealthCheck, given, settings, strategies as st
from nav_msgs.msg import OccupancyGrid
from roslib.message import get_message_class
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from vb_core.errors import CodedError, ParameterError
from vb_core.grid_map import GridMap
from vb_core.map_files import read_map, write_map
from vb_core.parameters import Parameters
from vb_core.robot_profile import RobotProfile
from vb_core.ros import images, messages
from vb_laser_detect.calibration import pose_file
from vb_map_integration import border_messages
from vb_map_integration.border import borders_from_geojson, borders_to_geojson
from vb_msgs.msg import VirtualBorder
from vb_sim.world import load_world

from examples import ANYTHING
from integrators import square
from vb_testing import TOP

EXAMPLES = int(os.environ.get("FUZZ_EXAMPLES", "25"))


def bounded(share=1.0):
    """Returns the settings of one test; `share` scales the number of examples, for slow or fast tests."""
    return settings(max_examples=max(3, int(EXAMPLES * share)), database=None, suppress_health_check=list(HealthCheck))


# ---------------------------------------------------------------------- strategies from schemas
SCALARS = {
    "bool": st.booleans(),
    "string": st.text(max_size=20),
    "time": st.builds(rospy.Time, st.integers(0, 2**32 - 1)),
    "duration": st.builds(rospy.Duration, st.integers(-(2**31), 2**31 - 1)),
    "float32": st.floats(width=32),
    "float64": st.floats(),
    "char": st.integers(0, 255),
    "byte": st.integers(-128, 127),
    **{f"int{bits}": st.integers(-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) for bits in (8, 16, 32, 64)},
    **{f"uint{bits}": st.one_of(st.integers(0, 9), st.integers(0, 2**bits - 1)) for bits in (8, 16, 32, 64)},
}


def field(kind):
    """Makes a strategy for a field of a message, by its type's name."""
    base, is_array, length = genmsg.msgs.parse_type(kind)
    if is_array:
        if base in ("uint8", "char"):
            return st.binary(min_size=length or 0, max_size=length or 60)
        return st.lists(field(base), min_size=length or 0, max_size=length or 5)
    return SCALARS[base] if base in SCALARS else message(get_message_class(base))


def message(cls):
    """Makes a strategy for a message, by its definition."""
    # the old type "Header" stands for std_msgs/Header
    kinds = ["std_msgs/Header" if kind == "Header" else kind for kind in cls._slot_types]
    return st.builds(cls, **{name: field(kind) for name, kind in zip(cls.__slots__, kinds)})


def damaged(good):
    """Makes a strategy for a file's bytes: truncated, bytes changed, pieces inserted."""
    change = st.tuples(st.integers(0, max(len(good) - 1, 0)), st.integers(0, 12), st.binary(max_size=12))

    def apply(changes, end):
        data = bytearray(good[:end])
        for at, length, piece in changes:
            data[at : at + length] = piece
        return bytes(data)

    return st.builds(apply, st.lists(change, min_size=1, max_size=6), st.integers(0, len(good)) | st.just(len(good)))


def check_taken(read, given_input):
    """Checks that an input is taken, or refused with a code."""
    try:
        read(given_input)
    except CodedError as error:
        assert error.code


# ---------------------------------------------------------------------- messages
PICTURE = np.arange(300, dtype=np.uint8).reshape(10, 10, 3)
ENCODED = [cv2.imencode(ending, PICTURE)[1].tobytes() for ending in (".png", ".jpg")]
SIZES = {"height": st.integers(0, 5), "width": st.integers(0, 5), "step": st.integers(0, 60)}
ENCODINGS = st.sampled_from(["mono8", "bgr8", "bayer_rggb8", "16UC1", "32FC1", "rgba16"])
IMAGES = st.builds(Image, encoding=ENCODINGS, data=st.binary(max_size=160), is_bigendian=st.booleans(), **SIZES)
KNOWN_COMPRESSIONS = st.builds(CompressedImage, data=damaged(ENCODED[0]) | damaged(ENCODED[1]))
CONVERSIONS = {
    "map": (messages.grid_from_message, message(OccupancyGrid)),
    "pose": (messages.pose2d_from_message, message(Pose)),
    "transform": (messages.transform_from_message, message(Transform)),
    "image": (images.array_from_image, message(Image) | IMAGES),
    "compressed image": (images.array_from_compressed_image, message(CompressedImage) | KNOWN_COMPRESSIONS),
    "camera": (images.camera_from_info, message(CameraInfo)),
    "border": (border_messages.border_from_message, message(VirtualBorder)),
}


@pytest.mark.parametrize("convert, examples", CONVERSIONS.values(), ids=CONVERSIONS)
@bounded()
@given(st.data())
def test_messages_are_taken_or_refused_with_a_code(convert, examples, data):
    check_taken(convert, data.draw(examples))


# ---------------------------------------------------------------------- parameters
@functools.lru_cache(None)
def parameter_classes():
    """Finds every parameter class of the lab's packages; the study's do not read the parameter server."""
    for path in sorted(TOP.glob("src/vb_*/src/vb_*/**/*.py")):
        if "(Parameters)" in path.read_text(encoding="utf-8"):
            importlib.import_module(".".join(path.relative_to(TOP / "src").with_suffix("").parts[2:]))
    ours = [cls for cls in Parameters.__subclasses__() if cls.__module__.startswith("vb_")]  # not those of tests
    classes = [cls for cls in ours if not cls.__module__.startswith("vb_evaluation.")]
    assert len(classes) > 30
    return sorted(classes, key=lambda cls: (cls.__module__, cls.__name__))


@pytest.mark.filterwarnings("ignore")
@bounded(4.0)
@given(st.data())
def test_parameters_are_taken_or_refused_with_their_key(data):
    cls = data.draw(st.sampled_from(parameter_classes()))
    names = [field.name for field in dataclasses.fields(cls)]
    mapping = data.draw(st.dictionaries(st.sampled_from(names) | st.text(max_size=5), ANYTHING, max_size=3))
    try:
        parameters = cls.from_mapping(mapping, "/node")
    except ParameterError as error:
        assert error.key.startswith("/node")
    else:
        assert isinstance(parameters.describe(), str)
        assert set(mapping) <= set(names)


# ---------------------------------------------------------------------- files
BORDERS = [square(20, 20, id="b1", name="rug"), square(60, 60, id="b2", zone="slow", max_speed=0.2)]
POSE = b"camera: red\nframe: map\nchild_frame: red_optical_frame\n"
POSE += b"position: [1.0, 2.0, 2.5]\norientation: [1.0, 0.0, 0.0, 0.0]\n"


def read_borders(path):
    return borders_from_geojson(path.read_text(encoding="utf-8", errors="replace"))


READERS = {
    "borders.geojson": (read_borders, borders_to_geojson(BORDERS).encode()),
    "world.yaml": (lambda path: load_world(str(path)), (TOP / "src/vb_sim/worlds/lab.yaml").read_bytes()),
    "robot.yaml": (RobotProfile.load, (TOP / "robots/turtlebot2.yaml").read_bytes()),
    "camera.yaml": (pose_file.read_pose, POSE),
}


@pytest.mark.parametrize("name", READERS)
@bounded()
@given(st.data())
def test_files_are_taken_or_refused_with_a_code(name, tmp_path, data):
    read, good = READERS[name]
    written = ANYTHING.map(lambda value: yaml.safe_dump(value, allow_unicode=False).encode())
    (tmp_path / name).write_bytes(data.draw(damaged(good) | written))
    check_taken(read, tmp_path / name)


@bounded()
@given(st.data())
def test_map_files_are_read_or_refused_as_bad_map_files(tmp_path, data):
    cells = np.random.default_rng(1).choice(np.array([-1, 0, 100], np.int8), (12, 9))
    files = write_map(tmp_path / "map", GridMap(cells, 0.05))
    for path in files:
        content = path.read_bytes()
        path.write_bytes(data.draw(st.just(content) | damaged(content)))
    try:
        assert read_map(files[1]).data.size
    except CodedError as error:
        assert error.code == "bad_map_file"
