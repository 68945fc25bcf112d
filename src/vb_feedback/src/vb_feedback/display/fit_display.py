"""Writes an RViz config fitted to a map and a screen."""
from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import List, Optional

import yaml

from vb_core.errors import CodedError
from vb_core.files import write_atomically
from vb_feedback.display.layout import Box
from vb_feedback.display.rviz_config import fit_config


def run(arguments: Optional[List[str]] = None) -> int:
    """Reads a config, fits it, writes it; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="fit_display",
        description="Writes an RViz config whose top view is fitted to a map and a screen, for the smart display.",
    )
    parser.add_argument("config", help="the RViz config to start from, for instance rviz/smart_display.rviz")
    parser.add_argument("output", help="the file to write")
    parser.add_argument("--map", nargs=2, type=float, default=(8.0, 5.0), metavar=("WIDTH", "HEIGHT"),
                        help="[m] size of the map (default: 8 5)")
    parser.add_argument("--origin", nargs=2, type=float, default=(0.0, 0.0), metavar=("X", "Y"),
                        help="[m] lower left corner of the map (default: 0 0)")
    parser.add_argument("--screen", nargs=2, type=int, default=(1920, 1080), metavar=("WIDTH", "HEIGHT"),
                        help="[px] size of the screen (default: 1920 1080)")
    chosen = parser.parse_args(arguments)
    x, y = chosen.origin
    try:
        with open(chosen.config, encoding="utf-8") as file:
            config = yaml.safe_load(file)
        fitted = fit_config(config, Box(x, y, x + chosen.map[0], y + chosen.map[1]), *chosen.screen)
        write_atomically(Path(chosen.output), yaml.safe_dump(fitted, default_flow_style=False, sort_keys=False).encode("utf-8"))
    except (CodedError, OSError, yaml.YAMLError) as error:
        print(f"fit_display: {error}", file=sys.stderr)
        return 1
    return 0


def main() -> None:
    """Runs the program."""
    sys.exit(run())
