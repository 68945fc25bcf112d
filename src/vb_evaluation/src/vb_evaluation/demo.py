"""The demonstration: a whole interaction in the simulated lab, from camera images to a detour.

    demo --scenario carpet --method nrs

The live system runs unchanged under a ROS master of its own; the demonstration only observes it and makes requests. It
starts `simulation.launch` and a simulated participant, reports what happens, and verifies the border by move_base's
plans before and after it, and by a drive. Results are in out/demo.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import shutil
import threading
import time
from pathlib import Path
from typing import Any, Dict, List, Optional, Sequence

import numpy as np
import rosgraph
import rospy
from rich.console import Console
from rich.table import Table
from roslib.packages import find_node

from vb_core import names
from vb_core.child_processes import ChildProcess, free_port, start_roslaunch
from vb_core.errors import CodedError, ParameterError
from vb_core.geometry import Pose, chain_length
from vb_core.ros import node, services
from vb_evaluation import metrics
from vb_evaluation.repository_revision import repository_root
from vb_evaluation.report.paper_results import METHOD_TITLES
from vb_evaluation.navigation_check.move_base_goals import GoalOutcome, GoalRunner
from vb_evaluation.system_observer import SystemObserver
from vb_msgs.srv import SaveMap, SaveMapRequest
from vb_sim import floor_plan
from vb_sim.world import load_world

NAVIGATIONS = ("standin", "move_base")
DRIVE_TIMEOUT = 120.0  # [s] for one goal; move_base gives up on an unreachable one after 40 s
READY_TIMEOUT = 90.0  # [s]
INTERACTION_TIMEOUT = 900.0  # [s]
PAGE_PORT = 8420  # the page's, if it is free
# a sentence for each verdict; with the first two, the border is respected
VERDICTS = {
    "went_round": "the robot went round the border",
    "out_of_reach": "no way crosses the border: the goal is out of reach now",
    "no_border": "no border came out",
    "way_crosses": "the way still crosses the border",
    "robot_entered": "the robot entered the border",
    "saved_over_robot": "the robot stood where the border was saved, and did not leave: it proves nothing",
    "goal_not_reached": "the robot did not get to the goal: {drive_outcome}",
}
RESPECTED = ("went_round", "out_of_reach")
_LAUNCH = repository_root() / "launch"
_LAB_WORLD = repository_root() / "src/vb_sim/worlds/lab.yaml"


def parse_arguments(arguments: Optional[List[str]]) -> argparse.Namespace:
    """Parses the command line into options, with world and scenario loaded.

    Raises:
        CodedError: one line that names the argument or the key of the world file.
    """
    parser = argparse.ArgumentParser(prog="demo", description=__doc__.split("\n")[0])
    parser.add_argument("--scenario", default="carpet")
    parser.add_argument("--method", default="nrs")
    parser.add_argument("--world", default="", help="a world file; empty: the paper's lab")
    parser.add_argument("--seed", default="1", help="of every random draw")
    parser.add_argument("--out", default=str(repository_root() / "out" / "demo"))
    parser.add_argument("--no-rviz", dest="rviz", action="store_false", help="leave the smart display out")
    parser.add_argument("--navigation", default="standin", help="standin, or move_base: the real one (make navigation)")
    options = parser.parse_args(arguments)
    options.world_path = Path(options.world).expanduser().resolve() if options.world else _LAB_WORLD
    world = load_world(str(options.world_path))
    for key, value, choices in (
        ("METHOD", options.method, METHOD_TITLES),
        ("NAVIGATION", options.navigation, NAVIGATIONS),
        ("SCENARIO", options.scenario, world.scenarios),
    ):
        if value not in choices:
            raise ParameterError(key, f"must be one of {', '.join(choices)}, got '{value}'")
    if options.navigation == "move_base" and not find_node("move_base", "move_base"):
        raise ParameterError("NAVIGATION", "move_base is not installed: run 'make navigation' once")
    if not options.seed.isdigit():
        raise ParameterError("SEED", f"expected a whole number, got '{options.seed}'")
    options.world = world
    options.scenario = world.scenarios[options.scenario]
    options.seed = int(options.seed)
    options.out = Path(options.out).resolve()
    return options


def main(arguments: Optional[List[str]] = None) -> int:
    """Runs the demonstration. Returns 0 if a saved border is respected, 1 if not, 2 for an error, 130 on Ctrl-C."""
    console = Console(highlight=False, soft_wrap=True)
    try:
        options = parse_arguments(arguments)
        with contextlib.ExitStack() as stack:
            return Demo(options, console, stack).run()
    except CodedError as error:
        Console(stderr=True, highlight=False, soft_wrap=True).print(f"demo: {error}", markup=False, style="bold red")
        return 2
    except KeyboardInterrupt:
        console.print("interrupted")
        return 130


class Demo:
    """One run, from starting the nodes to writing the summary. `stack` ends the processes that it starts."""

    def __init__(self, options: argparse.Namespace, console: Console, stack: contextlib.ExitStack) -> None:
        self.options, self.console, self._stack = options, console, stack
        self._started = time.monotonic()
        self._cameras = [camera.name for camera in options.world.cameras] if options.method == "nrs" else []
        self._printed: Dict[str, str] = {}

    def run(self) -> int:
        """Runs the demonstration from beginning to end. Returns the exit code."""
        options = self.options
        proof = options.scenario.proof
        self.console.rule(f"[bold]{options.scenario.title}[/bold], {METHOD_TITLES[options.method].lower()}")
        self._launch()
        self._register()
        observer = SystemObserver()
        self._wait_until_ready(observer)
        start, goal = ((x, y, math.radians(yaw)) for x, y, yaw in (proof.start, proof.goal))
        plan_before = observer.plan(start, goal, "/move_base/make_plan")
        self._follow(observer)
        saved = observer.state is not None and observer.state.last_outcome == "saved"
        plan_after = np.zeros((0, 2))
        drives = []
        if saved:
            plan_after = self._plan_round_border(observer, start, goal)
            drives = self._drive(start, goal)
            self._save_map()
        time.sleep(1.0)  # RViz draws a few frames a second: let it show the last state
        return self._conclude(observer, {"before": plan_before, "after": plan_after}, drives)

    # ------------------------------------------------------------- starting
    def _launch(self) -> None:
        """Starts the simulated lab on a ROS master of its own, in a cleared folder, and waits for the master."""
        options = self.options
        options.out.mkdir(parents=True, exist_ok=True)
        # borders and logs of an earlier run would be picked up again
        state = options.out / "state"
        shutil.rmtree(str(state), ignore_errors=True)
        (options.out / "summary.json").unlink(missing_ok=True)
        self._port = free_port()
        page = free_port(PAGE_PORT)
        os.environ["ROS_MASTER_URI"] = f"http://127.0.0.1:{self._port}"
        os.environ["ROS_LOG_DIR"] = str(options.out / "log")
        has_screen = bool(os.environ.get("DISPLAY"))
        if options.rviz and not has_screen:
            self._print("there is no screen for the smart display: the page shows the same")
        os.environ.setdefault("QT_X11_NO_MITSHM", "1")
        self._launched = self._roslaunch(
            ["simulation.launch"],
            navigation=options.navigation,
            cameras=" ".join(self._cameras) or "none",
            state=state,
            maps=options.out,
            page_port=page,
            rviz=options.rviz and has_screen,
        )
        # rospy would complain about a master that is not up yet
        if not node.wait_until(lambda: rosgraph.is_master_online() or not self._launched.running, READY_TIMEOUT):
            raise CodedError("not_ready", "the ROS master did not come up")
        self._print(f"watch it, and take part, at http://127.0.0.1:{page}/")

    def _register(self) -> None:
        """Makes this process a node. If the master ended with roslaunch, rospy alone would retry forever."""
        node_options = {"anonymous": True, "disable_signals": True, "log_level": rospy.ERROR}
        attempt = threading.Thread(target=rospy.init_node, args=("demo_observer",), kwargs=node_options, daemon=True)
        attempt.start()
        while attempt.is_alive() and self._launched.running:
            attempt.join(0.2)
        if attempt.is_alive():
            raise CodedError("launch_ended", f"roslaunch ended:\n{self._launched.tail()}")

    def _roslaunch(self, files: List[str], **arguments: Any) -> ChildProcess:
        """Starts launch files for this world, method and seed."""
        options = self.options
        arguments.update(world=options.world_path, method=options.method, seed=options.seed)
        log = options.out / "log" / f"{Path(files[0]).stem}.txt"
        child = start_roslaunch([_LAUNCH / name for name in files], log, self._port, **arguments)
        self._stack.callback(child.stop)
        return child

    def _wait_until_ready(self, observer: SystemObserver) -> None:
        """Waits until every part of the system has published, or raises an error that names those that have not."""
        ready_conditions = {
            "the interaction manager (/virtual_borders/state)": lambda: observer.state is not None,
            "the physical map (/map)": lambda: observer.prior is not None,
            "the map with borders (/virtual_borders/map)": lambda: observer.posterior is not None,
            "the simulated lab (/sim/lab_state)": lambda: observer.lab is not None,
        }
        for camera in [*self._cameras, "robot"]:
            ready_conditions[f"the detector of camera {camera} (/virtual_borders/detectors)"] = (
                lambda camera=camera: camera in observer.detectors and observer.detectors[camera].processed > 0
            )

        def missing() -> List[str]:
            return [name for name, is_ready in ready_conditions.items() if not is_ready()]

        if not node.wait_until(lambda: not missing() or not self._launched.running, READY_TIMEOUT) or missing():
            last_lines = f"The last lines of {self._launched.log}:\n{self._launched.tail()}"
            raise CodedError("not_ready", f"these did not come up: {'; '.join(missing())}. {last_lines}")
        self._print(f"all nodes are up: {len(self._cameras) + 1} cameras, maps, interaction, navigation")

    # ------------------------------------------------------------- while it runs
    def _print(self, text: str) -> None:
        self.console.print(f"[dim]{time.monotonic() - self._started:6.1f} s[/dim]  {text}")

    def _follow(self, observer: SystemObserver) -> None:
        """Starts the participant, and prints what happens until the person is done."""
        self._roslaunch(["parts/participant.launch"], scenario=self.options.scenario.key)
        if not node.wait_until(
            lambda: self._print_progress(observer) or observer.outcome is not None or not self._launched.running,
            INTERACTION_TIMEOUT,
            0.1,
        ):
            self._print(f"the participant did not finish within {INTERACTION_TIMEOUT:.0f} s")
        if not self._launched.running:
            raise CodedError("launch_ended", f"roslaunch ended:\n{self._launched.tail()}")
        outcome = observer.outcome
        if outcome is not None and outcome.get("outcome") != "saved":
            self._print(f"the participant ended with '{outcome.get('outcome')}': {outcome.get('reason', '')}")

    def _print_progress(self, observer: SystemObserver) -> None:
        """Prints what has changed since the last call."""
        state, progress, lab = observer.state, observer.progress, observer.lab
        news = {
            "participant": f"the participant {lab.participant_doing}" if lab and lab.participant_doing else "",
            "state": f"state [bold]{state.name}[/bold]: {state.last_message}".rstrip(": ") if state else "",
        }
        if progress:
            news["cameras"] = f"seen by {' and '.join(sorted(progress.cameras))}" if progress.cameras else ""
            hundreds = progress.border_spots // 100 * 100
            news["spots"] = f"more than {hundreds} spots" if hundreds else ""
            news["seed"] = "a seed point is shown" if progress.has_seed else ""
        for topic, text in news.items():
            if text != self._printed.get(topic, ""):
                self._printed[topic] = text
                if text:
                    self._print(text)

    @staticmethod
    def _plan_round_border(observer: SystemObserver, start: Pose, goal: Pose) -> np.ndarray:
        """Asks for plans until one (N, 2) [m] does not cross the saved border, or for 5 s. Returns the last one.

        The map with the border was published before the state became "saved"; move_base's costmap has it a little later.
        """
        region = metrics.restricted_cells(observer.prior, observer.posterior)
        plans = []

        def goes_round() -> bool:
            plans.append(observer.plan(start, goal, "/move_base/make_plan"))
            return not metrics.path_meets_region(plans[-1], observer.prior, region)

        node.wait_until(goes_round, 5.0, 0.25)
        return plans[-1]

    def _drive(self, start: Pose, goal: Pose) -> List[GoalOutcome]:
        """Sends the robot to the start of the proof, and from there to its goal. Returns both outcomes."""
        runner = GoalRunner()
        first = runner.drive(start, DRIVE_TIMEOUT)
        if first.outcome != "reached":
            self._print(f"the robot did not get to the start ({first.outcome}): it drives from where it is")
        driven = runner.drive(goal, DRIVE_TIMEOUT)
        length = chain_length(driven.path)
        text = f"drive {driven.outcome} after {length:.2f} m and {driven.seconds:.0f} s: {driven.text}"
        self._print(text.rstrip(": "))
        return [first, driven]

    def _save_map(self) -> None:
        try:
            request = SaveMapRequest(name="posterior", raw=False)
            answer = services.call(names.SAVE_MAP, SaveMap, request, services.INTEGRATOR, 10.0)
            failed = "" if answer.success else answer.message
        except CodedError as error:
            failed = str(error)
        if failed:
            self._print(f"the map could not be saved: {failed}")

    # ------------------------------------------------------------- the end
    def _conclude(self, observer: SystemObserver, plans: Dict[str, np.ndarray], drives: Sequence[GoalOutcome]) -> int:
        """Writes the summary, and says whether the border is respected. Returns the exit code.

        Args:
            plans: (N, 2) [m] the paths planned "before" and "after" the border was drawn.
            drives: to the start of the proof, and to its goal; empty if no border was saved.
        """
        options, state, prior = self.options, observer.state, observer.prior
        region = metrics.restricted_cells(prior, observer.posterior)
        truth = floor_plan.ground_truth(options.world, options.scenario)
        score = metrics.jaccard(truth, region) if drives else 0.0
        times = {"guide": state.guide_s, "border": state.border_s, "seed": state.seed_s}
        driven = drives[-1] if drives else GoalOutcome("not_sent")
        paths = {**plans, "driven": driven.path}
        crossings = {key: metrics.path_meets_region(path, prior, region) for key, path in paths.items()}
        summary = {
            "scenario": options.scenario.key,
            "method": options.method,
            "world": options.world.name,
            "seed": options.seed,
            "navigation": options.navigation,
            "completed": bool(drives),
            "jaccard": round(score, 4),
            "time_s": {key: round(value, 2) for key, value in {**times, "total": sum(times.values())}.items()},
            **{f"path_{key}_m": round(chain_length(path), 3) if len(path) else None for key, path in paths.items()},
            **{f"path_{key}_crosses_border": is_crossing for key, is_crossing in crossings.items()},
            "drive_outcome": driven.outcome,
            "drive_s": round(driven.seconds, 1),
        }
        # from the robot's position when the border was saved: tells a robot that drove in from one that stood there
        at_save = [(pose.x, pose.y) for pose in observer.lab_at_save.robot_poses[:1]] if observer.lab_at_save else []
        track = np.vstack([np.reshape(at_save, (-1, 2)), *(drive.path for drive in drives)])
        ends_inside = metrics.path_meets_region(track[-1:], prior, region)
        verdict = summary["verdict"] = _verdict(summary, metrics.path_enters_region(track, prior, region), ends_inside)
        (options.out / "summary.json").write_text(json.dumps(summary, indent=2) + "\n")
        table = Table(title="result", show_header=False)
        for key, value in summary.items():
            parts = value if isinstance(value, dict) else {"": value}
            for part, entry in parts.items():
                table.add_row(f"{key} {part}".strip().replace("_", " "), "none" if entry is None else str(entry))
        self.console.print(table, f"written to {options.out}")
        respected = verdict in RESPECTED
        self.console.print(VERDICTS[verdict].format(**summary), style="bold green" if respected else "bold red")
        return 0 if respected else 1


def _verdict(summary: Dict[str, Any], entered: bool, ends_inside: bool) -> str:
    """Returns the verdict on a result, one of VERDICTS.

    Args:
        entered: the robot drove into the border after it was saved; ends_inside: it ended inside.
    """
    if not summary["completed"]:
        return "no_border"
    if summary["path_after_crosses_border"]:
        return "way_crosses"
    if entered:
        return "robot_entered"
    if ends_inside:
        return "saved_over_robot"
    if summary["path_after_m"] is None:
        return "out_of_reach"
    return "went_round" if summary["drive_outcome"] == "reached" else "goal_not_reached"
