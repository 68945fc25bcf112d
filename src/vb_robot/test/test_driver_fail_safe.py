"""A robot stops if it does not know where it is, which maps belong together, who else drives it, or what it touches."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
import roslaunch
import roslib.packages

from driving_rig import DT, PROFILE, Rig
from plain_rooms import empty, scan_of
from vb_testing import assert_fields
from vb_core.errors import ParameterError
from vb_core.robot_profile import BASE_KINDS, RobotProfile
from vb_core.node_graph import NodeGraph
from vb_robot.driving.localization import PoseUncertainty
from vb_robot.ros.subscriptions import contact_message_class


@pytest.mark.parametrize("situation", ["idle", "stopped", "driving"])
def test_another_publisher_is_reported_in_every_state(situation):
    rig = Rig()
    rig.step(5.0)
    if situation == "stopped":
        rig.latch.stop("a", "test")
    rig.navigation = (0.3, 0.0) if situation == "driving" else None
    rig.step(0.5)
    rig.arbiter.gate.other_commanders = ("/move_base",)  # it sends nothing, but could
    command = rig.step(0.5)
    assert_fields(command, code="other_cmd_vel_publisher", v=0.0, w=0.0, publish=True)
    rig.arbiter.gate.other_commanders = ()
    assert rig.step(0.5).code == situation


def test_behind_a_mux_every_other_way_to_the_base_is_found():
    published = {
        "/mux/input/navi": ["/robot_driver"],
        "/mux/input/teleop": ["/keyboard"],
        "/mobile_base/commands/velocity": ["/mux", "/reflex"],
        "/cmd_vel": ["/elsewhere"],
    }
    subscribed = {
        "/mux/input/navi": ["/mux"],
        "/mux/input/teleop": ["/mux"],
        "/mobile_base/commands/velocity": ["/base"],
    }
    graph = NodeGraph(published.items(), subscribed.items(), (), {topic: "geometry_msgs/Twist" for topic in published})
    commanders = graph.find_other_commanders("/robot_driver", "/mux/input/navi", "/mobile_base/commands/velocity")
    assert commanders == ({"/keyboard", "/reflex"}, {"/mux"})
    assert graph.find_other_commanders("/robot_driver", "/cmd_vel", "") == ({"/elsewhere"}, set())
    assert graph.has_subscriber("/robot_driver", "/mux/input/navi")
    assert not NodeGraph((), {"/cmd_vel": ["/robot_driver"]}.items()).has_subscriber("/robot_driver", "/cmd_vel")


@pytest.mark.parametrize("kind", [kind for kind, why in BASE_KINDS.items() if why])
def test_an_unsupported_kind_of_robot_is_refused_in_one_sentence(kind):
    with pytest.raises(ParameterError, match="not supported"):
        RobotProfile.from_mapping({"base": {"kind": kind}})


@pytest.mark.parametrize("is_given", [True, False])
def test_amcl_starts_at_the_given_pose_or_counts_as_lost(is_given, tmp_path):
    """Without a pose, AMCL itself assumes (0, 0, 0) with variances of 0.25 m^2: the robot does not know where it is."""
    launch = (Path(roslib.packages.get_pkg_dir("vb_bringup")) / "launch" / "navigation.launch").read_text()
    file = tmp_path / "navigation.launch"
    file.write_text(re.sub(r"<param [^>]*command=[^>]*/>", "", launch))  # these check whether AMCL is installed
    config, pose = roslaunch.config.ROSLaunchConfig(), {"x": 2.0, "y": 3.0, "yaw": 1.5}
    arguments = [f"{name}:={value}" for name, value in pose.items() if is_given]
    roslaunch.xmlloader.XmlLoader(resolve_anon=False).load(str(file), config, argv=arguments, verbose=False)
    initial_pose = {name: entry.value for name, entry in config.params.items() if name.startswith("/amcl/initial_pose")}
    names = ("/amcl/initial_pose_x", "/amcl/initial_pose_y", "/amcl/initial_pose_a")
    assert initial_pose == (dict(zip(names, pose.values())) if is_given else {})
    variances = [config.params[f"/amcl/initial_cov_{axis}"].value if is_given else 0.25 for axis in ("xx", "yy")]
    uncertainty = PoseUncertainty()
    uncertainty.add(np.diag([*variances, (math.pi / 12) ** 2]))
    assert uncertainty.lost is not is_given


@pytest.mark.parametrize("key, value", [("type", "no_such_msgs/Bumper"), ("field", "pressed"), ("sensor", "which")])
def test_a_contact_that_cannot_be_heard_or_read_is_refused(key, value):
    complaint = value if key == "type" else f"has no field {value}"
    contact = {"topic": "bumper", "type": "std_msgs/UInt8", "field": "data", key: value}
    with pytest.raises(ParameterError, match=complaint):
        contact_message_class(RobotProfile.from_mapping({"contacts": [contact]}).contacts[0])


class SlowScanner(Rig):
    """A robot with a 5 Hz scanner: each scan takes 0.2 s, and is stamped with its end."""

    def _step(self):
        self.silent.add("scan")  # the usual scanner
        if "slow scan" not in self.silent and round(self.now / DT) % 4 == 0:
            self.arbiter.gate.set_scan(scan_of(self.ranges), self.now - 0.04)
        super()._step()


def test_a_scanner_of_5_hz_does_not_slow_the_robot():
    rig = SlowScanner()
    rig.navigation = (0.2, 1.0)
    rig.step(1.0)
    rig.commands.clear()
    rig.step(2.0)
    assert min(command.v for command in rig.commands) >= 0.9 * 0.2, "as with one of 10 Hz"
    assert np.mean([command.w for command in rig.commands]) >= 0.95


def sets(name, value, clear):
    """Returns a fault that sets an attribute of the gate."""
    return lambda rig, faulty: setattr(rig.arbiter.gate, name, value if faulty else clear)


def silences(name):
    return lambda rig, faulty: (rig.silent.add if faulty else rig.silent.discard)(name)


def mixes_maps(rig, faulty):
    """Withholds the maps, as the driver's node does if they do not belong together."""
    rig.arbiter.gate.workspace = None
    if not faulty:
        rig.set_grid(empty())


def drops_a_wheel(rig, faulty):
    rig.arbiter.gate.set_contact(("wheel_drop", 0), "all" * faulty)


LATEST = 0.5  # [s], as robots.md promises
FAULTS = {
    # the lost input: how it is lost, the code, and the time [s] until the wheels must stand still
    "scan": (silences("scan"), "scan_lost", LATEST),
    "scan of 5 Hz": (silences("slow scan"), "scan_lost", LATEST + 0.1),
    "tf": (silences("pose"), "pose_lost", LATEST),
    "corrections of the localisation": (silences("localisation"), "pose_lost", LATEST),
    "state": (silences("state"), "state_lost", LATEST),
    "clock": (silences("clock"), "clock_stopped", LATEST),
    "certainty of the localisation": (sets("pose_uncertain", True, False), "pose_uncertain", DT),
    "maps that belong together": (mixes_maps, "no_map", DT),
    "a wheel's floor": (drops_a_wheel, "contact", DT),
    "being its only commander": (sets("other_commanders", ("/move_base",), ()), "other_cmd_vel_publisher", DT),
}


def lose_input(fault, source, seed):
    """Loses an input for 2 s, with moment, speed and turn rate drawn at random.

    Returns the time [s] from the loss until the commands stay zero, or inf, the rig, and the commands during the loss.
    """
    random = np.random.default_rng(seed)
    rig = (SlowScanner if "5 Hz" in fault else Rig)()
    if source == "follow":
        rig.follows(random.uniform(1.7, 1.9))
    else:
        rig.navigation = (random.uniform(0.2, 0.5), random.uniform(-0.4, 0.4))
    rig.step(DT * random.integers(20, 28))
    assert rig.commands[-1].v > 0.1
    start = len(rig.commands)
    for step in range(80):
        if step in (0, 40):
            FAULTS[fault][0](rig, step == 0)
        if source == "follow":  # the spot keeps moving away: only the gate can stop the robot
            rig.spot = (rig.pose[0] + 1.6 * math.cos(rig.pose[2]), rig.pose[1] + 1.6 * math.sin(rig.pose[2]))
        rig.step()
    commands = rig.commands[start : start + 40]
    moving = [step for step, command in enumerate(commands) if (command.v, command.w) != (0.0, 0.0)]
    rests = moving[-1] + 2 if moving else 1
    stop_time = DT * rests if rests < 40 else math.inf
    return stop_time, rig, commands


@pytest.mark.parametrize("source", ["follow", "navigation"])
@pytest.mark.parametrize("fault", FAULTS)
def test_robot_stops_in_time_and_reports_why_when_an_input_is_lost(fault, source):
    """Twenty random moments each; a base's brakes can follow, and the robot goes on when the input is back."""
    _, code, latest = FAULTS[fault]
    for seed in range(20):
        stop_time, rig, commands = lose_input(fault, source, seed)
        assert stop_time <= latest + 1e-9
        assert commands[-1].code == code
        if latest > DT:  # a false input stops it immediately, a late one within its braking deceleration
            speeds = np.array([command.v for command in rig.commands])
            assert -np.diff(speeds).min() <= 1.5 * PROFILE.limits.deceleration * DT
        assert rig.commands[-1].v > 0.05
