"""Carries out one run (participant, scenario, method) with the live system's own nodes (vb_sim.in_process_ros)."""

from __future__ import annotations

import contextlib
import json
import tempfile
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Callable, ContextManager, Dict, List, Optional, Tuple

import numpy as np
import rospy
from nav_msgs.msg import OccupancyGrid

from vb_core import names
from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_core.ros import commands, parameters
from vb_core.ros.messages import NumpyOccupancyGrid, grid_from_message
from vb_sim.in_process_ros.launch_file import import_nodes, start_launch
from vb_sim.in_process_ros.rospy_stand_in import Graph, Node
from vb_sim.in_process_ros.threading_stand_in import Scheduler, replace_temporarily
from vb_evaluation.repository_revision import repository_root
from vb_evaluation.simulated_study.config import METHODS, Study, Traits
from vb_evaluation.simulated_study.run_plan import Job
from vb_evaluation.simulated_study.study_camera_node import RenderCache, StudyCeilingCameras, StudyRobotCamera
from vb_fusion import extraction
from vb_msgs.msg import LaserSpot, VirtualBorderArray
from vb_sim.lab_simulator_node import LabSimulatorNode, LabSimulatorParams
from vb_sim.map_server_node import MapServerNode
from vb_sim.participant_node import ParticipantNode
from vb_sim.person.hand import perceive_border
from vb_sim.person.participant_methods import make_script
from vb_sim.person.walking import distance_to_chain
from vb_sim.robot.path_planner import Costmap, Planner
from vb_sim import floor_plan
from vb_sim.world import Scenario
from vb_sim.simulated_lab import SimulatedLab

LAUNCH = repository_root() / "launch" / "simulation.launch"
# no other node depends on what these publish or store
OMITTED = ("display_markers", "feedback", "camera_poses")
MIN_STAND_DISTANCE = 0.4  # [m] people do not stand on what they draw
START_NS = 1_000_000_000_000  # keeps every timestamp away from zero, which would mean none
WARM_UP_TIME = 2.0  # [s] for every node to hear of the others before the person comes in
_LONGEST_END_NS = 600 * 10**9


class LiveRun:
    """A lab with one participant, and the live system in it. Its attributes are complete once `run` has ended.

    Attributes:
        scenario: the scenario as this person sees it, by `personal_scenario`.
        truth: (H, W) bool, the cells to restrict.
        prior, posterior: the map without and with borders.
        saved_seed: (x, y) [m] of the border that was saved; None if none was.
        spots: every spot that a camera reported.
        script: the person's actions, intention and success.
        records: the interaction manager's log of all interactions of the run, cancelled ones included.
        too_bright: whether a ceiling camera was too bright, by the lab's own check, before anybody came.
    """

    def __init__(self, study: Study, job: Job) -> None:
        world = study.world
        traits = study.traits(job.participant)
        marks = study.marks(job.participant, job.scenario)
        self._study = study
        self._models = replace(study.models, body=traits.body)
        self._random_seed = study.run_seed(job.participant)
        self._cameras = METHODS[job.method](world)
        self._method = job.method
        self._ended = False
        self.prior = self.posterior = floor_plan.physical_map(world)
        self.scenario = personal_scenario(world.scenario(job.scenario), traits, self.prior, marks)
        self.truth = floor_plan.ground_truth(world, self.scenario)
        self.lab = SimulatedLab(world, study.models, self._random_seed)
        self.script = make_script(world, self.scenario, traits.model, job.method, self._random_seed)
        self.too_bright = False
        self.saved_seed: Optional[Tuple[float, float]] = None
        self.spots: List[LaserSpot] = []
        self.records: List[Dict[str, Any]] = []

    def run(self) -> LiveRun:
        """Runs until the person is done, or time is up. The result depends on study and job alone, not on earlier runs."""
        render_cache().enter(self._study.world, self._models)
        timing = self._study.timing
        scheduler = Scheduler(START_NS)
        delays = {names.COMMAND: timing.command_s, names.GET_DRAWN_BORDER: timing.save_s, names.SPOTS: timing.spot_s}
        graph = Graph(scheduler, delays)
        arguments = self._launch_arguments()
        lab_nodes = self._lab_nodes()
        import_nodes(LAUNCH, arguments, (*OMITTED, *lab_nodes))
        with contextlib.ExitStack() as stack:
            state = stack.enter_context(tempfile.TemporaryDirectory())
            stack.enter_context(graph.installed())
            stack.enter_context(_delayed_extraction(scheduler, timing.extraction_s))
            graph.start(Node("/study", {}), self._watch)
            start_launch(graph, LAUNCH, {**arguments, "state": state}, OMITTED, lab_nodes)
            graph.start(Node("/participant", {}), self._bring_participant)
            until = START_NS + int((WARM_UP_TIME + timing.time_limit_s) * 1e9)
            scheduler.run(lambda: self.script.outcome != "", until)
            graph.start(Node("/study", {}), self._end)
            scheduler.run(lambda: self._ended, scheduler.now_ns + _LONGEST_END_NS)
            log = Path(state) / "interactions.jsonl"
            self.records += map(json.loads, log.read_text(encoding="utf-8").splitlines() if log.exists() else ())
        return self

    # ------------------------------------------------------------- what is started
    def _launch_arguments(self) -> Dict[str, str]:
        robots = (robot.namespace.strip("/") for robot in self._study.world.robots)
        return {
            "world": "study",
            "cameras": " ".join(self._cameras) or "none",
            "method": self._method,
            "robots": " ".join(filter(None, robots)),
            "rviz": "false",
            "page": "false",
            "state": "",
        }

    def _lab_nodes(self) -> Dict[str, Callable[[], Any]]:
        """Returns, by type of node, what runs instead of the simulated lab's scripts."""
        world = self._study.world
        idle_every = self._study.timing.idle_every

        def ceiling_cameras() -> None:
            shown = [world.camera(name) for name in self._cameras]
            self.too_bright = StudyCeilingCameras(render_cache(), shown, self._random_seed, idle_every).too_bright

        def robot_camera() -> None:
            name, prefix = rospy.get_param("~robot", ""), rospy.get_param("~tf_prefix", "")
            robot = world.robot(name) if name else world.robots[0]
            StudyRobotCamera(render_cache(), robot, self._random_seed, prefix, idle_every)

        return {
            "lab_simulator": lambda: LabSimulatorNode(self.lab, parameters.read(LabSimulatorParams)),
            "ceiling_cameras": ceiling_cameras,
            "robot_camera": robot_camera,
            "map_server": lambda: MapServerNode(self.prior),
        }

    def _bring_participant(self) -> None:
        rospy.rostime.wallsleep(WARM_UP_TIME)
        ParticipantNode(self.script, laser_color="red")

    # ------------------------------------------------------------- what is measured
    def _watch(self) -> None:
        """Subscribes to the topics from which a run is measured."""
        rospy.Subscriber(names.MAP_WITH_BORDERS, NumpyOccupancyGrid, self._on_map)
        rospy.Subscriber(names.BORDERS, VirtualBorderArray, self._on_borders)
        rospy.Subscriber(names.SPOTS, LaserSpot, self.spots.append)

    def _on_map(self, message: OccupancyGrid) -> None:
        self.posterior = grid_from_message(message)

    def _on_borders(self, message: VirtualBorderArray) -> None:
        for border in message.borders:
            self.saved_seed = (border.seed.x, border.seed.y)

    def _end(self) -> None:
        """Waits until a saved border has arrived. Cancels an unfinished interaction, so that the log has its time."""
        if self.script.outcome != "saved":
            with contextlib.suppress(CodedError):
                commands.send(commands.make_request("cancel", "study", 5.0))
        rospy.rostime.wallsleep(0.5)
        self._ended = True


def _delayed_extraction(scheduler: Scheduler, seconds: float) -> ContextManager[None]:
    """Makes each extraction of a border take this long [s] in simulated time."""
    extract = extraction.extract_border

    def extract_and_wait(*args: Any, **kwargs: Any) -> Any:
        try:
            return extract(*args, **kwargs)
        finally:
            scheduler.wait(int(seconds * 1e9))

    return replace_temporarily({extraction: {"extract_border": extract_and_wait}})


def personal_scenario(scenario: Scenario, traits: Traits, grid: GridMap, marks: Tuple[float, float, float]) -> Scenario:
    """Returns the scenario as this person sees it: the border by the marks on the floor, and where the person stands.

    The person's position is near the common one, on free floor, off the border. The ground truth stays the map's.

    Args:
        marks: (dx, dy) [m], turn [rad] by which the marks are off the map.
    """
    border = perceive_border(scenario.border, scenario.closed, marks[:2], marks[2], traits.margin)
    scenario = replace(scenario, border=border)
    planner = Planner(Costmap(grid, traits.model.body_radius))
    line = np.vstack([scenario.border, scenario.border[:1]]) if scenario.closed else scenario.border
    for share in (1.0, 0.75, 0.5, 0.25):
        stand = scenario.stand + share * np.array(traits.stand_offset)
        if planner.is_traversable(stand) and distance_to_chain(stand, line) >= MIN_STAND_DISTANCE:
            return replace(scenario, stand=stand)
    return scenario


@lru_cache(maxsize=1)
def render_cache() -> RenderCache:
    """Returns the rendered room, which all runs of this process share."""
    return RenderCache()
