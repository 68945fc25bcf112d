"""Makes RViz draw more letters. No ROS.

RViz draws texts with Liberation Sans, but asks its font for the characters up to 166 alone (OGRE's default), and a text
with another one is not drawn at all. The font itself has Latin, Greek and Cyrillic. So RViz is started with a separate
data folder before its package's: links to everything, and one font definition that asks for all of them.
What the font lacks, for instance Chinese or Arabic, is transliterated (`layout.transliterate`).
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import Tuple

# Latin with all accents, Greek and Cyrillic, dashes, quotation marks and the ellipsis, the euro sign
RANGES: Tuple[Tuple[int, int], ...] = ((32, 126), (161, 591), (880, 1279), (8208, 8230), (8364, 8364))


def is_drawn(character: str) -> bool:
    """Returns whether RViz started with `overlay` can draw a character."""
    return any(first <= ord(character) <= last for first, last in RANGES)


def overlay_fonts(rviz: Path, folder: Path) -> Path:
    """Makes a folder that replaces RViz's package; returns what to put before it in ROS_PACKAGE_PATH.

    Args:
        rviz: the package's own folder.
        folder: is replaced.
    """
    shutil.rmtree(str(folder), ignore_errors=True)
    definitions = shutil.ignore_patterns("*.fontdef")
    shutil.copytree(str(rviz.resolve()), str(folder / "rviz"), copy_function=os.symlink, ignore=definitions)
    fonts = Path("ogre_media") / "fonts"
    wanted = " ".join(f"{first}-{last}" for first, last in RANGES)
    for path in (rviz / fonts).glob("*.fontdef"):
        lines = path.read_text(encoding="utf-8").splitlines()
        kept = [line for line in lines if "code_points" not in line]
        end = max(number for number, line in enumerate(kept) if line.strip() == "}")
        kept.insert(end, f"  code_points {wanted}")
        (folder / "rviz" / fonts / path.name).write_text("\n".join(kept) + "\n", encoding="utf-8")
    return folder
