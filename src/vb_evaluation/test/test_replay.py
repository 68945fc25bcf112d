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
from vb_core.grid_map import GridMap
from vb_core.ros.cameras import info_from_camera
from vb_core.ros.images import image_message
from vb_core.ros import messages
from vb_evaluation.kit import bags, perception, replay, session
from vb_evaluation.kit.__main__ import main
from vb_evaluation.kit.recording import Recording
from vb_fusion.collector import CollectorParams, Spot
from vb_map_integration.border import VirtualBorder
from vb_map_integration.integration import integrate
from vb_map_integration.recording import Recording as MapRecording
from vb_msgs.msg import InteractionState, LaserSpot
from vb_voice_wizard.interaction import Interaction
from vb_voice_wizard.persistence import append_line, record_line

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


def drawn_events(rows):
    """The events of one interaction "one" that draws rows; Seed begins with the last 25 of them."""
    seed_from = rows[-25, 0] - 0.01
    found = [replay.StateChange("border", "one", START)]
    for stamp, x, y in rows:
        if (
            stamp > seed_from
            and found[-1] is not None
            and all(getattr(event, "state", "") != "seed" for event in found)
        ):
            found.append(replay.StateChange("seed", "one", seed_from))
        found.append(Spot(float(stamp), float(x), float(y), "green"))
    return found + [replay.StateChange("default", "", rows[-1, 0] + 0.3, "saved")]


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
        machine.finish_save("b1", end)
    else:
        machine.command("cancel", "wizard", end)
    append_line(str(folder / "interactions.jsonl"), record_line(machine.take_record(), "nrs", ["green"]))
    return Recording(folder)


# ------------------------------------------------------------------ events
def test_todays_code_makes_the_recorded_border_of_the_recorded_spots(tmp_path):
    rows = stroke()
    recording = make_recording(tmp_path, rows)
    truth = integrate(free_floor(), VirtualBorder(SQUARE, SQUARE.mean(axis=0), closed=True)).region
    (found,) = replay.compare(recording, drawn_events(rows), truths={"one": truth})
    assert (found.code, found.outcome, found.spots) == ("ok", "saved", len(rows))
    assert found.agreement > 0.93 and found.chain_distance_m < 0.1
    assert found.recorded == 1.0 and found.today == found.agreement


def test_what_cannot_be_replayed_says_why(tmp_path):
    rows = stroke()
    recording = make_recording(tmp_path, rows)
    (found,) = replay.compare(recording, [])
    assert found.code == "not_recorded" and math.isnan(found.agreement)
    (found,) = replay.compare(recording, [event for event in drawn_events(rows) if not isinstance(event, Spot)])
    assert found.code != "ok" and found.message and found.spots == 0
    cancelled = make_recording(tmp_path / "cancelled", rows, saved=False)
    (found,) = replay.compare(cancelled, drawn_events(rows))
    assert (found.outcome, found.code) == ("cancelled", "ok") and math.isnan(found.agreement)


def test_an_interaction_cut_off_by_the_end_of_the_bag_keeps_its_spots():
    rows = stroke()
    found = replay.collections(drawn_events(rows)[:-1], CollectorParams())
    assert found["one"].border_total + found["one"].seed_total == len(rows)


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


def write_bag(folder, rows, images):
    """A bag as the recorder writes it: states, spots, map, and images of one ceiling camera."""
    (folder / "bags").mkdir(parents=True)
    random = np.random.default_rng(2)
    with rosbag.Bag(str(folder / "bags" / "01.bag"), "w", compression="lz4") as bag:
        early = rospy.Time.from_sec(START - 1.0)
        bag.write("/map", messages.message_from_grid(free_floor(), early), early)
        bag.write(
            "/tf_static", TFMessage([messages.transform_message(POSE, "map", "green_optical_frame", early)]), early
        )
        bag.write("/green/camera_info", info_from_camera(CAMERA, early, "green_optical_frame"), early)
        entries = [(START - 1.0 + number / 25.0, None) for number in range(25)] + [(row[0], row) for row in rows]
        for event in drawn_events(rows):
            if isinstance(event, replay.StateChange):
                message = InteractionState(
                    state={"default": 0, "border": 1, "seed": 2}[event.state],
                    name=event.state,
                    interaction_id=event.interaction_id,
                    entered=rospy.Time.from_sec(event.entered),
                )
                bag.write("/virtual_borders/state", message, rospy.Time.from_sec(event.entered))
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
                    image_message(picture(random, pixel), "mono8", time, "green_optical_frame"),
                    time,
                )
            if row is not None:
                spot = LaserSpot(camera="green", position=Point(row[1], row[2], 0.0), confidence=0.9)
                spot.header.stamp = time
                bag.write("/virtual_borders/spots", spot, time + rospy.Duration(0.01))
    (folder / "session.yaml").write_text(yaml.safe_dump({"cameras": ["green"], "robots": [], "images": "raw"}))


def test_a_bag_gives_its_events_back(tmp_path):
    rows = stroke()
    make_recording(tmp_path, rows)
    write_bag(tmp_path, rows, images=False)
    recording = Recording(tmp_path)
    (found,) = replay.compare(recording, bags.events(recording), bags.todays_settings(), bags.physical_map(recording))
    assert found.code == "ok" and found.spots == len(rows) and found.agreement > 0.93
    with pytest.raises(CodedError) as caught:
        perception.events(recording, ["green"], [])
    assert "record_images" in str(caught.value)


def test_images_go_through_todays_detector(tmp_path, capsys):
    rows = stroke(per_side=12)
    make_recording(tmp_path, rows)
    write_bag(tmp_path, rows, images=True)
    recording = Recording(tmp_path)
    events, counts = perception.events(recording, ["green"], [])
    capsys.readouterr()
    assert counts["green"].images == len(rows) + 25 and counts["green"].recorded == len(rows)
    assert counts["green"].today > 0.9 * len(rows)
    spots = {round(event.stamp, 4): (event.x, event.y) for event in events if isinstance(event, Spot)}
    errors = [
        math.hypot(spots[stamp][0] - x, spots[stamp][1] - y) for stamp, x, y in np.round(rows, 4) if stamp in spots
    ]
    assert len(errors) > 0.9 * len(rows) and np.median(errors) < 0.01
    (found,) = replay.compare(recording, events, bags.todays_settings())
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
                image_message(depth, "16UC1", time, "camera_optical_frame"),
                time,
            )
            bag.write(
                "/camera/rgb/image_raw", image_message(image, "bgr8", time, "camera_optical_frame"), time
            )
            # the pose comes after the image, as odometry does
            moved = messages.transform_message(pose, "map", "camera_optical_frame", time)
            bag.write("/tf", TFMessage([moved]), time + rospy.Duration(0.03))
    events, counts = perception.events(Recording(tmp_path), [], [""])
    spots = np.array([(event.x, event.y) for event in events])
    assert counts["robot"].images == 20 and counts["robot"].today >= 15
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
        list(bags.events(Recording(tmp_path)))
    assert "record:=" in str(caught.value)
    (tmp_path / "bags").mkdir()
    (tmp_path / "bags" / "01.bag").write_text("#ROSBAG V2.0\nrest is lost")
    with pytest.raises(CodedError) as caught:
        list(bags.events(Recording(tmp_path)))
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
