"""Writes a folder for your own lab, whose files are the only ones that you edit and keep under version control.

The stack itself stays unchanged, so that an update never changes a lab's settings.
"""

from __future__ import annotations

import argparse
import shutil
import sys
from pathlib import Path
from typing import Dict, List, Mapping, Optional

import rospkg
import yaml

from vb_core.errors import CodedError
from vb_core.map_files import read_map
from vb_core.parameters import NAME
from vb_core.robot_profile import find_profile

CREATED, REFUSED = 0, 1

_FILES = ("lab.launch", "cameras.launch", "network.sh", "README.md")


def write_lab(
    folder: Path, cameras: Mapping[str, str], robot: str, map_file: Optional[Path], profiles: Path
) -> List[Path]:
    """Writes the folder. Returns its files.

    Args:
        folder: may exist, but must be empty.
        cameras: each ceiling camera's source by name; "" if a driver publishes its images. Empty without ceiling cameras.
        robot: a robot type with a profile in the stack; "" for a lab without a robot.
        map_file: a map in map_server's format, which is copied; None if another node publishes /map.
        profiles: folder of the robot types.

    Raises:
        CodedError: "folder_with_space", "folder_not_empty", "bad_camera_name", "unknown_robot_type" or "bad_map_file"
            before anything is written; "cannot_write_lab" if writing fails.
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
    values = {
        "title": folder.name,
        "folder": folder,
        "cameras": " ".join(cameras) or "none",
        "configs": " ".join(f"{name}=$(dirname)/detectors/{name}.yaml" for name in cameras),
        "first": next(iter(cameras), "NAME"),
        "robot": str(bool(robot)).lower(),
        "map": "$(dirname)/map.yaml" if map_file else "",
    }
    files = {name: _template(name).format(**values) for name in _FILES}
    for name, source in cameras.items():
        content = yaml.safe_dump({"source": source} if source else {}).strip()
        files[f"detectors/{name}.yaml"] = _template("detector.yaml").format(name=name, content=content)
    try:
        for name in ("calibration", "detectors", "lenses", "state"):
            (folder / name).mkdir(parents=True, exist_ok=True)
        for name, text in files.items():
            (folder / name).write_text(text, encoding="utf-8")
        (folder / ".gitignore").write_text("/state/\n", encoding="utf-8")
        if map_file is not None:
            _copy_map(map_file, folder)
        shutil.copyfile(str(profile), str(folder / "robot.yaml"))
    except OSError as error:
        raise CodedError("cannot_write_lab", folder=folder, error=error.strerror) from None
    return sorted(path for path in folder.rglob("*") if path.is_file())


def _template(name: str) -> str:
    return (Path(__file__).with_name("lab_template") / name).read_text(encoding="utf-8")


def parse_source(text: str) -> str:
    """Converts a camera's number, device, address or file to a detector's parameter `source`."""
    if text.isdigit():
        return f"/dev/video{text}"
    return text if "://" in text else str(Path(text).expanduser().absolute())


def parse_cameras(text: str) -> Dict[str, str]:
    """Parses words of the form NAME or NAME=SOURCE to sources by name; see `parse_source`.

    Raises:
        CodedError: "bad_camera_name" if two cameras have the same name.
    """
    words = text.split()
    cameras = {}
    for word in words:
        name, _, source = word.partition("=")
        cameras[name] = parse_source(source) if source else ""
    if len(cameras) != len(words):
        raise CodedError("bad_camera_name", name=", ".join(word.partition("=")[0] for word in words))
    return cameras


def _copy_map(map_file: Path, folder: Path) -> None:
    """Copies a map, which must be readable, to map.yaml, together with its image."""
    description = yaml.safe_load(map_file.read_text(encoding="utf-8"))
    image = map_file.parent / description["image"]
    image_copy = folder / f"map{image.suffix}"
    shutil.copyfile(str(image), str(image_copy))
    (folder / "map.yaml").write_text(yaml.safe_dump({**description, "image": image_copy.name}), encoding="utf-8")


def main(arguments: Optional[List[str]] = None) -> int:
    """Writes the folder and prints the next step. Returns the exit status, 0, or 1 if nothing was written."""
    parser = argparse.ArgumentParser(prog="new_lab", description=__doc__.split("\n")[0])
    parser.add_argument("folder", type=Path, help="a new folder, for instance ~/my_lab")
    parser.add_argument(
        "--cameras",
        default="",
        help='ceiling cameras: "north south" from drivers, "north=/dev/video0 south=rtsp://192.168.1.7/stream" without',
    )
    parser.add_argument("--robot", default="", help="robot type, for instance turtlebot2; by default, no robot")
    parser.add_argument("--map", default="", help="YAML file of the map to copy; by default, others publish /map")
    options = parser.parse_args(arguments)
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
