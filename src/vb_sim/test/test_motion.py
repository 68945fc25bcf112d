"""The robot's body, its odometry and localisation, the scanner, and time."""

import math
import threading
from functools import partial

import cv2
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from vb_core import geometry
from vb_core.grid_map import FREE, OCCUPIED, UNKNOWN, GridMap, sample
from vb_sim.simulated_lab import DistanceField, SimulatedLab, Lockstep, cast_disc
from vb_sim.model_params import LocalizationModel, Models, RobotModel, ScanModel
from vb_sim.robot.robot_body import RobotBody, advance
from vb_sim.world import Robot, world_from_mapping

DT = 0.02
EXACT = RobotModel(
    odometry_scale_sigma=0.0, odometry_distance_noise=0.0, odometry_turn_noise=0.0, odometry_drift_noise=0.0
)


def small_world(**changes):
    world = {"room": {"size": [4.0, 3.0]}, "robots": [{"name": "robot", "start": [1.0, 1.5, 0.0]}]}
    pillar = {"name": "pillar", "kind": "cylinder", "x": 3.0, "y": 1.5, "radius": 0.2}
    return world_from_mapping({**world, "furniture": [pillar], **changes})


def body(model=RobotModel(), localization=LocalizationModel(), clearance=lambda x, y: 10.0, seed=0, start=(0, 0, 0)):
    models = Models(robot=model, localisation=localization)
    robot = Robot(start=(*start[:2], math.degrees(start[2])), radius=0.18)
    return RobotBody(robot, models, clearance, np.random.default_rng(seed))


def drive(robot, speed, turn_rate, seconds, now=0.0):
    """Drives with a new command in each step; returns the velocities and the time."""
    velocities = []
    for _ in range(int(round(seconds / DT))):
        robot.command(speed, turn_rate, now)
        now += DT
        robot.step(DT, now)
        velocities.append(robot.velocity)
    return np.array(velocities), now


@settings(max_examples=100, deadline=None)
@given(st.floats(-2, 2), st.floats(-3, 3), st.integers(1, 30))
def test_arcs_add_up(distance, turn, parts):
    whole = advance((0.3, -0.2, 0.5), distance, turn)
    pieces = (0.3, -0.2, 0.5)
    for _ in range(parts):
        pieces = advance(pieces, distance / parts, turn / parts)
    assert whole[:2] == pytest.approx(pieces[:2], abs=1e-9)
    assert abs(geometry.wrap_angle(whole[2] - pieces[2])) < 1e-9


@settings(max_examples=50, deadline=None)
@given(st.floats(-3, 3), st.floats(-9, 9), st.floats(-3, 3), st.floats(-9, 9))
def test_limits_hold_at_every_step(v1, w1, v2, w2):
    model = RobotModel()
    robot = body(model)
    first, now = drive(robot, v1, w1, 0.6)
    second, _ = drive(robot, v2, w2, 0.6, now)
    velocities = np.vstack([[(0.0, 0.0)], first, second])
    assert np.abs(velocities[:, 0]).max() <= model.max_speed + 1e-9
    assert np.abs(velocities[:, 1]).max() <= model.max_turn_rate + 1e-9
    steps = np.abs(np.diff(velocities, axis=0)) / DT
    assert steps[:, 0].max() <= max(model.acceleration, model.deceleration) + 1e-6
    assert steps[:, 1].max() <= model.turn_acceleration + 1e-6


def test_robot_stops_when_commands_end():
    model = RobotModel(command_timeout=0.4)
    robot = body(model)
    _, now = drive(robot, 0.5, 0.0, 2.0)
    last_command = now
    while robot.velocity != (0.0, 0.0):
        now += DT
        robot.step(DT, now)
        assert now - last_command <= 0.4 + 0.5 / model.deceleration + 3 * DT
    assert now - last_command >= 0.4


def test_a_wall_stops_the_robot_once_and_it_can_back_off():
    robot = body(clearance=lambda x, y: 1.0 - x)
    velocities, now = drive(robot, 0.5, 0.0, 3.0)
    assert 0.80 < robot.pose[0] <= 1.0 - 0.18 + 1e-9
    assert (robot.collisions, robot.velocity[0]) == (1, 0.0)
    drive(robot, -0.3, 0.0, 1.0, now)
    assert robot.pose[0] < 0.7
    assert robot.collisions == 1


def test_exact_wheels_measure_the_true_path():
    robot = body(EXACT, start=(2.0, 1.0, 0.7))
    _, now = drive(robot, 0.4, 0.5, 2.0)
    drive(robot, -0.2, -0.9, 2.0, now)
    poses = (2.0, 1.0, 0.7), robot.odometry, robot.pose
    start, odometry, end = (geometry.transform_from_pose2d(*pose) for pose in poses)
    assert np.allclose(start @ odometry, end, atol=1e-9)


def test_the_map_correction_makes_up_for_odometry_drift():
    robot = body(seed=3)
    drive(robot, 0.4, 0.5, 20.0)
    composed = robot.map_to_odom() @ geometry.transform_from_pose2d(*robot.odometry)
    assert np.allclose(composed, geometry.transform_from_pose2d(*robot.estimated_pose()), atol=1e-9)
    assert math.dist(robot.odometry[:2], robot.pose[:2]) > 0.002


def test_localisation_error_has_its_sigma_and_varies_slowly():
    model = LocalizationModel(position_sigma=0.02, yaw_sigma=0.01, correlation_time=5.0)
    errors, steps = [], []
    for seed in range(60):
        robot = body(localization=model, seed=seed)
        now = 0.0
        of_one = []
        for _ in range(60):
            _, now = drive(robot, 0.2, 0.3, 0.1, now)
            x, y, turn = np.subtract(robot.estimated_pose(), robot.pose)
            of_one.append((x, y, geometry.wrap_angle(turn)))
        errors += of_one
        steps += list(np.diff(of_one, axis=0))
    sigma = np.std(errors, axis=0)
    assert sigma == pytest.approx([0.02, 0.02, 0.01], rel=0.35)
    # in 0.1 s, an Ornstein-Uhlenbeck process with time constant 5 s moves by sqrt(2 * 0.1 / 5) = 0.2 of its sigma
    assert np.std(steps, axis=0)[:2] == pytest.approx(0.004, rel=0.25)


def test_a_standing_robot_is_not_relocalised_by_itself():
    robot = body(seed=1)
    estimate = robot.estimated_pose()
    for step in range(100):
        robot.step(DT, step * DT)
    assert robot.estimated_pose() == estimate


# ------------------------------------------------------------ scanner
def test_beams_agree_with_fine_sampling():
    rng = np.random.default_rng(0)
    seeds = (rng.random((60, 80)) < 0.01).astype(np.uint8)
    data = np.where(cv2.dilate(seeds, np.ones((3, 3))), OCCUPIED, FREE).astype(np.int8)
    data[[0, -1], :] = data[:, [0, -1]] = OCCUPIED
    data[28:33, 38:43] = FREE
    grid = GridMap(data, 0.05, (-1.0, 2.0, 0.0))
    origin = (-1.0 + 2.01, 2.0 + 1.51)
    angles = np.linspace(-math.pi, math.pi, 200)
    ranges = DistanceField(grid).cast_rays(origin, angles, 10.0)
    samples = np.arange(0.0, 6.0, 0.002)
    points = origin + samples[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])[:, None]
    blocked = sample(grid, grid.data, points.reshape(-1, 2), UNKNOWN).reshape(points.shape[:2]) != FREE
    expected = samples[blocked.argmax(axis=1)]
    # a beam may just graze a cell's corner
    assert np.mean(np.abs(ranges - expected) < 0.05) > 0.97
    assert (ranges > expected - 0.05).all()


def test_clearance_is_the_distance_to_the_wall():
    field = SimulatedLab(small_world(furniture=[])).field
    for x in (0.3, 0.5, 1.0):
        assert field.clearance(x, 1.5) == pytest.approx(x, abs=0.02)
    assert field.clearance(-5.0, 1.0) == 0.0


def test_a_person_is_seen_by_the_scanner():
    lab = SimulatedLab(small_world(), Models(scan=ScanModel(range_sigma=0.0, person_radius=0.15)))
    lab.person = (1.0, 2.5, 0.0)
    angles, ranges = lab.scan(0)
    assert ranges[np.argmin(np.abs(angles - math.pi / 2))] == pytest.approx(0.85, abs=1e-6)
    assert np.isinf(cast_disc((0.0, 0.0), np.array([math.pi]), (1.0, 0.0), 0.1)).all()
    # a person right in front is nearer than the scanner can measure, which it reports as -inf
    lab.person = (1.0, 1.75, 0.0)
    assert -math.inf in lab.scan(0)[1]


# ------------------------------------------------------------ time
class Clock(threading.Condition):
    """What a step waits on: waiting takes a second until somebody late arrives, or else as long as it may."""

    def wait_for(self, predicate, timeout):
        self.waited = 0.0
        self.woken = True
        for arrive in self.late:
            self.waited += 1.0
            self.woken = False
            arrive()
        if not (self.woken and predicate()):
            self.waited = timeout

    def notify_all(self):
        self.woken = True


def test_lockstep_waits_for_all_that_drive():
    nodes = ("navigation", "driver")
    lockstep = Lockstep(nodes, timeout=5.0)
    clock = lockstep._condition = Clock()

    def step(*early, late=()):
        """Ends a step; returns how long it waited."""
        clock.late = [partial(lockstep.arrive, node) for node in late]
        clock.waited = 0.0
        for node in early:
            lockstep.arrive(node)
        lockstep.wait()
        return clock.waited

    assert step() == step("driver") == step(*nodes) == 0.0  # nobody drives, or not all; from here on both are expected
    assert [step(*nodes), step("driver", late=["navigation"]), step(late=nodes)] == [0.0, 1.0, 2.0]
    assert step("driver") == 5.0, "it gives up on who is silent"
    assert step("driver") == step() == step(*nodes) == 0.0
    assert step("navigation") == 5.0
