"""Recordings of maps with their borders."""

import numpy as np

from vb_core.map_files import read_map
from vb_map_integration.borders.geojson import borders_from_geojson
from vb_map_integration.storage.recording import MapRecording

from integrators import GRID, integrator, square


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
    assert borders_from_geojson((tmp_path / "0002.borders.geojson").read_text()) == list(keeper.borders)


def test_a_recording_is_bounded(tmp_path):
    recording = MapRecording(tmp_path, max_bytes=100_000)
    for number in range(12):
        recording.record(GRID, [], float(number), {})
    kept = sorted(path.stem for path in tmp_path.glob("*.pgm"))
    assert sum(path.stat().st_size for path in tmp_path.glob("0*")) <= 100_000
    assert kept[-1] == "0012" and 1 < len(kept) < 12
    lines = (tmp_path / "index.jsonl").read_text().splitlines()
    assert len(lines) == len(kept) and f'"number": {int(kept[0])}' in lines[0]
