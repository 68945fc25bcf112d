"""Writes the report of a study's folder: python3 -m vb_evaluation.report out/study"""
from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import List, Optional

from vb_core.errors import CodedError
from vb_evaluation.report.page import write_report


def main(arguments: Optional[List[str]] = None) -> int:
    """Runs the command; 0 if the page was written, 2 with one line if not."""
    parser = argparse.ArgumentParser(prog="vb_evaluation.report", description=(__doc__ or "").split(":")[0])
    parser.add_argument("folder", type=Path, help="holds runs.csv and what else the study left")
    given = parser.parse_args(arguments)
    try:
        print(write_report(given.folder))
    except CodedError as error:
        print(f"report: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
