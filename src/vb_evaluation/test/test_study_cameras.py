"""Pictures that are skipped, and parts of pictures that are not drawn, change nothing."""
import numpy as np
import pytest

from vb_evaluation.study import config
from vb_evaluation.study.cameras import Room
from vb_evaluation.study.runner import Simulation, Task

STUDY = config.load()
ROOM = Room()


def spots(task, seconds, thorough):
    """The first seconds of a run."""
    return Simulation(STUDY.changed({"timing/time_limit_s": seconds}), task, ROOM, thorough).run()


@pytest.mark.parametrize("task, seconds", [(Task(1, "carpet", "nrs"), 7.0), (Task(2, "carpet", "robot_only"), 5.0)])
def test_the_same_spots_are_found(task, seconds):
    skipping, thorough = spots(task, seconds, False), spots(task, seconds, True)
    pictures = [sum(rendered for rendered, _ in result.cameras.values()) for result in (skipping, thorough)]
    assert pictures[0] < pictures[1]
    found = [[(spot.camera, spot.stamp) for spot in result.spots] for result in (skipping, thorough)]
    assert found[0] == found[1]
    assert len(skipping.spots) > 20
    apart = np.array([spot.position for spot in skipping.spots]) - np.array([spot.position for spot in thorough.spots])
    # noise of the depth readings and a background learnt from fewer pictures: millimetres
    assert np.linalg.norm(apart, axis=1).max() < 0.02
    assert np.median(np.linalg.norm(apart, axis=1)) < 0.004
