"""The demonstration: a whole interaction in the simulated lab, from camera images to a detour.

    demo --scenario carpet --method nrs

Starts everything with roslaunch under its own master, lets the simulated participant draw a
border, asks move_base for the same path before and after, and has it drive the robot there. Leaves its results in out/demo.
"""
from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import shutil
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Dict, List, Optional, Tuple

import numpy as np
import rosgraph
import rospy
from roslib.packages import find_node
from rich.console import Console

from vb_core import names
from vb_core.errors import CodedError, ParameterError
from vb_core.geometry import chain_length
from vb_core.ros.images import image_array
from vb_core.ros import messages
from vb_evaluation import metrics
from vb_evaluation.live import pictures
from vb_evaluation.goal_runs import Driven, GoalRunner
from vb_evaluation.live.progress_log import ProgressLog, live_line, result_table
from vb_evaluation.observer import CameraAlbum, Observer, wait_until
from vb_evaluation.processes import Child, find_window, free_port, screenshot, start_screen
from vb_feedback.display import fit_display
from vb_msgs.msg import VirtualBorder
from vb_msgs.srv import SaveMap
from vb_sim.room import floor_plan
from vb_sim.room.world import DetourCheck, Scenario, World, load_world

METHODS = ("nrs", "robot_only")
NAVIGATIONS = ("standin", "move_base")
DRIVE_S = 120.0  # [s] for one goal; move_base gives up one that is out of reach after 40 s
METHOD_TITLES = {"nrs": "network robot system", "robot_only": "robot only"}
READY_TIMEOUT_S = 90.0
# of the page, if it is free
PAGE_PORT = 8420
INTERACTION_TIMEOUT_S = 900.0
# software OpenGL pays for each pixel, and the cameras need the cores: the virtual screen is no larger than legible
SCREEN = (1280, 720)
# the screenshot of the drawing is taken once this part of the border is drawn
DRAWN_FOR_PICTURE = 0.6


@dataclass(frozen=True)
class Options:
    """The command line's options, checked."""

    world_path: Path
    world: World
    scenario: Scenario
    method: str
    seed: int
    out: Path
    rviz: bool
    models: Optional[Path] = None
    navigation: str = "standin"


def parse(arguments: Optional[List[str]], top: Path) -> Options:
    """Reads the command line.

    Raises:
        CodedError: one line that names the argument or the key of the world file.
    """
    parser = argparse.ArgumentParser(prog="demo", description=__doc__.split("\n")[0])
    parser.add_argument("--scenario", default="carpet")
    parser.add_argument("--method", default="nrs")
    parser.add_argument("--world", default="", help="a world file; empty: the paper's lab")
    parser.add_argument("--seed", default="1", help="of every random draw")
    parser.add_argument("--out", default=str(top / "out" / "demo"))
    parser.add_argument("--no-rviz", action="store_true", help="leave the smart display out")
    parser.add_argument("--navigation", default="standin", help="standin, or move_base: the real one (make navigation)")
    parser.add_argument("--models", default="", help="a file of models; empty: config/models.yaml of vb_sim")
    given = parser.parse_args(arguments)
    if given.method not in METHODS:
        raise ParameterError("METHOD", f"must be one of {', '.join(METHODS)}, got '{given.method}'")
    if given.navigation not in NAVIGATIONS:
        raise ParameterError("NAVIGATION", f"must be one of {', '.join(NAVIGATIONS)}, got '{given.navigation}'")
    if given.navigation == "move_base" and not find_node("move_base", "move_base"):
        raise ParameterError("NAVIGATION", "move_base is not installed: run 'make navigation' once")
    try:
        seed = int(given.seed)
    except ValueError:
        raise ParameterError("SEED", f"expected a whole number, got '{given.seed}'") from None
    path = Path(given.world).expanduser().resolve() if given.world else top / "src/vb_sim/worlds/lab.yaml"
    world = load_world(str(path))
    if given.scenario not in world.scenarios:
        raise ParameterError("SCENARIO", f"'{given.scenario}' is not in {path.name}; known are {', '.join(world.scenarios)}")
    return Options(
        path, world, world.scenarios[given.scenario], given.method, seed, Path(given.out).resolve(), not given.no_rviz,
        Path(given.models).expanduser().resolve() if given.models else None, given.navigation,
    )


def main(arguments: Optional[List[str]] = None, top: Optional[Path] = None) -> int:
    """Runs the demonstration; 0 if a border was saved and the second path respects it."""
    console = Console(highlight=False, soft_wrap=True)
    try:
        options = parse(arguments, top or Path.cwd())
        return Demo(options, console).run()
    except CodedError as error:
        Console(stderr=True, highlight=False, soft_wrap=True).print(f"demo: {error}", markup=False, style="bold red")
        return 2
    except KeyboardInterrupt:
        console.print("interrupted")
        return 130


class Demo:
    """One run, from starting the nodes to writing the summary."""

    def __init__(self, options: Options, console: Console) -> None:
        self.options = options
        self.console = console
        self._narrator = ProgressLog(console)
        self._stack = contextlib.ExitStack()
        self.display: Optional[str] = None
        self.virtual_screen = False

    # ------------------------------------------------------------- the story
    def run(self) -> int:
        options = self.options
        options.out.mkdir(parents=True, exist_ok=True)
        for old in list(options.out.glob("*.png")) + [options.out / "summary.json"]:
            if old.exists():
                old.unlink()
        self.console.rule(f"[bold]{options.scenario.title}[/bold], {METHOD_TITLES[options.method]}")
        with self._stack:
            self._launch()
            # rospy would complain about a master that is not up yet
            if not wait_until(lambda: rosgraph.is_master_online() or not self._launched.running, READY_TIMEOUT_S):
                raise CodedError("not_ready", "the ROS master did not come up")
            rospy.init_node("demo_observer", anonymous=True, disable_signals=True, log_level=rospy.ERROR)
            return self._observe()

    def _launch(self) -> None:
        options = self.options
        environment = dict(os.environ)
        port = free_port()
        os.environ["ROS_MASTER_URI"] = environment["ROS_MASTER_URI"] = f"http://127.0.0.1:{port}"
        environment["ROS_LOG_DIR"] = str(options.out / "log")
        if options.rviz:
            self._prepare_display(environment)
        cameras = " ".join(camera.name for camera in options.world.cameras) if options.method == "nrs" else ""
        # borders, journals and logs of an earlier run would be taken up again
        state = options.out / "state"
        shutil.rmtree(str(state), ignore_errors=True)
        self._environment = environment
        page = free_port(PAGE_PORT)
        self._launched = Child(
            ["roslaunch", "-p", str(port), self._launch_file("simulation.launch"), f"world:={options.world_path}",
             f"seed:={options.seed}", f"cameras:={cameras or 'none'}", f"method:={options.method}",
             f"navigation:={options.navigation}", f"state:={state}", f"maps:={options.out}", f"page_port:={page}",
             f"rviz:={'true' if options.rviz else 'false'}",
             f"rviz_config:={self._fit_display()}",
             *([self._launch_file("parts/models.launch"), f"models:={options.models}"] if options.models else [])],
            options.out / "log" / "roslaunch.txt", environment,
        )
        self._stack.callback(self._launched.stop)
        self._port = port
        self._say(f"watch it, and take part, at http://127.0.0.1:{page}/")
        self._say("starting the lab: "
                  + (f"cameras {cameras} and the robot's" if cameras else "the robot's camera alone, as in the paper's baseline"))

    def _prepare_display(self, environment: Dict[str, str]) -> None:
        self.display = environment.get("DISPLAY")
        if not self.display:
            screen, self.display = start_screen(self.options.out / "log" / "xvfb.txt", *SCREEN)
            self._stack.callback(screen.stop)
            self.virtual_screen = True
            environment["LIBGL_ALWAYS_SOFTWARE"] = "1"
        environment["DISPLAY"] = self.display
        environment.setdefault("QT_X11_NO_MITSHM", "1")

    def _fit_display(self) -> Path:
        """Writes the smart display's configuration for this world's map; returns its path."""
        grid = floor_plan.physical_map(self.options.world)
        low, high = grid.corners()[0], grid.corners()[2]
        path = self.options.out / "state" / "smart_display.rviz"
        numbers = lambda values: [f"{value:.3f}" for value in values]  # noqa: E731
        fit_display.run([self._launch_file("../rviz/smart_display.rviz"), str(path), "--map", *numbers(high - low),
                         "--origin", *numbers(low), "--screen", *map(str, SCREEN)])
        return path

    @staticmethod
    def _launch_file(name: str) -> str:
        return str(Path(__file__).resolve().parents[5] / "launch" / name)

    def _observe(self) -> int:
        options = self.options
        observer = Observer()
        self._wait_until_ready(observer)
        proof = options.scenario.proof
        before = observer.plan(_pose(proof.start), _pose(proof.goal), "/move_base/make_plan")
        self._say(f"before: the way from the robot's place to the goal is {chain_length(before):.2f} m long"
                  if len(before) else "before: there is no way from start to goal, so the proof will be empty")
        album = CameraAlbum(observer, self._camera_topics())
        clock = self._start_clock(observer)
        self._start_participant()
        self._follow(observer)
        measured = self._stop_clock(observer, clock)
        saved = observer.state is not None and observer.state.last_outcome == "saved"
        # the map that carries the border was published before the state said "saved"
        region = metrics.restricted_cells(observer.prior, observer.posterior)
        after = np.zeros((0, 2))
        driven = Driven("not_sent")
        if saved:
            after = self._plan_after(observer, proof, region)
        album.close()
        if saved:
            driven = self._drive(proof)
        if saved:
            self._save_map()
        time.sleep(1.0)  # RViz draws a few frames a second: let it show the last state
        self._take_screenshot("smart_display.png")
        return self._conclude(observer, album, before, after, driven, region, saved, measured)

    def _wait_until_ready(self, observer: Observer) -> None:
        options = self.options
        cameras = [camera.name for camera in options.world.cameras] if options.method == "nrs" else []
        wanted = {
            "the interaction manager (/virtual_borders/state)": lambda: observer.state is not None,
            "the physical map (/map)": lambda: observer.prior is not None,
            "the posterior map (/virtual_borders/map)": lambda: observer.posterior is not None,
            "the simulated lab (/sim/lab_state)": lambda: observer.lab is not None,
        }
        for camera in cameras + ["robot"]:
            wanted[f"the detector of camera {camera} (/virtual_borders/detectors)"] = (
                lambda camera=camera: camera in observer.detectors and observer.detectors[camera].processed > 0
            )
        with self._narrator.status("waiting for all nodes"):
            missing = lambda: [name for name, there in wanted.items() if not there()]  # noqa: E731
            ready = wait_until(lambda: not missing() or not self._launched.running, READY_TIMEOUT_S)
        if not ready or missing():
            raise CodedError("not_ready", f"these did not come up: {'; '.join(missing())}. The last lines of "
                             f"{self._launched.log}:\n{self._launched.tail()}")
        self._say(f"all nodes are up: {len(cameras) + 1} cameras, maps, interaction, navigation")

    def _camera_topics(self) -> Dict[str, str]:
        topics = {"robot": "/camera/rgb/image_raw"}
        if self.options.method == "nrs":
            topics.update({camera.name: f"/{camera.name}/image_raw" for camera in self.options.world.cameras})
        return topics

    def _start_participant(self) -> None:
        options = self.options
        participant = Child(
            ["roslaunch", "-p", str(self._port), self._launch_file("parts/participant.launch"), f"world:={options.world_path}",
             f"scenario:={options.scenario.key}", f"method:={options.method}", f"seed:={options.seed}"],
            options.out / "log" / "participant.txt", self._environment,
        )
        self._stack.callback(participant.stop)
        self._say("the participant takes up the laser pointer")

    # ------------------------------------------------------------- while it runs
    def _follow(self, observer: Observer) -> None:
        """Reports what happens until the participant is done."""
        pictured: List[threading.Thread] = []
        scenario = self.options.scenario
        wanted_m = DRAWN_FOR_PICTURE * chain_length(scenario.border, scenario.closed)

        def tell() -> bool:
            self._narrator.tell(observer)
            status.update(live_line(observer))
            chain = messages.array_from_points(observer.progress.chain) if observer.progress else np.zeros((0, 2))
            if not pictured and chain_length(chain) > wanted_m:
                pictured.append(self._start_screenshot("smart_display_drawing.png"))
            return observer.outcome is not None or not self._launched.running

        with self._narrator.status("the participant comes in") as status:
            wait_until(tell, INTERACTION_TIMEOUT_S, 0.1)
        if not self._launched.running:
            raise CodedError("launch_ended", f"roslaunch ended:\n{self._launched.tail()}")
        if observer.outcome is None:
            self._say(f"the participant did not finish within {INTERACTION_TIMEOUT_S:.0f} s")
        elif observer.outcome.get("outcome") != "saved":
            self._say(f"the participant ended with '{observer.outcome.get('outcome')}': {observer.outcome.get('reason', '')}")

    def _start_clock(self, observer) -> dict:
        frames = observer.frames()
        told = {camera: len(observer.delays(camera)) for camera in frames}
        return {"ros": rospy.get_time(), "wall": time.monotonic(), "frames": frames, "told": told}

    def _stop_clock(self, observer, start: dict) -> dict:
        ros, wall = rospy.get_time() - start["ros"], time.monotonic() - start["wall"]
        frames = observer.frames()
        for camera, counts in frames.items():
            for key in counts:
                counts[key] -= start["frames"].get(camera, {}).get(key, 0)
            delays = observer.delays(camera)[start["told"].get(camera, 0) :]
            if len(delays):
                counts["delay_median_ms"], counts["delay_p95_ms"] = np.median(delays, axis=0).round(1).tolist()
        return {"real_time_factor": ros / wall if wall > 0 else math.nan, "frames": frames, "duration_s": ros}

    def _plan_after(self, observer, proof: DetourCheck, region: np.ndarray) -> np.ndarray:
        """The path after the border, as soon as move_base's costmap has it (at most 5 s)."""
        after = np.zeros((0, 2))

        def respected() -> bool:
            nonlocal after
            after = observer.plan(_pose(proof.start), _pose(proof.goal), "/move_base/make_plan")
            return not metrics.crosses(after, observer.prior, region)

        wait_until(respected, 5.0, 0.25)
        return after

    def _drive(self, proof: DetourCheck) -> Driven:
        """Sends the robot to where the proof begins, and from there to its goal; returns the second drive."""
        runner = GoalRunner()
        with self._narrator.status("the robot drives to the start of the proof"):
            first = runner.drive(_pose(proof.start), DRIVE_S)
        if first.outcome != "reached":
            self._say(f"the robot did not get to the start of the proof ({first.outcome}): it drives from where it is")
        with self._narrator.status("the robot drives to the goal"):
            driven = runner.drive(_pose(proof.goal), DRIVE_S)
        self._say(f"driven: {driven.outcome} after {driven.length:.2f} m and {driven.seconds:.0f} s {driven.text}".rstrip())
        return driven

    def _save_map(self) -> None:
        try:
            rospy.wait_for_service(names.SAVE_MAP, timeout=10.0)
            reply = rospy.ServiceProxy(names.SAVE_MAP, SaveMap)(name="posterior", raw=False)
        except (rospy.ROSException, rospy.ServiceException) as error:
            self._say(f"the map could not be saved: {error}")
            return
        if not reply.success:
            self._say(f"the map could not be saved: {reply.message}")

    def _start_screenshot(self, name: str) -> threading.Thread:
        """Takes a screenshot without delaying the narration."""
        thread = threading.Thread(target=self._take_screenshot, args=(name,), daemon=True)
        thread.start()
        return thread

    def _take_screenshot(self, name: str) -> None:
        if not self.options.rviz:
            return
        window = None if self.virtual_screen else find_window(self.display, "rviz")
        if not screenshot(self.display, self.options.out / name, window):
            self._say("no picture of the smart display could be taken")

    # ------------------------------------------------------------- the end
    def _conclude(self, observer, album, before, after, driven, region, saved, measured) -> int:
        options = self.options
        truth = floor_plan.ground_truth(options.world, options.scenario)
        same_grid = truth.shape == region.shape
        score = metrics.jaccard(truth, region) if saved and same_grid else 0.0
        state = observer.state
        times = {"guide": state.guide_s, "border": state.border_s, "seed": state.seed_s}
        times["total"] = sum(times.values())
        crossing = metrics.crosses(after, observer.prior, region)
        entered = metrics.crosses(driven.path, observer.prior, region)
        summary = {
            "scenario": options.scenario.key,
            "method": options.method,
            "world": options.world.name,
            "seed": options.seed,
            "completed": bool(saved),
            "jaccard": round(score, 4),
            "time_s": {key: round(value, 2) for key, value in times.items()},
            "path_before_m": round(chain_length(before), 3) if len(before) else None,
            "path_after_m": round(chain_length(after), 3) if len(after) else None,
            "path_before_crosses_border": metrics.crosses(before, observer.prior, region),
            "path_after_crosses_border": crossing,
            "navigation": options.navigation,
            "drive_outcome": driven.outcome,
            "path_driven_m": round(driven.length, 3) if len(driven.path) else None,
            "path_driven_crosses_border": entered,
            "drive_s": round(driven.seconds, 1),
            "real_time_factor": round(measured["real_time_factor"], 4),
            "duration_s": round(measured["duration_s"], 2),
            "frames": measured["frames"],
        }
        (options.out / "summary.json").write_text(json.dumps(summary, indent=2) + "\n")
        chain = _chain(observer, state.last_border_id)
        pictures.before_after(
            options.out / "before_after.png", observer.prior, region, truth if same_grid else None, before, after, chain,
            driven.path,
            f"{options.scenario.title}, {METHOD_TITLES[options.method]}: Jaccard index {score:.3f}",
        )
        for camera, image in album.images.items():
            trail = observer.trail(camera)
            stamp = image.header.stamp.to_sec()
            now = [(u, v) for t, u, v in trail if abs(t - stamp) < 1e-3]
            drawn = trail[:, 1:] if not observer.mobile.get(camera, camera == "robot") else np.zeros((0, 2))
            pictures.camera_picture(
                options.out / f"camera_{camera}.png", pictures.to_bgr(image_array(image), image.encoding),
                f"camera {camera}: {len(trail)} spots seen", drawn, now,
            )
        self.console.print(result_table(summary))
        written = sorted(str(path.relative_to(options.out)) for path in options.out.glob("*.*"))
        self.console.print(f"written to {options.out}: {', '.join(written)}")
        if not saved:
            self.console.print("no border came out", style="bold red")
            return 1
        if crossing:
            self.console.print("the way still crosses the border", style="bold red")
            return 1
        if entered or (len(after) and driven.outcome != "reached"):
            told = "entered the border" if entered else f"did not get to the goal: {driven.outcome}"
            self.console.print(f"the robot {told}", style="bold red")
            return 1
        self.console.print(
            "the robot went round the border" if len(after) else "no way crosses the border: the goal is out of reach now",
            style="bold green",
        )
        return 0

    def _say(self, text: str) -> None:
        self._narrator.say(text)


def _pose(pose: Tuple[float, float, float]) -> Tuple[float, float, float]:
    return pose[0], pose[1], math.radians(pose[2])


def _chain(observer: Observer, border_id: str) -> np.ndarray:
    """(N, 2) [m] the stored border's chain, its first point repeated if it is a polygon; empty if there is none."""
    for border in observer.borders:
        if border.id == border_id:
            chain = messages.array_from_points(border.points)
            return np.vstack([chain, chain[:1]]) if border.kind == VirtualBorder.POLYGON else chain
    return np.zeros((0, 2))


if __name__ == "__main__":
    sys.exit(main())
