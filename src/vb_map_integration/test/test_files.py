"""Recordings of maps with their borders."""

import json

import numpy as np

from vb_core.map_files import read_map
from vb_map_integration.borders.geojson import borders_from_geojson
from vb_map_integration.storage.recording import MapRecording

from integrators import integrator, square


def test_a_recording_is_numbered_and_continued(tmp_path):
    keeper = integrator()
    recording = MapRecording(tmp_path)
    recording.record(keeper.map_with_borders, keeper.borders, 1.0)
    keeper.add(square(10, 10, occupancy=0.75), 2.0)
    recording.record(keeper.map_with_borders, keeper.borders, 2.0)
    path = MapRecording(tmp_path).record(keeper.map_with_borders, keeper.borders, 3.0)
    assert path.name == "0003.yaml"
    assert np.array_equal(read_map(tmp_path / "0002.yaml").data, keeper.map_with_borders.data)
    lines = [json.loads(line) for line in (tmp_path / "index.jsonl").read_text().splitlines()]
    assert [(line["number"], line["stamp_s"]) for line in lines] == [(1, 1.0), (2, 2.0), (3, 3.0)]
    assert borders_from_geojson((tmp_path / "0002.borders.geojson").read_text()) == list(keeper.borders)
