"""Checks the database of borders, repairs it, or restores one of its daily copies."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import List, Optional

from vb_core.errors import CodedError
from vb_map_integration.storage.database import Database
from vb_map_integration.storage.database_files import FILE, restore
from vb_map_integration.storage.sqlite_files import check_file


def repair_borders(arguments: Optional[List[str]] = None) -> int:
    """Prints what each file holds, repairs the database as map_integrator does at its start, and says what was lost."""
    parser = argparse.ArgumentParser(prog="repair_borders", description=repair_borders.__doc__)
    parser.add_argument("folder", type=Path, help=f"the folder of {FILE}, for instance ~/.ros/virtual_borders/borders")
    parser.add_argument("--from", dest="source", type=Path, help="a copy to go back to; present files are set aside")
    options = parser.parse_args(arguments)
    folder = options.folder.expanduser()
    files = [folder / FILE, folder / FILE.replace(".db", ".twin.db"), *sorted((folder / "copies").glob("*.db"))]
    if not any(path.exists() for path in files):
        print(f"there is no database in {folder}", file=sys.stderr)
        return 1
    for path in files:
        state, why = check_file(path)
        bad = f"damaged: {why}" if why else "missing"
        print(f"{path}: {f'revision {state.revision}, {state.borders} border(s)' if state else bad}")
    try:
        if options.source is not None:
            restore(folder, options.source)
        database = Database(folder)
    except CodedError as error:
        print(error, file=sys.stderr)
        return 1
    for notice in database.notices:
        print(notice.sentence())
    print(f"revision {database.revision}, {sum(database.count(one.id) for one in database.maps())} border(s)")
    database.close()
    return 0
