"""Imports borders from a GeoJSON file."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from uuid import uuid4

import rospy
from vb_msgs.srv import AddBorder, AddBorderRequest

from vb_core import names
from vb_core.errors import CodedError
from vb_core.ros import services
from vb_map_integration.border import borders_from_geojson
from vb_map_integration.border_messages import message_from_border

# [s] a border on 16 million cells takes half a second on a busy computer
_TIMEOUT = 20.0


def import_borders() -> int:
    """Adds each border of a file, and prints the answer to each.

    Exit status 0: all were added, 1: not all, 2: bad file.
    """
    parser = argparse.ArgumentParser(prog="import_borders", description=import_borders.__doc__)
    parser.add_argument("file", type=Path, help="GeoJSON in metres, as save_map writes it")
    options = parser.parse_args(rospy.myargv()[1:])
    try:
        borders = borders_from_geojson(options.file.read_text(encoding="utf-8"))
    except CodedError as error:
        parser.exit(2, f"{error}\n")
    except (OSError, UnicodeDecodeError) as error:
        parser.exit(2, f"{CodedError('cannot_read', file=options.file, reason=error)}\n")
    rospy.init_node("import_borders", anonymous=True, disable_signals=True)
    added = 0
    for border in borders:
        request = AddBorderRequest(source="import", request_id=str(uuid4()), disabled=not border.enabled)
        request.border = message_from_border(border.replace(id=""))
        request.frame_id = names.MAP_FRAME
        try:
            answer = services.call(names.ADD_BORDER, AddBorder, request, services.INTEGRATOR, response_timeout=_TIMEOUT)
        except CodedError as error:
            print(error, file=sys.stderr)
            return 1
        added += answer.success
        outcome = f"added as {answer.id}" if answer.success else "refused"
        print(f"{border.name or 'a border'}: {outcome}")
        for issue in answer.issues:
            severity = "error" if issue.severity == issue.ERROR else "warning"
            print(f"    {severity} [{issue.code}]: {issue.message}")
    print(f"{added} of {len(borders)} added")
    return int(added < len(borders))
