"""Real runs in one process, one of each method: they are the same whatever runs beside or before them."""

import signal
import sys
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from vb_testing import run_command
from vb_core.errors import CodedError
from vb_evaluation.report.study_files import META, read_meta
from vb_evaluation.simulated_study import campaign, config, run_plan
from vb_evaluation.simulated_study.__main__ import main
from vb_evaluation.simulated_study.run_plan import Job
from vb_evaluation.simulated_study.live_run import LiveRun
from vb_fusion import extraction
from vb_sim import floor_plan

STUDY = config.load()
QUIET = Console(quiet=True)


def moments(seconds, **changes):
    """Returns the study with runs that end after this many simulated seconds."""
    return STUDY.changed({"timing/time_limit_s": seconds, **changes})


def test_without_cameras_the_robot_is_led_there():
    result = LiveRun(moments(10.0), Job(1, "carpet", "robot_only")).run()
    assert {spot.mobile for spot in result.spots} == {True}
    # the time limit came while the robot was being led
    assert result.records[0]["guide_s"] > 3.0
    assert result.records[0]["border_s"] == 0.0
    assert np.hypot(*np.subtract(result.lab.robots[0].pose, STUDY.world.robots[0].start_pose())[:2]) > 0.5


def test_a_run_is_the_same_whatever_was_run_before():
    task = Job(2, "carpet", "nrs")
    study = moments(7.0)
    extract = extraction.extract_border
    first = LiveRun(study, task).run()
    # the next run would never get its borders if it extracted them on this run's clock, which has stopped
    assert extraction.extract_border is extract
    LiveRun(moments(0.1), Job(5, "corner", "nrs")).run()
    again = LiveRun(study, task).run()
    sources = [[(spot.camera, spot.header.stamp) for spot in result.spots] for result in (first, again)]
    assert sources[0] == sources[1]
    # the last bits of OpenCV's results depend on where its arrays lie in memory
    places = [[(spot.position.x, spot.position.y) for spot in result.spots] for result in (first, again)]
    assert np.allclose(*places, atol=1e-6)
    assert len(first.spots) > 10
    assert np.allclose(first.lab.robots[0].pose, again.lab.robots[0].pose, atol=1e-6)


def make_row(document, sources, job):
    """Stands in for a run in a worker: returns a row that depends on job and configuration."""
    study = config.study_from_mapping(document, sources)
    row = {**dict.fromkeys(campaign.columns(job.file), 0), **job.columns(study.design.seed)}
    row["spots"] = int((study.changed(job.changes) if job.changes else study).hash, 16) % 10**6
    return campaign.Outcome(job, {**row, "map": ""} if "map" in row else row)


INTERRUPTED = """
import os, signal, sys, threading
from test_simulated_study import make_row
from vb_evaluation.simulated_study import __main__ as command, campaign

def work(document, sources, job):
    if job.order > 4:
        os.kill(int(os.environ["CONDUCTOR"]), signal.SIGINT)
        threading.Event().wait()  # a run that would never end
    return make_row(document, sources, job)

os.environ["CONDUCTOR"] = str(os.getpid())
campaign._work = work
sys.exit(command.main(["--quick", *sys.argv[1:]]))
"""


@pytest.mark.parametrize("processes", ["1", "2"])
def test_an_interruption_ends_the_study_and_the_same_command_goes_on(tmp_path, processes, monkeypatch):
    """This also holds where the shell had made it ignore SIGINT, as it does for background jobs."""
    monkeypatch.setattr(campaign, "_work", make_row)
    arguments = ["--out", tmp_path / "cut", "--processes", processes]
    deaf = {"preexec_fn": lambda: signal.signal(signal.SIGINT, signal.SIG_IGN)}
    cut = run_command(sys.executable, "-c", INTERRUPTED, *arguments, cwd=Path(__file__).parent, **deaf)
    assert cut.returncode == 130, cut.stdout
    done = (tmp_path / "cut" / "runs.csv").read_text().count("\n") - 1
    assert f"interrupted: {done} of 6 runs are done and kept in {tmp_path}" in cut.stdout
    assert done < 6
    assert [word for word in ("Traceback", "failed") if word in cut.stdout] == []

    for folder in ("cut", "whole"):
        assert campaign.run_jobs(STUDY, run_plan.main_jobs(STUDY, 2), tmp_path / folder, QUIET) == 0
    assert (tmp_path / "cut" / "runs.csv").read_bytes() == (tmp_path / "whole" / "runs.csv").read_bytes()


def test_indices_are_recomputed_from_the_areas_alone(tmp_path, monkeypatch):
    (job,) = [job for job in run_plan.main_jobs(moments(1.0), 1) if job.scenario == "carpet" and job.order < 4]
    truth = floor_plan.ground_truth(STUDY.world, STUDY.world.scenario("carpet"))
    shifted = np.roll(truth, 3, axis=1)
    prior = floor_plan.physical_map(STUDY.world)

    def work(*args):
        grid = prior.with_data(np.where(shifted, np.int8(100), prior.data))
        return campaign.Outcome(job, {**make_row(*args).row, "map": "maps/p01_carpet.yaml"}, grid)

    monkeypatch.setattr(campaign, "_work", work)
    assert campaign.run_jobs(moments(1.0), [job], tmp_path, QUIET) == 0
    areas = np.load(tmp_path / "areas.npz")
    assert areas["floor"].dtype == bool
    assert np.array_equal(areas["truth_carpet"], truth & areas["floor"])
    area, true_area = areas["p01_carpet"], areas["truth_carpet"]
    expected = (shifted & truth).sum() / (shifted | truth).sum()
    assert (area & true_area).sum() / (area | true_area).sum() == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("name", ["runs.csv", "worlds.csv"])
def test_a_row_of_each_file_is_made_again_alone(name, tmp_path, monkeypatch):
    monkeypatch.setattr(campaign, "_work", make_row)
    path = tmp_path / "short.yaml"
    path.write_text("design: {participants: 2, worlds: 2}\n")
    study = config.load(path)
    job = next(job for job in run_plan.plan_jobs(study) if job.file == name)
    assert campaign.run_jobs(study, run_plan.plan_jobs(study), tmp_path / "all", QUIET) == 0
    selection = [part for key, value in job.columns(1).items() if key != "seed" for part in (f"--{key}", str(value))]
    arguments = ["--config", str(path), *selection, "--processes", "1", "--out", str(tmp_path / "again")]
    assert main(arguments) == 0
    header, row = (tmp_path / "again" / name).read_text().splitlines()
    assert {header, row} <= set((tmp_path / "all" / name).read_text().splitlines())
    assert main([*arguments, "--participant", "3"]) == 2, "the study has no such run"


def test_rows_of_another_configuration_or_of_unknown_origin_are_refused(tmp_path):
    for _ in range(2):
        campaign.open_folder(tmp_path, "abc", {"seed": 1})
    assert read_meta(tmp_path / META) == {"configuration": "abc", "seed": 1}
    for meta, words in (('{"configuration": "def"}', "OUT=folder"), ("{", "study.json"), ("[1]", "study.json")):
        (tmp_path / META).write_text(meta)
        with pytest.raises(CodedError, match=words):
            campaign.open_folder(tmp_path, "abc", {})
        assert (tmp_path / META).read_text() == meta
    (tmp_path / META).unlink()
    (tmp_path / "runs.csv").write_text("participant\n1\n")
    with pytest.raises(CodedError, match="of another configuration"):
        campaign.open_folder(tmp_path, "abc", {})
