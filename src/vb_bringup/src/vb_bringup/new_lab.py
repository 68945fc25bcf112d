"""Writes a folder for your own lab: the only files that you edit, and keep under version control.

The stack itself stays unchanged, so that a newer version never changes a lab's settings.
"""

from __future__ import annotations

import argparse
import shutil
import sys
from pathlib import Path
from typing import Dict, List, Mapping, Optional

import yaml

from vb_core.errors import CodedError
from vb_core.map_files import read_map
from vb_core.parameters import NAME
from vb_core.robot_profile import find_profile

CREATED, REFUSED = 0, 1

_LAUNCH = """\
<launch>
  <!-- This lab. Start it with:  roslaunch {folder}/lab.launch   and check it with:  rosrun vb_bringup check_lab
       Arguments declared here can also be given at the start, as in  roslaunch {folder}/lab.launch navigation:=move_base
       Any other argument of the stack's lab.launch can be declared too: $(find vb_bringup)/launch/lab.launch explains them. -->
  <arg name="cameras" default="{cameras}"/>
  <arg name="configs" default="{configs}"/>
  <arg name="calibration" default="$(dirname)/calibration"/>
  <arg name="state" default="$(dirname)/state"/>
  <arg name="map" default="{map}"/>
  <arg name="robot" default="{robot}"/>
  <arg name="robot_types" default="$(dirname)/robot.yaml"/>
  <arg name="map_name" default=""/>
  <arg name="navigation" default="none"/>
  <arg name="machines" default=""/>
  <arg name="machines_file" default=""/>
  <arg name="method" default="nrs"/>
  <arg name="record" default=""/>
  <arg name="rviz" default="true" doc="whether the smart display is on this computer"/>
  <arg name="page_port" default="8420" doc="port of the page"/>
  <arg name="page_address" default="127.0.0.1" doc="0.0.0.0: the page is for the whole network, with codes"/>
  <arg name="mqtt" default=""/>
  <arg name="voice" default="false"/>
  <arg name="buttons" default="false"/>
  <arg name="sound" default="false"/>
  <arg name="language" default="en"/>
  <arg name="projector" default=""/>
  <arg name="projector_window" default="false"/>
  <arg name="projector_x" default="0"/>
  <include file="$(dirname)/cameras.launch"/>
  <include file="$(find vb_bringup)/launch/lab.launch" pass_all_args="true"/>
</launch>
"""

_CAMERAS = """\
<launch>
  <!-- Drivers, only for cameras without `source` in detectors/NAME.yaml. For every camera:
       - it needs a topic /NAME/image_raw, a camera_info beside it, and its own frame, NAME_optical_frame: a
         driver's default frame is the same for all cameras and leads to wrong places.
       - raw images, not rectified ones. If you have only image_rect_color, set `image` in detectors/NAME.yaml to it.
       - a RealSense: roslaunch realsense2_camera rs_camera.launch camera:=NAME enable_depth:=false, and in
         detectors/NAME.yaml  image: NAME/color/image_raw
       - a camera that sends a Bayer mosaic: leave it undecoded (image_raw, bayer_rggb8): that is a third of the data. -->
</launch>
"""

_DETECTOR = """\
# Settings of camera '{name}'. They are read after the common file of the stack (vb_laser_detect/config/stationary.yaml,
# which explains every value): write only what you change, for instance
#
# source: /dev/video0                 # the camera itself: a device, rtsp://..., http://... or a file; or, from a driver:
# image: {name}/image_rect_color      # another topic than {name}/image_raw
{content}
"""

_NETWORK = """\
# Source this before roslaunch, on each computer of this lab:  . network.sh
# One computer: keep both lines commented out, so that ROS stays on it. Several: read docs/how-to/protect-the-network.md first.
# export ROS_MASTER_URI=http://ROBOT:11311
# export ROS_IP=ADDRESS_OF_THIS_COMPUTER
"""

_README = """\
# {title}

| file | contents |
|---|---|
| `lab.launch` | cameras, map and robot; all arguments of the stack |
| `cameras.launch` | drivers of cameras that have no `source` |
| `lenses/` | one file per camera: its lens, from calibrate_camera |
| `calibration/` | one file per camera: its pose, from calibrate_camera |
| `detectors/` | one file per camera: its source, exposure and delay, and its spot detector's settings |
| `map.yaml` | the map, with its image beside it |
| `robot.yaml` | the robot: its size, speeds, scanner |
| `network.sh` | addresses, if there are several computers |
| `state/` | borders, records, logs; not for version control, but for the backup |

Steps to the first border:

1. Start the lab: `roslaunch {folder}/lab.launch`, with `rviz:=false` on a computer without a screen. Whenever
   something changes, it says what is still wrong, and how to fix it.
2. Set the exposure, so that the floor is grey and the spot white: `rosrun vb_laser_detect calibrate_camera exposure {first}`.
3. Calibrate each lens once: `rosrun vb_laser_detect calibrate_camera lens {first}`, with the board that
   `calibrate_camera print_board board.pdf` writes.
4. Calibrate each camera's pose: `rosrun vb_laser_detect calibrate_camera spots {first}`; for places measured by tape, add
   `--point_sigma 0.005`. It writes into `calibration/`, and the running lab loads the file.
5. `rosrun vb_bringup check_lab` lists the remaining faults, one per line.
6. Say *define border*, or press `b` in `rosrun vb_voice_wizard wizard_console`, and draw.
"""


def write_lab(
    folder: Path, cameras: Mapping[str, str], robot: str, map_file: Optional[Path], profiles: Path
) -> List[Path]:
    """Writes the folder. Returns its files.

    Args:
        folder: may exist, but must be empty.
        cameras: each ceiling camera's source by name, "" if a driver publishes it; empty for a lab with only a robot.
        robot: a robot type with a profile in the stack; "" without a robot.
        map_file: a map in map_server's format, to be copied; None if others publish /map.
        profiles: folder of the robot types.

    Raises:
        CodedError: "folder_with_space", "folder_not_empty", "bad_camera_name", "unknown_robot_type" or "bad_map_file"
            before anything is written; or "cannot_write_lab".
    """
    if len(str(folder).split()) != 1:  # arguments of launch files are separated by spaces
        raise CodedError("folder_with_space", folder=folder)
    if folder.exists() and any(folder.iterdir()):
        raise CodedError("folder_not_empty", folder=folder)
    invalid = [name for name in cameras if not NAME.fullmatch(name)]
    if invalid:
        raise CodedError("bad_camera_name", name=", ".join(invalid))
    profile = find_profile(robot or "template", profiles)
    if map_file is not None:
        read_map(map_file)
    files: Dict[str, str] = {
        "lab.launch": _LAUNCH.format(
            folder=folder,
            cameras=" ".join(cameras) or "none",
            robot=str(bool(robot)).lower(),
            map="$(dirname)/map.yaml" if map_file else "",
            configs=" ".join(f"{name}=$(dirname)/detectors/{name}.yaml" for name in cameras),
        ),
        "cameras.launch": _CAMERAS,
        "network.sh": _NETWORK,
        "README.md": _README.format(title=folder.name, folder=folder, first=(list(cameras) or ["NAME"])[0]),
        ".gitignore": "/state/\n",
    }
    for name, source in cameras.items():
        content = yaml.safe_dump({"source": source} if source else {}).strip()
        files[f"detectors/{name}.yaml"] = _DETECTOR.format(name=name, content=content)
    try:
        for name in ("calibration", "detectors", "lenses", "state"):
            (folder / name).mkdir(parents=True, exist_ok=True)
        for name, text in files.items():
            (folder / name).write_text(text, encoding="utf-8")
        if map_file is not None:
            _copy_map(map_file, folder)
        shutil.copyfile(str(profile), str(folder / "robot.yaml"))
    except OSError as error:
        raise CodedError("cannot_write_lab", folder=folder, error=error.strerror) from None
    return sorted(path for path in folder.rglob("*") if path.is_file())


def parse_source(text: str) -> str:
    """Converts a camera's number, device, address or file to a detector's parameter `source`."""
    if text.isdigit():
        return f"/dev/video{text}"
    return text if "://" in text else str(Path(text).expanduser().absolute())


def parse_cameras(text: str) -> Dict[str, str]:
    """Parses NAME or NAME=SOURCE separated by spaces, with sources as in `parse_source`.

    Raises:
        CodedError: "bad_camera_name" if two have the same name.
    """
    words = [word.partition("=")[::2] for word in text.split()]
    cameras = dict(words)
    if len(cameras) != len(words):
        raise CodedError("bad_camera_name", name=", ".join(name for name, _ in words))
    return {name: source and parse_source(source) for name, source in cameras.items()}


def _copy_map(map_file: Path, folder: Path) -> None:
    """Copies a readable map as map.yaml, with its image."""
    description = yaml.safe_load(map_file.read_text(encoding="utf-8"))
    image = map_file.parent / description["image"]
    image_copy = folder / f"map{image.suffix}"
    shutil.copyfile(str(image), str(image_copy))
    (folder / "map.yaml").write_text(yaml.safe_dump({**description, "image": image_copy.name}), encoding="utf-8")


def run(arguments: Optional[List[str]] = None) -> int:
    """Writes the folder and prints the next step. Returns the exit status, 0, or 1 if nothing was written."""
    parser = argparse.ArgumentParser(prog="new_lab", description=__doc__.split("\n")[0])
    parser.add_argument("folder", type=Path, help="a new folder, for instance ~/my_lab")
    parser.add_argument(
        "--cameras",
        default="",
        help='ceiling cameras: "north south" from drivers, "north=/dev/video0 south=rtsp://192.168.1.7/stream" without',
    )
    parser.add_argument("--robot", default="", help="robot type, for instance turtlebot2; by default, no robot")
    parser.add_argument(
        "--map", default="", help="YAML file of the map, which is copied; by default, others publish /map"
    )
    options = parser.parse_args(sys.argv[1:] if arguments is None else arguments)
    import rospkg

    profiles = Path(rospkg.RosPack().get_path("vb_bringup")) / "robots"
    try:
        folder = options.folder.expanduser().resolve()
        map_file = Path(options.map).expanduser().resolve() if options.map else None
        for path in write_lab(folder, parse_cameras(options.cameras), options.robot, map_file, profiles):
            print(path)
    except CodedError as error:
        print(error, file=sys.stderr)
        return REFUSED
    print(f"Next: read {options.folder}/README.md")
    return CREATED


def main() -> None:
    """Runs the program."""
    sys.exit(run())
