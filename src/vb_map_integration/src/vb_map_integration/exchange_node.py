"""Commands: borders from a file into the store, and from the store into a file. YAML or GeoJSON."""
from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import List, Optional

import rospy
from vb_msgs.srv import ListBorders, ListBordersRequest

from vb_core import names
from vb_core.errors import CodedError
from vb_core.ros import services
from vb_map_integration import map_files
from vb_map_integration.border import VirtualBorder
from vb_map_integration.border_client import Answer, BorderClient
from vb_map_integration.border_files import borders_from_yaml, borders_to_yaml
from vb_map_integration.border_messages import border_from_message
from vb_map_integration.findings import ERROR
from vb_map_integration.geojson import borders_from_geojson, borders_to_geojson

_GEOJSON = (".geojson", ".json")


def read_borders(path: Path) -> List[VirtualBorder]:
    """The borders of a file; GeoJSON by its ending, else YAML.

    Raises:
        CodedError: "cannot_read", "bad_border_file", or what a border raises.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise CodedError("cannot_read", f"cannot read {path}: {error}") from None
    return borders_from_geojson(text) if path.suffix.lower() in _GEOJSON else borders_from_yaml(text)[0]


def _print_answer(border: VirtualBorder, answer: Answer, done: str) -> None:
    name = border.name or ("polygon" if border.closed else "separating curve")
    print(f"{name}: {done if answer.success else f'refused [{answer.code}]'}: {answer.message}")
    for found in answer.findings:
        print(f"    {'error' if found.severity == ERROR else 'warning'} [{found.code}]: {found.message}")


def import_borders(arguments: Optional[List[str]] = None) -> int:
    """Adds each border of a file and prints what was found. Status 0: all were taken, 1: not all, 2: bad file."""
    parser = argparse.ArgumentParser(prog="import_borders", description=import_borders.__doc__)
    parser.add_argument("file", type=Path, help="YAML as the store and save_map write it, or GeoJSON in metres")
    parser.add_argument("--dry-run", action="store_true", help="only preview, add nothing")
    parser.add_argument("--frame", default=names.MAP_FRAME, help="frame of the file's points (default: map)")
    options = parser.parse_args(rospy.myargv(sys.argv)[1:] if arguments is None else arguments)
    try:
        borders = read_borders(options.file)
    except CodedError as error:
        print(error, file=sys.stderr)
        return 2
    rospy.init_node("import_borders", anonymous=True, disable_signals=True)
    client = BorderClient("import", options.frame)
    refused = 0
    for border in borders:
        # an id belongs to the store that gave it
        fresh = border.replace(id="")
        answer = client.preview(fresh) if options.dry_run else client.save(fresh)
        _print_answer(fresh, answer, "would be taken" if options.dry_run else f"added as {answer.id}")
        if answer.success and not options.dry_run and not border.enabled and not border.expires:
            answer = client.update(border.replace(id=answer.id))  # what is added is on: turn it off again
        refused += not answer.success
    print(f"{len(borders) - refused} of {len(borders)} {'could be added' if options.dry_run else 'added'}")
    return 1 if refused else 0


def export_borders(arguments: Optional[List[str]] = None) -> int:
    """Writes all stored borders to a file."""
    parser = argparse.ArgumentParser(prog="export_borders", description=export_borders.__doc__)
    parser.add_argument("file", type=Path, help="GeoJSON if it ends with .geojson or .json, else YAML")
    options = parser.parse_args(rospy.myargv(sys.argv)[1:] if arguments is None else arguments)
    rospy.init_node("export_borders", anonymous=True, disable_signals=True)
    try:
        response = services.call(names.LIST_BORDERS, ListBorders, ListBordersRequest(), "the map integrator")
        borders = [border_from_message(message) for message in response.borders.borders]
        is_geojson = options.file.suffix.lower() in _GEOJSON
        text = borders_to_geojson(borders) if is_geojson else borders_to_yaml(borders)
        map_files.write_atomically(options.file, text.encode())
    except CodedError as error:
        print(error, file=sys.stderr)
        return 1
    print(f"{len(borders)} border(s) written to {options.file}")
    return 0
