"""Imports borders from a GeoJSON file."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any, List, Optional, Type
from uuid import uuid4

import rospy
from vb_msgs.srv import AddBorder, AddBorderRequest, ListBorders, ListBordersRequest, PreviewBorderRequest
from vb_msgs.srv import UpdateBorder, UpdateBorderRequest

from vb_core import names
from vb_core.errors import CodedError
from vb_core.ros import services
from vb_core.ros.preview_service import PreviewBorderArray
from vb_map_integration.border import VirtualBorder
from vb_map_integration.borders.border_messages import message_from_border
from vb_map_integration.borders.geojson import borders_from_geojson

# [s] a preview of 16 million cells takes half a second on a busy computer
_TIMEOUT = 20.0


def read_borders(path: Path) -> List[VirtualBorder]:
    """Reads the borders of a GeoJSON file.

    Raises:
        CodedError: "cannot_read", "bad_border_file", or what a border raises.
    """
    try:
        return borders_from_geojson(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise CodedError("cannot_read", file=str(path), reason=error) from None


def _call(name: str, service: Type, request: Any) -> Any:
    return services.call(name, service, request, "the map integrator", response_timeout=_TIMEOUT)


def _import(border: VirtualBorder, dry_run: bool) -> bool:
    """Adds a border, updates the one of its id, or only previews it, and prints the answer; returns whether it was taken."""
    fields = {"border": message_from_border(border), "frame_id": names.MAP_FRAME}
    if dry_run:
        done = "would be taken"
        answer = _call(names.PREVIEW_BORDER, PreviewBorderArray, PreviewBorderRequest(**fields))
    elif border.id:
        done = f"updated {border.id}"
        answer = _call(names.UPDATE_BORDER, UpdateBorder, UpdateBorderRequest(source="import", **fields))
    else:
        request = AddBorderRequest(source="import", request_id=str(uuid4()), disabled=not border.enabled, **fields)
        answer = _call(names.ADD_BORDER, AddBorder, request)
        done = f"added as {answer.id}"
    name = border.name or ("polygon" if border.closed else "separating curve")
    print(f"{name}: {done if answer.success else f'refused [{answer.code}]'}: {answer.message}")
    for found in answer.issues:
        print(f"    {'error' if found.severity == found.ERROR else 'warning'} [{found.code}]: {found.message}")
    return bool(answer.success)


def import_borders(arguments: Optional[List[str]] = None) -> int:
    """Adds each border of a file, or updates the one that it was exported from, and prints the issues.

    Status 0: all were added, 1: not all, 2: bad file.
    """
    parser = argparse.ArgumentParser(prog="import_borders", description=import_borders.__doc__)
    parser.add_argument("file", type=Path, help="GeoJSON in metres, as save_map writes it")
    parser.add_argument("--dry-run", action="store_true", help="only preview, add nothing")
    options = parser.parse_args(rospy.myargv(sys.argv)[1:] if arguments is None else arguments)
    try:
        borders = read_borders(options.file)
    except CodedError as error:
        print(error, file=sys.stderr)
        return 2
    rospy.init_node("import_borders", anonymous=True, disable_signals=True)
    taken = 0
    try:
        # an id belongs to the database that gave it: another one's borders have other times of creation
        stored = _call(names.LIST_BORDERS, ListBorders, ListBordersRequest()).borders.borders
        known = {(one.id, round(one.created.to_sec(), 3)) for one in stored}
        for border in borders:
            if (border.id, round(border.created, 3)) not in known:
                border = border.replace(id="")
            taken += _import(border, options.dry_run)
    except CodedError as error:
        print(error, file=sys.stderr)
        return 1
    print(f"{taken} of {len(borders)} {'could be taken' if options.dry_run else 'taken'}")
    return int(taken < len(borders))
