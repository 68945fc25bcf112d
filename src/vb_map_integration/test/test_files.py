"""Borders and maps as files: YAML, map_server's files, recordings."""

import sys
from pathlib import Path

import numpy as np
import pytest

from vb_core.errors import CodedError
from vb_core.map_files import read_map
from vb_map_integration.border import VirtualBorder
from vb_map_integration.borders.border_files import borders_from_yaml, borders_to_yaml
from vb_map_integration.storage.recording import MapRecording

sys.path.insert(0, str(Path(__file__).resolve().parent))
from integrators import GRID, at, integrator, square  # noqa: E402


def test_yaml_round_trip():
    curve = VirtualBorder(at((1, 2), (3, 4)), at((5, 6))[0], 0.123456789)
    wall = VirtualBorder(at((1, 2), (3, 4)), None, wall=True, schedule="mon-fri 08:00-12:00")
    slow = square(10, 10, zone="slow", max_speed=0.2, robots="robot1")
    borders = [square(10, 10, id="b1", name="Küche: 'x' # y"), curve, wall, slow]
    again, rest = borders_from_yaml(borders_to_yaml(borders))
    assert again == borders and rest == {}
    no_seed = "borders:\n- {points: [[0, 0], [1, 1]]}"
    for text in ("", "borders: 3", "borders: [1]", no_seed, "borders:\n- {x: 1}", "[", "\x00"):
        with pytest.raises(CodedError):
            borders_from_yaml(text)


def test_a_recording_is_numbered_and_continued(tmp_path):
    keeper = integrator()
    recording = MapRecording(tmp_path)
    recording.record(keeper.map_with_borders, keeper.borders, 1.0, {"revision": 0})
    keeper.add(square(10, 10, occupancy=0.75), 2.0)
    recording.record(keeper.map_with_borders, keeper.borders, 2.0, {})
    path = MapRecording(tmp_path).record(keeper.map_with_borders, keeper.borders, 3.0, {})
    assert path.name == "0003.yaml"
    assert np.array_equal(read_map(tmp_path / "0002.yaml").data, keeper.map_with_borders.data)
    lines = (tmp_path / "index.jsonl").read_text().splitlines()
    assert ['"start"' in lines[0], '"added b1"' in lines[1], len(lines)] == [True, True, 3]
    assert borders_from_yaml((tmp_path / "0002.borders.yaml").read_text())[0] == list(keeper.borders)


def test_a_recording_is_bounded(tmp_path):
    recording = MapRecording(tmp_path, max_bytes=100_000)
    for number in range(12):
        recording.record(GRID, [], float(number), {})
    kept = sorted(path.stem for path in tmp_path.glob("*.pgm"))
    assert sum(path.stat().st_size for path in tmp_path.glob("0*")) <= 100_000
    assert kept[-1] == "0012" and 1 < len(kept) < 12
    lines = (tmp_path / "index.jsonl").read_text().splitlines()
    assert len(lines) == len(kept) and f'"number": {int(kept[0])}' in lines[0]
