"""Recordings of a study with people, written as the running system writes them, for the tests of the study kit."""

import tempfile
from pathlib import Path

import cv2
import numpy as np
import rosbag
import rospy

from vb_core import names
from vb_core.files import append_line
from vb_core.grid_map import GridMap
from vb_core.map_files import write_map
from vb_core.ros.messages import message_from_grid
from vb_evaluation.report.study_files import read_sheet
from vb_evaluation.user_study import recording_measures
from vb_map_integration.border import VirtualBorder
from vb_map_integration.border_messages import message_from_border
from vb_map_integration.border_region import compute_region
from vb_msgs.msg import DetectorStatus, VirtualBorderArray
from vb_interaction.command_answers import Answer
from vb_interaction.interaction import Interaction

YELLOW, RED, BLUE = (0, 215, 247), (0, 0, 255), (180, 90, 40)  # (b, g, r)
EXACT = ((0.751, 0.251), (2.249, 1.249))  # the ground truth's corners [m], to the cell
# a room of 4 m x 3 m with walls and a table, unknown outside; 5 cm cells
ROOM = GridMap(np.full((70, 90), -1, np.int8), 0.05, (-0.25, -0.25, 0.0))
ROOM.data[5:65, 5:85] = 100
ROOM.data[7:63, 7:83] = 0
ROOM.data[40:44, 60:64] = 100
TRUTH = np.zeros(ROOM.shape, bool)
TRUTH[10:30, 20:50] = ROOM.data[10:30, 20:50] == 0


def picture_of_room():
    """Returns the room's picture, as an image editor opens it."""
    with tempfile.TemporaryDirectory() as folder:
        write_map(Path(folder) / "map", ROOM)
        return cv2.imread(f"{folder}/map.pgm")


def painted_room(color):
    """Returns the room's picture with the ground truth painted over it in a colour (b, g, r), also over walls."""
    picture = picture_of_room()
    picture[::-1][10:30, 20:50] = color
    return picture


def make_study(folder):
    """Makes the folder of a study with a ground truth of the scenario carpet."""
    (folder / "ground_truth").mkdir(parents=True)
    cv2.imwrite(str(folder / "ground_truth" / "carpet.png"), painted_room(YELLOW))
    return folder


def write_protocol(study, *runs):
    """Writes a study's protocol: "participant,order,method,scenario,recording,completed,note" of each run."""
    columns = "participant,order,method,scenario,recording,completed,note"
    (study / "protocol.csv").write_text("\n".join([columns, *runs]) + "\n")


def measure_study(study, physical=None):
    """Measures a study's runs into its folder out; returns each recording's row of runs.csv, and the warnings."""
    notes = recording_measures.measure_study(study / "protocol.csv", study / "ground_truth", study / "out", physical)
    rows = read_sheet(study / "out" / "runs.csv", ()).to_dict("records")
    return {row["recording"]: row for row in rows}, notes


def write_state(folder, grid, borders, stamp_s, cameras=()):
    """Adds to a recording's bag what the nodes publish: a map with its borders, and the status of some detectors."""
    path, stamp = folder / "bags" / "session.bag", rospy.Time.from_sec(stamp_s)
    path.parent.mkdir(parents=True, exist_ok=True)
    with rosbag.Bag(str(path), "a" if path.exists() else "w") as bag:
        bag.write(names.MAP_WITH_BORDERS, message_from_grid(grid, stamp), stamp)
        message = VirtualBorderArray(borders=[message_from_border(border) for border in borders])
        message.header.stamp = stamp
        bag.write(names.BORDERS, message, stamp)
        for camera, mobile in [*((name, False) for name in cameras), ("robot", True)]:
            bag.write(names.DETECTORS, DetectorStatus(camera=camera, mobile=mobile), stamp)


class RecordedLab:
    """Writes a recording like that of a running system, with the cameras that reported."""

    def __init__(self, folder, cameras=("green",), grid=ROOM):
        self.folder, self.borders, self.grid = folder, [], grid
        write_state(folder, grid, [], 1.0, cameras)
        self.time = 10.0

    def interaction(self, key, low=(1.0, 0.4), high=(2.4, 1.2), seed=None, save=True, method="nrs"):
        """Draws a rectangle; Border takes 8 s, Seed 2 s."""
        machine = Interaction()
        machine.command("define_border", "wizard", self.time)
        machine.interaction_id = key
        machine.command("define_seed", "wizard", self.time + 8.0)
        self.time += 10.0
        if save:
            (x0, y0), (x1, y1) = low, high
            corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
            seed = corners.mean(axis=0) if seed is None else seed
            border = VirtualBorder(corners, seed, closed=True, id=f"b{len(self.borders) + 1}")
            self.borders.append(border)
            cells = np.max([compute_region(self.grid, each).posterior.data for each in self.borders], axis=0)
            write_state(self.folder, self.grid.with_data(cells), self.borders, self.time - 0.1)
            machine.command("save", "wizard", self.time)
            machine.finish_pending(Answer(True, "saved"), self.time, border.id)
        else:
            machine.command("cancel", "wizard", self.time)
        append_line(self.folder / "interactions.jsonl", machine.take_record().to_json(method, ["green"]))
        self.time += 5.0
        return self
