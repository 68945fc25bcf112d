"""Replays a recording to today's nodes and compares their results with the recorded ones.

The one idea: the recording is played to the live system's own nodes in one process (vb_evaluation.virtual_ros),
started from the live system's launch files. So a replay has the nodes, parameters and rules of today, and
nothing is wired a second time.
"""

from __future__ import annotations

import math
import tempfile
from collections import Counter
from dataclasses import dataclass, field
from typing import Any, Dict, Iterator, List, NamedTuple, Optional, Union

import numpy as np
import rosbag
import rospy
import shapely

from vb_core import names
from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_core.ros import messages, services
from vb_core.vocabulary import DEFAULT
from vb_evaluation import metrics
from vb_evaluation.study_kit.recording import Recording
from vb_evaluation.study_kit.session import ROBOT_IMAGES
from vb_evaluation.provenance import repository_top
from vb_evaluation.virtual_ros.graph import Graph, Node
from vb_evaluation.virtual_ros.launching import import_nodes, start_launch
from vb_evaluation.virtual_ros.scheduler import Scheduler
from vb_map_integration.border import VirtualBorder
from vb_map_integration.integration import integrate
from vb_msgs.msg import BorderProgress, InteractionState, LaserSpot, VirtualBorder as BorderMessage
from vb_msgs.srv import GetDrawnBorder, GetDrawnBorderRequest

PARTS = repository_top() / "launch" / "parts"
# the recording says what people commanded and where the robot was
WITHOUT = ("interaction_manager", "map_integrator", "map_recorder", "robot_driver", "camera_poses")
TICK_NS = 10_000_000
BEFORE_NS = 10**9  # nodes listen before the first message comes
SETTLED_NS = 400_000_000  # spots and progress of the last images are through


class RecordedMessage(NamedTuple):
    """A message as the bag holds it."""

    topic: str
    kind: str
    definition: str
    data: bytes
    time_ns: int


@dataclass
class CameraCounts:
    """What one camera saw: images, spots that today's detector finds in them, and spots that were recorded."""

    images: int = 0
    today: int = 0
    recorded: int = 0


@dataclass
class ReplayResult:
    """What today's nodes made of a recording.

    Attributes:
        borders: by interaction, the border, or why there is none.
        spots: by interaction, how many were collected, border and seed.
        found: the spots that went to them.
        cameras: counts of each, if the images were played.
    """

    borders: Dict[str, Union[VirtualBorder, CodedError]] = field(default_factory=dict)
    spots: Dict[str, int] = field(default_factory=dict)
    found: List[LaserSpot] = field(default_factory=list)
    cameras: Dict[str, CameraCounts] = field(default_factory=dict)


@dataclass(frozen=True)
class Comparison:
    """One interaction, recorded and replayed.

    Attributes:
        outcome: as recorded.
        spots: that the replay collected, border and seed.
        code: "ok", or why today's code makes no border from them.
        agreement: Jaccard index between the recorded area and today's.
        chain_distance_m: [m] Hausdorff distance between both chains.
        recorded, today: Jaccard index of each against the ground truth.
            Each is nan where there is nothing to compare.
    """

    interaction: str
    outcome: str
    spots: int
    code: str
    message: str = ""
    agreement: float = math.nan
    chain_distance_m: float = math.nan
    recorded: float = math.nan
    today: float = math.nan


# ---------------------------------------------------------------- bags
def read_messages(recording: Recording) -> Iterator[RecordedMessage]:
    """Yields all messages of all bags in the order in which they arrived.

    Raises:
        CodedError: "bad_recording" for a missing or damaged bag.
    """
    if not recording.bags:
        raise CodedError(
            "bad_recording", f"{recording.folder}: there is no bag: was it recorded with record:=<folder>?"
        )
    for path in recording.bags:
        try:
            with rosbag.Bag(str(path)) as bag:
                for topic, entry, stamp in bag.read_messages(raw=True):
                    yield RecordedMessage(topic, entry[0], entry[2], entry[1], stamp.to_nsec())
        except rosbag.ROSBagUnindexedException:
            raise CodedError("bad_recording", f"{path} was not closed: run 'rosbag reindex {path}'") from None
        except (rosbag.ROSBagException, OSError) as error:
            raise CodedError("bad_recording", f"cannot read {path}: {error}") from None


def decode_message(entry: RecordedMessage, kind: type) -> Any:
    """Decodes a recorded message as a type of today."""
    message = kind()
    try:
        message.deserialize(entry.data)
    except Exception as error:  # genpy raises whatever its bytes lead to
        raise CodedError("bad_recording", f"{entry.topic}: {error}") from None
    return message


def physical_map(recording: Recording) -> Optional[GridMap]:
    """Returns the newest physical map of the bags; None if there is none."""
    found = None
    for entry in read_messages(recording):
        found = entry if entry.topic == names.PHYSICAL_MAP else found
    return messages.grid_from_message(decode_message(found, messages.OccupancyGridArray)) if found else None


# ---------------------------------------------------------------- playing
class _Player:
    """Plays a recording to the nodes of a graph, as a node of it."""

    def __init__(self, graph: Graph, recording: Recording, images: Dict[str, str], result: ReplayResult) -> None:
        self._graph, self._scheduler = graph, graph.scheduler
        self._recording, self._images, self._result = recording, images, result
        self._current = ""
        rospy.Subscriber(names.PROGRESS, BorderProgress, self._on_progress)
        rospy.Subscriber(names.SPOTS, LaserSpot, self._on_spot)

    def _on_progress(self, message: BorderProgress) -> None:
        if message.interaction_id:
            self._result.spots[message.interaction_id] = message.border_spots + message.seed_spots

    def _on_spot(self, message: LaserSpot) -> None:
        self._result.found.append(message)
        if message.camera in self._result.cameras:
            self._result.cameras[message.camera].today += 1

    def _until(self, time_ns: int) -> None:
        while self._scheduler.now_ns < time_ns:
            self._scheduler.wait(min(TICK_NS, time_ns - self._scheduler.now_ns))
            self._graph.set_clock(rospy.Time(self._scheduler.now_ns // 10**9, self._scheduler.now_ns % 10**9))

    def play(self) -> None:
        """Replays from the first message to the last."""
        for entry in read_messages(self._recording):
            self._until(entry.time_ns)
            self._give(entry)
        self._request("")

    def _give(self, entry: RecordedMessage) -> None:
        topic, counts = entry.topic, self._result.cameras
        if topic == names.STATE:
            # a cancelled drawing is forgotten with the state's end
            message = decode_message(entry, InteractionState)
            self._request("" if message.name == DEFAULT.name else message.interaction_id)
        elif topic == names.SPOTS and counts:
            camera = decode_message(entry, LaserSpot).camera
            if camera in counts:
                counts[camera].recorded += 1
            return
        elif topic in self._images:
            counts[self._images[topic]].images += 1
        self._graph.play(topic, entry.kind, entry.definition, entry.data)

    def _request(self, next_one: str) -> None:
        """Requests the border of the interaction that is about to end."""
        if self._current and self._current != next_one:
            self._until(self._scheduler.now_ns + SETTLED_NS)
            request = GetDrawnBorderRequest(interaction_id=self._current)
            answer = services.call(names.GET_DRAWN_BORDER, GetDrawnBorder, request, "$border_fusion")
            self._result.borders[self._current] = _border(answer)
        self._current = next_one


def _border(answer: Any) -> Union[VirtualBorder, CodedError]:
    if not answer.success:
        return CodedError(answer.code, answer.message)
    border = answer.border
    return VirtualBorder(
        messages.array_from_points(border.points),
        (border.seed.x, border.seed.y),
        closed=border.kind == BorderMessage.POLYGON,
    )


def replay(recording: Recording, images: bool = False) -> ReplayResult:
    """Plays a recording to today's nodes.

    Args:
        images: finds the spots again in the recorded images; else the recorded spots are played.

    Raises:
        CodedError: "bad_recording".
    """
    session = recording.session
    ceiling = list(session.get("cameras") or []) if images else []
    robots = [str(robot).strip("/") for robot in session.get("robots", [""])] if images else []
    held: Counter = Counter()
    first = None
    for entry in read_messages(recording):
        first = entry.time_ns if first is None else first
        held[entry.topic] += 1
    topics = {f"/{camera}/image_raw": camera for camera in ceiling}
    topics.update(
        {f"/{robot}/{ROBOT_IMAGES[0]}" if robot else f"/{ROBOT_IMAGES[0]}": robot or "robot" for robot in robots}
    )
    packed = {f"{topic}/compressed": camera for topic, camera in topics.items()}
    played = {topic: camera for topic, camera in {**topics, **packed}.items() if held[topic]}
    if images and not played:
        raise CodedError(
            "bad_recording",
            f"{recording.folder}: no images were recorded: record with record_images:=raw or compressed",
        )
    result = ReplayResult(cameras={camera: CameraCounts() for camera in topics.values()} if images else {})
    launches = [("borders.launch", {"state": "", "robot_frames": "", "record": "false"})]
    if ceiling:
        launches.append(
            ("perception.launch", {"cameras": " ".join(ceiling), "robots": " ".join(robot or "/" for robot in robots)})
        )
    if robots:
        launches.append(("robots.launch", {"robots": " ".join(filter(None, robots))}))
    for name, arguments in launches:
        import_nodes(PARTS / name, arguments, WITHOUT)
    graph = Graph(Scheduler((first or BEFORE_NS) - BEFORE_NS), {})
    with tempfile.TemporaryDirectory() as state, graph.installed():
        graph.set_clock(rospy.Time(graph.scheduler.now_ns // 10**9, graph.scheduler.now_ns % 10**9))
        for name, arguments in launches:
            start_launch(
                graph, PARTS / name, {**arguments, **({"state": state} if "state" in arguments else {})}, WITHOUT
            )
        for topic in played:
            if topic in packed:
                graph.parameters.set_param(f"/spot_detector_{packed[topic]}/image_transport", "compressed")
        over: List[bool] = []
        graph.start(Node("/player", {}), lambda: over.append(_Player(graph, recording, played, result).play() is None))
        graph.scheduler.run(lambda: bool(over), 2**63 - 1)
    return result


# ---------------------------------------------------------------- comparing
def compare(
    recording: Recording, today: ReplayResult, physical: Optional[GridMap] = None, truth: Optional[np.ndarray] = None
) -> List[Comparison]:
    """Compares each interaction of a recording, as it was recorded, with what today's nodes make of it.

    Args:
        physical: the physical map; None takes the recording's.
        truth: (H, W) bool, what was asked for.
    """
    physical = physical or recording.physical()
    return [_compared(recording, interaction, today, physical, truth) for interaction in recording.interactions]


def _compared(
    recording: Recording, interaction: Any, today: ReplayResult, physical: GridMap, truth: Optional[np.ndarray]
) -> Comparison:
    border = today.borders.get(interaction.id, CodedError("not_recorded", "the bag does not hold this interaction"))
    made = recording.result(interaction)
    before = metrics.restricted_cells(physical, made[0]) if made else None
    after, error = None, border if isinstance(border, CodedError) else None
    if error is None:
        try:
            after = integrate(physical, border).region
        except CodedError as refused:
            error = refused

    def index(one: Optional[np.ndarray], other: Optional[np.ndarray]) -> float:
        return metrics.jaccard(one, other) if one is not None and other is not None else math.nan

    return Comparison(
        interaction.id,
        interaction.outcome,
        today.spots.get(interaction.id, 0),
        error.code if error else "ok",
        error.message if error else "",
        index(before, after),
        _distance(made[1], border) if made and after is not None else math.nan,
        index(truth, before),
        index(truth, after),
    )


def _distance(a: VirtualBorder, b: VirtualBorder) -> float:
    """Computes the distance [m] between two chains."""
    lines = [
        shapely.linestrings(np.vstack([border.points, border.points[:1]]) if border.closed else border.points)
        for border in (a, b)
    ]
    return float(shapely.hausdorff_distance(lines[0], lines[1], densify=0.05))
