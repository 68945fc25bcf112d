"""Real runs in one process: one of each method, the same whatever runs beside or before them."""
import numpy as np
import pytest
from rich.console import Console

from vb_core.errors import CodedError
from vb_evaluation import metrics
from vb_evaluation.study import alone, campaign, config, plan, sweeps
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


@pytest.mark.parametrize(
    "file, asked",
    [
        (plan.RUNS, {}),
        (plan.CURVES, {"sweep": "robots", "amount": 2.0}),
        (plan.SENSITIVITY, {"parameter": "participant/tremor", "amount": 0.5}),
        (plan.SENSITIVITY, {"parameter": "nominal", "amount": 1.0}),
    ],
)
def test_a_row_of_each_file_is_made_again_alone(file, asked, tmp_path, monkeypatch):
    monkeypatch.setattr(campaign, "_room", ROOM)
    study = moments(0.5, **{"design/scenarios": ["room"]})
    job = alone.find(study, Task(1, "room", "nrs"), **asked)
    assert job.file == file and campaign.conduct(study, [job], tmp_path, 1, False, {}, QUIET) == 0
    row = campaign.row_of(study, job, ROOM, None)
    assert alone.compare(tmp_path / file, job, row, study.design.seed) == (True, "")
    same, differing = alone.compare(tmp_path / file, job, {**row, "spots": -1}, study.design.seed)
    assert not same and differing.startswith("spots ") and "instead of -1" in differing
    assert alone.compare(tmp_path / file, job, row, study.design.seed + 1) == (False, "there is no such row")


def test_every_row_of_curves_and_sensitivity_has_its_command():
    for file, jobs in ((plan.CURVES, sweeps.curve_jobs(STUDY, 2)), (plan.SENSITIVITY, sweeps.sensitivity_jobs(STUDY, 1))):
        for job in jobs[3::40]:
            columns = job.columns(1)
            asked = {"sweep": columns["sweep"], "amount": columns["value"]} if file == plan.CURVES else {
                "parameter": columns["parameter"], "amount": columns["factor"]}
            assert alone.find(STUDY, job.task, **asked) == job
            words = alone.COMMANDS[file].format(**columns)
            assert str(asked["amount"]) in words and "{" not in words


def test_a_row_that_no_study_has_is_told():
    with pytest.raises(CodedError, match="there are 1.0, 2.0, 3.0"):
        alone.find(STUDY, Task(1, "room", "nrs"), sweep="robots", amount=9.0)
    with pytest.raises(CodedError, match="there are none"):
        alone.find(STUDY, Task(1, "room", "nrs"), parameter="participant/wit", amount=2.0)
