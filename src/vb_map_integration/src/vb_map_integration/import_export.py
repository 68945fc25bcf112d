"""Exports borders to a file, or imports them from one, in YAML or GeoJSON."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import List, Optional

import rospy
from vb_msgs.srv import ListBorders, ListBordersRequest

from vb_core import names
from vb_core.errors import CodedError
from vb_core.files import write_atomically
from vb_core.ros import services
from vb_map_integration.border import VirtualBorder
from vb_map_integration.border_client import BorderClient, ServiceResult
from vb_map_integration.borders.border_files import borders_from_yaml, borders_to_yaml
from vb_map_integration.borders.border_messages import border_from_message
from vb_map_integration.borders.issues import ERROR
from vb_map_integration.borders.geojson import borders_from_geojson, borders_to_geojson

_GEOJSON = (".geojson", ".json")


def read_borders(path: Path) -> List[VirtualBorder]:
    """Reads the borders of a file; GeoJSON by its ending, else YAML.

    Raises:
        CodedError: "cannot_read", "bad_border_file", or what a border raises.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise CodedError("cannot_read", file=str(path), reason=error) from None
    return borders_from_geojson(text) if path.suffix.lower() in _GEOJSON else borders_from_yaml(text)[0]


def _print_answer(border: VirtualBorder, answer: ServiceResult, done: str) -> None:
    name = border.name or ("polygon" if border.closed else "separating curve")
    print(f"{name}: {done if answer.success else f'refused [{answer.code}]'}: {answer.message}")
    for found in answer.issues:
        print(f"    {'error' if found.severity == ERROR else 'warning'} [{found.code}]: {found.message}")


def _stored_borders() -> List[VirtualBorder]:
    response = services.call(names.LIST_BORDERS, ListBorders, ListBordersRequest(), "the map integrator")
    return [border_from_message(message) for message in response.borders.borders]


def import_borders(arguments: Optional[List[str]] = None) -> int:
    """Adds each border of a file, or updates the one that it was exported from, and prints the issues.

    Status 0: all were added, 1: not all, 2: bad file.
    """
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
    try:
        known = _stored_borders()
    except CodedError as error:
        print(error, file=sys.stderr)
        return 1
    for border in borders:
        # an id belongs to the database that gave it: another one's borders have other times of creation
        if (border.id, round(border.created, 3)) not in {(one.id, round(one.created, 3)) for one in known}:
            border = border.replace(id="")
        answer = client.preview(border) if options.dry_run else client.save(border)
        done = "would be taken" if options.dry_run else f"updated {border.id}" if border.id else f"added as {answer.id}"
        _print_answer(border, answer, done)
        refused += not answer.success
    print(f"{len(borders) - refused} of {len(borders)} {'could be taken' if options.dry_run else 'taken'}")
    return 1 if refused else 0


def export_borders(arguments: Optional[List[str]] = None) -> int:
    """Writes all stored borders to a file."""
    parser = argparse.ArgumentParser(prog="export_borders", description=export_borders.__doc__)
    parser.add_argument("file", type=Path, help="GeoJSON if it ends with .geojson or .json, else YAML")
    options = parser.parse_args(rospy.myargv(sys.argv)[1:] if arguments is None else arguments)
    rospy.init_node("export_borders", anonymous=True, disable_signals=True)
    try:
        borders = _stored_borders()
        is_geojson = options.file.suffix.lower() in _GEOJSON
        text = borders_to_geojson(borders) if is_geojson else borders_to_yaml(borders)
        write_atomically(options.file, text.encode())
    except CodedError as error:
        print(error, file=sys.stderr)
        return 1
    print(f"{len(borders)} border(s) written to {options.file}")
    return 0
