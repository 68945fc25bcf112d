"""Real runs in one process: one of each method, the same whatever runs beside or before them."""
import numpy as np
import pytest
from rich.console import Console

from vb_evaluation import metrics
from vb_evaluation.study import campaign, config, plan
from vb_evaluation.study.cameras import Room
from vb_evaluation.study.runner import Task, run
from vb_map_integration.map_files import read_map

STUDY = config.load()
ROOM = Room()  # rendering the floor takes a second or two
QUIET = Console(quiet=True)


def moments(seconds, **changes):
    """The study with runs that end after so many simulated seconds."""
    return STUDY.changed({"timing/time_limit_s": seconds, **changes})


def test_network_robot_system(tmp_path):
    job = next(job for job in plan.main_jobs(STUDY, 1) if job.task == Task(1, "room", "nrs"))
    row = campaign.row_of(STUDY, job, ROOM, tmp_path)
    assert row["completed"] == 1 and row["outcome"] == "saved" and row["order"] == job.order
    assert row["time_guide_s"] == 0.0 and row["time_border_s"] > 0 and row["time_seed_s"] > 0
    assert row["time_total_s"] == pytest.approx(row["time_border_s"] + row["time_seed_s"], abs=0.02)
    assert set(row) == set(campaign.columns(STUDY, plan.RUNS))
    # the measure is taken from the map that was stored
    campaign.write_truth(STUDY, tmp_path)
    prior, stored, truth = (read_map(tmp_path / name) for name in ("maps/physical.yaml", row["map"], "maps/truth_room.yaml"))
    score = metrics.jaccard(metrics.restricted_cells(prior, truth), metrics.restricted_cells(prior, stored))
    assert row["jaccard"] == pytest.approx(score, abs=1e-4) and score > 0.9


def test_robot_only_is_led_there():
    result = run(moments(10.0), Task(1, "carpet", "robot_only"), ROOM)
    assert list(result.cameras) == ["robot"] and all(spot.mobile for spot in result.spots)
    # time was up while the robot was being led
    assert result.records[0].guide_s > 3.0 and result.records[0].border_s == 0.0
    assert np.linalg.norm(result.way[-1] - result.way[0]) > 0.5


def test_the_same_whatever_was_run_before():
    task = Task(2, "carpet", "nrs")
    study = moments(6.6)
    first = run(study, task, ROOM)
    run(moments(1.0), Task(5, "corner", "nrs"), ROOM)
    again = run(study, task, ROOM)
    assert [(spot.camera, spot.stamp) for spot in first.spots] == [(spot.camera, spot.stamp) for spot in again.spots]
    # the last bits of what OpenCV works out depend on where its arrays lie in memory
    assert np.allclose([spot.position for spot in first.spots], [spot.position for spot in again.spots], atol=1e-6)
    assert len(first.spots) > 10 and np.allclose(first.way, again.way, atol=1e-6)


def test_the_same_with_any_number_of_processes_and_after_an_interruption(tmp_path, monkeypatch):
    monkeypatch.setattr(campaign, "_room", ROOM)
    study = moments(1.0, **{"design/scenarios": ["room"]})
    jobs = plan.main_jobs(study, 2)
    for folder, processes in (("one", 1), ("two", 2)):
        assert campaign.conduct(study, jobs, tmp_path / folder, processes, False, {}, QUIET) == 0
    one, two = ((tmp_path / folder / "runs.csv").read_bytes() for folder in ("one", "two"))
    assert one == two and one.count(b"\n") == 5
    # as if the power had failed in the middle of the last row
    (tmp_path / "one" / "runs.csv").write_bytes(one[: one.rstrip(b"\n").rfind(b"\n") + 12])
    assert campaign.conduct(study, jobs, tmp_path / "one", 1, False, {}, QUIET) == 0
    assert (tmp_path / "one" / "runs.csv").read_bytes() == one
