"""Replays: of events, and of bags with images, written here without a master."""

import argparse
import math

import numpy as np
import pytest
import rosbag
import rospy
import yaml
from geometry_msgs.msg import Point
from tf2_msgs.msg import TFMessage

from vb_core import geometry
from vb_core.camera_model import CameraModel
from vb_core.errors import CodedError
from vb_core.files import append_line
from vb_core.grid_map import GridMap
from vb_core.ros.cameras import info_from_camera
from vb_core.ros.images import message_from_image
from vb_core.ros import messages
from vb_evaluation.study_kit import replay, session
from vb_evaluation.study_kit.__main__ import main
from vb_evaluation.study_kit.recording import Recording
from vb_evaluation.virtual_ros.graph import Graph, Node
from vb_evaluation.virtual_ros.scheduler import Scheduler
from vb_map_integration.border import VirtualBorder
from vb_map_integration.integration import integrate
from vb_map_integration.storage.recording import MapRecording
from vb_msgs.msg import InteractionState, LaserSpot
from vb_voice_wizard.interaction import Interaction
from vb_voice_wizard.session import Answer
from vb_voice_wizard.dialogue.persistence import record_line

# the messages themselves call it when a bag is written
pytestmark = pytest.mark.filterwarnings("ignore:tostring")

SQUARE = np.array([[0.8, 0.6], [2.2, 0.6], [2.2, 1.6], [0.8, 1.6]])
START = 1000.0


def free_floor():
    cells = np.full((60, 80), 100, np.int8)
    cells[2:-2, 2:-2] = 0
    return GridMap(cells, 0.05)


def stroke(per_side=40, noise=0.004):
    """(N, 3) time [s], x, y [m]: along the square at 25 images a second, then, 0.6 s later, 1 s at its middle."""
    random = np.random.default_rng(5)
    corners = np.vstack([SQUARE, SQUARE[:1]])
    points = np.vstack(
        [np.linspace(a, b, per_side, endpoint=False) for a, b in zip(corners[:-1], corners[1:])] + [corners[:1]]
    )
    points = np.vstack([points, np.tile(SQUARE.mean(axis=0), (25, 1))])
    stamps = START + 0.5 + np.arange(len(points)) / 25.0
    # "define seed" is said in between, and the pointer moved: nobody jumps from one image to the next
    stamps[-25:] += 0.6
    return np.column_stack([stamps, points + random.normal(0.0, noise, points.shape)])


def states(rows, ended=True):
    """(time [s], state) of one interaction "one" that draws rows; Seed begins with the last 25 of them."""
    return [(START, "border"), (rows[-25, 0] - 0.01, "seed")] + ([(rows[-1, 0] + 0.3, "default")] if ended else [])


def make_recording(folder, rows, saved=True):
    """A recording whose border was the square itself, written by the system's own code."""
    grid = free_floor()
    machine = Interaction(new_id=lambda: "one")
    machine.command("define_border", "wizard", START)
    machine.command("define_seed", "wizard", rows[-25, 0] - 0.01)
    maps = MapRecording(folder / "recordings")
    maps.record(grid, [], START - 5.0, {})
    end = rows[-1, 0] + 0.3
    if saved:
        border = VirtualBorder(SQUARE, SQUARE.mean(axis=0), closed=True, id="b1")
        maps.record(integrate(grid, border).posterior, [border], end, {})
        machine.command("save", "wizard", end)
        machine.finish(Answer(True, "saved"), end, "b1")
    else:
        machine.command("cancel", "wizard", end)
    append_line(folder / "interactions.jsonl", record_line(machine.take_record(), "nrs", ["green"]))
    return Recording(folder)


# ------------------------------------------------------------------ bags
CAMERA = CameraModel(480, 360, np.array([[330.0, 0, 240], [0, 330.0, 180], [0, 0, 1]]), np.zeros(5))
POSE = geometry.transform(
    np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]]) @ np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), (1.5, 1.1, 2.9)
)


def picture(random, spot=None):
    """(360, 480) uint8: floor with noise, and a spot."""
    image = random.normal(90.0, 2.0, (360, 480))
    if spot is not None:
        rows, columns = np.mgrid[:360, :480]
        image += 260.0 * np.exp(-((columns - spot[0]) ** 2 + (rows - spot[1]) ** 2) / (2 * 1.8**2))
    return np.clip(image, 0, 255).astype(np.uint8)


def write_bag(folder, rows, images, ended=True, outcome="saved"):
    """A bag as the recorder writes it: states, spots, map, and images of one ceiling camera."""
    (folder / "bags").mkdir(parents=True)
    random = np.random.default_rng(2)
    with rosbag.Bag(str(folder / "bags" / "01.bag"), "w", compression="lz4") as bag:
        early = rospy.Time.from_sec(START - 1.0)
        bag.write("/map", messages.message_from_grid(free_floor(), early), early)
        bag.write(
            "/tf_static", TFMessage([messages.message_from_transform(POSE, "map", "green_optical_frame", early)]), early
        )
        bag.write("/green/camera_info", info_from_camera(CAMERA, early, "green_optical_frame"), early)
        entries = [(START - 1.0 + number / 25.0, None) for number in range(25)] + [(row[0], row) for row in rows]
        for stamp, state in states(rows, ended):
            entered = rospy.Time.from_sec(stamp)
            message = InteractionState(
                state={"default": 0, "border": 1, "seed": 2}[state],
                name=state,
                interaction_id="" if state == "default" else "one",
                entered=entered,
                last_outcome=outcome if state == "default" else "",
            )
            bag.write("/virtual_borders/state", message, entered)
        for stamp, row in entries:
            time = rospy.Time.from_sec(stamp)
            if images:
                pixel = (
                    None
                    if row is None
                    else CAMERA.project(geometry.apply(geometry.invert(POSE), np.array([[row[1], row[2], 0.0]])))[0]
                )
                bag.write(
                    "/green/image_raw",
                    message_from_image(picture(random, pixel), "mono8", time, "green_optical_frame"),
                    time,
                )
            if row is not None:
                spot = LaserSpot(camera="green", position=Point(row[1], row[2], 0.0), confidence=0.9)
                spot.header.stamp, spot.header.frame_id = time, "map"
                bag.write("/virtual_borders/spots", spot, time + rospy.Duration(0.01))
    (folder / "session.yaml").write_text(yaml.safe_dump({"cameras": ["green"], "robots": [], "images": "raw"}))


def test_todays_nodes_make_the_recorded_border_of_the_recorded_spots(tmp_path):
    rows = stroke()
    make_recording(tmp_path, rows)
    write_bag(tmp_path, rows, images=False)
    recording = Recording(tmp_path)
    truth = integrate(free_floor(), VirtualBorder(SQUARE, SQUARE.mean(axis=0), closed=True)).region
    today = replay.replay(recording)
    (found,) = replay.compare(recording, today, replay.physical_map(recording), truth)
    assert (found.code, found.outcome, found.spots) == ("ok", "saved", len(rows))
    assert found.agreement > 0.93 and found.chain_distance_m < 0.1
    assert found.recorded == 1.0 and found.today == found.agreement and not today.cameras
    with pytest.raises(CodedError) as caught:
        replay.replay(recording, images=True)
    assert "record_images" in str(caught.value)


def test_a_cancelled_interaction_and_one_that_the_bag_cuts_off(tmp_path):
    rows = stroke(per_side=25)
    make_recording(tmp_path / "cancelled", rows, saved=False)
    write_bag(tmp_path / "cancelled", rows, images=False, outcome="cancelled")
    cancelled = Recording(tmp_path / "cancelled")
    (found,) = replay.compare(cancelled, replay.replay(cancelled))
    assert (found.outcome, found.code, found.spots) == ("cancelled", "ok", len(rows)) and math.isnan(found.agreement)
    make_recording(tmp_path / "cut", rows)
    write_bag(tmp_path / "cut", rows, images=False, ended=False)
    cut = Recording(tmp_path / "cut")
    today = replay.replay(cut)
    assert today.spots == {"one": len(rows)} and replay.compare(cut, today)[0].code == "ok"


def test_what_cannot_be_replayed_says_why(tmp_path):
    rows = stroke(per_side=10)
    recording = make_recording(tmp_path, rows)
    (found,) = replay.compare(recording, replay.ReplayResult())
    assert found.code == "not_recorded" and math.isnan(found.agreement) and found.spots == 0
    write_bag(tmp_path, rows[-26:], images=False)
    recording = Recording(tmp_path)
    (found,) = replay.compare(recording, replay.replay(recording))
    assert found.code not in ("ok", "not_recorded") and found.message and found.spots <= 26


def test_another_definition_of_a_message_is_reported(tmp_path):
    rows = stroke(per_side=10)
    make_recording(tmp_path, rows)
    write_bag(tmp_path, rows, images=False)
    recording = Recording(tmp_path)
    graph = Graph(Scheduler(0), {})
    with graph.installed():
        graph.start(Node("/listener", {}), lambda: rospy.Subscriber("/virtual_borders/spots", LaserSpot))
        graph.scheduler.run(lambda: False, 10)
        entry = next(entry for entry in replay.read_messages(recording) if entry.topic == "/virtual_borders/spots")
        with pytest.raises(CodedError, match="another definition"):
            graph.play(entry.topic, entry.kind, "0" * 32, entry.data)


def test_images_go_through_todays_detector(tmp_path, capsys):
    rows = stroke(per_side=12)
    make_recording(tmp_path, rows)
    write_bag(tmp_path, rows, images=True)
    recording = Recording(tmp_path)
    today = replay.replay(recording, images=True)
    capsys.readouterr()
    count = today.cameras["green"]
    assert count.images == len(rows) + 25 and count.recorded == len(rows) and count.today > 0.9 * len(rows)
    spots = {round(spot.header.stamp.to_sec(), 4): (spot.position.x, spot.position.y) for spot in today.found}
    errors = [
        math.hypot(spots[stamp][0] - x, spots[stamp][1] - y) for stamp, x, y in np.round(rows, 4) if stamp in spots
    ]
    assert len(errors) > 0.9 * len(rows) and np.median(errors) < 0.01
    (found,) = replay.compare(recording, today)
    assert found.code == "ok" and found.agreement > 0.9


def robot_pose(stamp):
    """(4, 4) T_map_camera of a camera 0.7 m high that looks down and ahead, on a robot that drives along x."""
    down = math.radians(40.0)
    forward = np.array([math.cos(down), 0.0, -math.sin(down)])
    right = np.array([0.0, -1.0, 0.0])
    return geometry.transform(
        np.column_stack([right, np.cross(forward, right), forward]), (0.3 + 0.1 * (stamp - START), 1.0, 0.7)
    )


def test_images_of_a_robot_use_its_pose_and_depth_at_their_time(tmp_path):
    color = CameraModel(320, 240, np.array([[260.0, 0, 160], [0, 260.0, 120], [0, 0, 1]]), np.zeros(5))
    small = color.scaled_to(160, 120)
    columns, lines = np.meshgrid(np.arange(160), np.arange(120))
    rays = small.rays(np.column_stack([columns.ravel(), lines.ravel()]).astype(float))
    random, spot = np.random.default_rng(3), np.array([1.25, 1.0, 0.0])
    (tmp_path / "bags").mkdir()
    with rosbag.Bag(str(tmp_path / "bags" / "01.bag"), "w") as bag:
        first = rospy.Time.from_sec(START)
        bag.write("/map", messages.message_from_grid(free_floor(), first), first)
        for topic, model in (("/camera/rgb/camera_info", color), ("/camera/depth_registered/camera_info", small)):
            bag.write(topic, info_from_camera(model, first, "camera_optical_frame"), first)
        for number in range(20):
            stamp = START + 0.1 + number / 20.0
            time = rospy.Time.from_sec(stamp)
            pose = robot_pose(stamp)
            directions = rays @ pose[:3, :3].T
            depth = np.round(1000.0 * -pose[2, 3] / directions[:, 2]).reshape(120, 160).astype(np.uint16)
            pixel = color.project(geometry.apply(geometry.invert(pose), spot[None]))[0]
            rows, across = np.mgrid[:240, :320]
            light = np.exp(-((across - pixel[0]) ** 2 + (rows - pixel[1]) ** 2) / (2 * 2.0**2))
            image = random.normal(90.0, 2.0, (240, 320, 3)) + light[..., None] * np.array([90.0, 70.0, 400.0])
            image = np.clip(image, 0, 255).astype(np.uint8)
            bag.write(
                "/camera/depth_registered/image_raw",
                message_from_image(depth, "16UC1", time, "camera_optical_frame"),
                time,
            )
            bag.write("/camera/rgb/image_raw", message_from_image(image, "bgr8", time, "camera_optical_frame"), time)
            # the pose comes after the image, as odometry does
            moved = messages.message_from_transform(pose, "map", "camera_optical_frame", time)
            bag.write("/tf", TFMessage([moved]), time + rospy.Duration(0.03))
    today = replay.replay(Recording(tmp_path), images=True)
    spots = np.array([(found.position.x, found.position.y) for found in today.found])
    assert today.cameras["robot"].images == 20 and today.cameras["robot"].today >= 15
    assert np.abs(spots - spot[:2]).max() < 0.02


def test_the_command_replays(tmp_path, capsys):
    rows = stroke()
    make_recording(tmp_path, rows)
    write_bag(tmp_path, rows, images=False)
    assert main(["replay", str(tmp_path), "--out", str(tmp_path / "comparison.csv")]) == 0
    assert f"{len(rows)} spots" in capsys.readouterr().out
    assert len((tmp_path / "comparison.csv").read_text().splitlines()) == 2
    assert main(["replay", str(tmp_path), "--images"]) == 2 and "no images" in capsys.readouterr().err


def test_a_recording_without_bag_or_with_a_damaged_one(tmp_path):
    make_recording(tmp_path, stroke())
    with pytest.raises(CodedError) as caught:
        list(replay.read_messages(Recording(tmp_path)))
    assert "record:=" in str(caught.value)
    (tmp_path / "bags").mkdir()
    (tmp_path / "bags" / "01.bag").write_text("#ROSBAG V2.0\nrest is lost")
    with pytest.raises(CodedError) as caught:
        list(replay.read_messages(Recording(tmp_path)))
    assert "01.bag" in str(caught.value)


# ------------------------------------------------------------------ what is recorded
def test_topics():
    plain = session.topics(["red", "green"], [""], "none")
    assert {"/map", "/tf_static", "/virtual_borders/spots", "/red/camera_info", "/odom"} <= set(plain)
    assert not [topic for topic in plain if "image" in topic]
    compressed = session.topics(["red"], ["anna", "bert"], "compressed", ["/extra"])
    assert {
        "/red/image_raw/compressed",
        "/anna/camera/rgb/image_raw/compressed",
        "/bert/camera/depth_registered/image_raw",
        "/extra",
    } <= set(compressed)
    assert "/odom" not in compressed and "/camera/rgb/image_raw" in session.topics([], [""], "raw")


def test_a_restarted_recorder_takes_the_next_file(tmp_path):
    assert session.next_bag(tmp_path).name == "01.bag"
    (tmp_path / "bags" / "01.bag").touch()
    (tmp_path / "bags" / "02.bag.active").touch()
    assert session.next_bag(tmp_path).name == "03.bag"


def test_session_says_revision_and_plan(tmp_path, monkeypatch):
    monkeypatch.setattr(session.rospy, "get_param", lambda name: {"use_sim_time": True})
    given = argparse.Namespace(method="robot_only", cameras="", robots="", images="none")
    (tmp_path / "run.yaml").write_text("order: 4\nparticipant: p03\nscenario: carpet\n")
    session._describe(tmp_path, given)
    found = yaml.safe_load((tmp_path / "session.yaml").read_text())
    assert found["run"] == {"order": 4, "participant": "p03", "scenario": "carpet"}
    assert found["revision"] and found["method"] == "robot_only" and found["cameras"] == []
