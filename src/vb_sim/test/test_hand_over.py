"""A border drawn across the edge of what the ceiling cameras see has neither gap nor step where the robot goes on.

Ground truth is the corner of the lab: the ceiling camera "blue" sees its line up to x = 6.8 m or so, the robot the
rest.
Each camera is off as the models say: the ceiling camera by its calibration, the robot's by its localisation.
"""

from pathlib import Path

import numpy as np
import pytest
from shapely.geometry import LineString, Point

from vb_core import geometry
from vb_fusion.extraction import extract_border
from vb_robot.floor_view import FloorView
from vb_core.poses import to_base
from vb_sim.cameras.camera_calibration import calibrated_pose
from vb_sim.room.floor_plan import physical_map
from vb_sim.models import Models
from vb_sim.room.world import load_world

PACKAGE = Path(__file__).resolve().parents[1]
WORLD = load_world(str(PACKAGE / "worlds" / "lab.yaml"))
GRID = physical_map(WORLD)
BLUE = WORLD.camera("blue")
BLUES_VIEW = FloorView(BLUE.model(), BLUE.pose(), np.inf)  # of the map: nothing stands between it and the line
ROBOT = (7.4, 2.0, np.radians(88.0))  # looks at the line from below
TRUTH = LineString(WORLD.scenario("corner").border)
TREMOR = 0.010  # [m]; models.yaml


def on_floor(lens, true_pose, believed_pose, points):
    """Where a camera at a true pose puts floor points (N, 2) if it believes to be at another."""
    in_camera = geometry.apply(geometry.invert(true_pose), np.column_stack([points, np.zeros(len(points))]))
    rays = lens.rays(lens.project(in_camera)) @ believed_pose[:3, :3].T
    return geometry.intersect_floor(believed_pose[:3, 3], rays)[:, :2]


def drawn(seed, overlap=True):
    """(N, 2) spots of both cameras, their stamps (N,) [s], those (M, 2) of the robot alone, and how many the other saw."""
    rng = np.random.default_rng(seed)
    line = geometry.resample_chain(np.asarray(TRUTH.coords), 0.4 / 25.0)  # 0.4 m/s, 25 images/s
    tremor = np.cumsum(rng.normal(0.0, 1.0, line.shape), axis=0)
    line = line + TREMOR * (tremor - tremor.mean(axis=0)) / tremor.std(axis=0)
    by_blue = BLUES_VIEW.sees(line)
    view = FloorView.usual()
    by_robot = view.sees(to_base(line, ROBOT), 0.03)
    if not overlap:
        by_robot &= ~by_blue
    models = Models()
    believed = calibrated_pose(BLUE, models.optics, seed)
    blue = on_floor(BLUE.model(), BLUE.pose(), believed, line[by_blue]) + rng.normal(0.0, 0.002, (by_blue.sum(), 2))
    sigmas = (models.localization.position_sigma, models.localization.position_sigma, models.localization.yaw_sigma)
    off = np.array(sigmas) * rng.normal(size=3)
    true = geometry.transform_from_pose2d(*ROBOT) @ view.T_base_camera
    guess = geometry.transform_from_pose2d(*(np.array(ROBOT) + off)) @ view.T_base_camera
    robot = on_floor(view.camera, true, guess, line[by_robot]) + rng.normal(0.0, 0.003, (by_robot.sum(), 2))
    assert (by_blue | by_robot).mean() > 0.95, "the scene must let somebody see nearly all of it"
    times = np.concatenate([np.flatnonzero(by_blue), np.flatnonzero(by_robot) + 0.5])
    return np.vstack([blue, robot]), times / 25.0, robot, by_blue.sum()


@pytest.mark.parametrize("overlap", [True, False])
@pytest.mark.parametrize("seed", range(1, 11))
def test_no_gap_and_no_step_where_the_robot_goes_on(seed, overlap):
    points, stamps, robot, blue = drawn(seed, overlap)
    assert len(robot) > 40 and blue > 100
    mobile = np.arange(len(points)) >= blue
    chain = LineString(extract_border(points, stamps=stamps, cameras=mobile, mobile=mobile).points)
    # no gap: every place of the intended line has the border near it, up to the ends
    along = [TRUTH.interpolate(s) for s in np.arange(0.1, TRUTH.length - 0.1, 0.02)]
    assert max(chain.distance(place) for place in along) < 0.09
    # no step: on 0.5 m about the edge of what blue sees the border goes on as it is intended to
    along_line = np.column_stack([np.arange(6.0, 8.0, 0.01), np.full(200, 3.4)])
    edge = along_line[BLUES_VIEW.sees(along_line), 0].max()
    assert 6.5 < edge < 7.3
    heights = []
    for x in np.arange(edge - 0.25, edge + 0.26, 0.05):
        crossing = chain.intersection(LineString([(x, 3.1), (x, 3.7)]))
        assert not crossing.is_empty
        found = [point.y for point in getattr(crossing, "geoms", [crossing]) if isinstance(point, Point)]
        heights.append(float(np.mean(found)))
    assert np.ptp(heights) < 0.08 and np.abs(np.diff(heights)).max() < 0.05
