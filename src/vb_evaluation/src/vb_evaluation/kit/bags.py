"""Reads what a replay needs from the bags of a recording."""
from __future__ import annotations

from pathlib import Path
from typing import Any, Iterator, List, Optional, Sequence, Tuple

import rosbag
import rospkg
import yaml

from vb_core import names
from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_core.ros import messages
from vb_evaluation.kit.recording import Recording
from vb_evaluation.kit.replay import Event, Settings, StateChange
from vb_fusion.collector import CollectorParams, Spot
from vb_fusion.extraction import ExtractionParams
from vb_map_integration.integration import IntegrationParams

_STATES = {0: "default", 1: "border", 2: "seed", 3: "guide"}


def messages_of(recording: Recording, topics: Sequence[str]) -> Iterator[Tuple[str, Any]]:
    """(topic, message) of all bags in the order in which they arrived.

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
                for topic, message, _ in bag.read_messages(topics=list(topics)):
                    yield topic, message
        except rosbag.ROSBagUnindexedException:
            raise CodedError("bad_recording", f"{path} was not closed: run 'rosbag reindex {path}'") from None
        except (rosbag.ROSBagException, OSError) as error:
            raise CodedError("bad_recording", f"cannot read {path}: {error}") from None


def events(recording: Recording) -> Iterator[Event]:
    """States and spots as they were recorded."""
    for topic, message in messages_of(recording, (names.STATE, names.SPOTS)):
        yield state_change(message) if topic == names.STATE else spot(message)


def state_change(message: Any) -> StateChange:
    """vb_msgs/InteractionState as an event."""
    return StateChange(
        _STATES.get(message.state, "default"), message.interaction_id, message.entered.to_sec(), message.last_outcome
    )


def spot(message: Any) -> Spot:
    """vb_msgs/LaserSpot as an event."""
    return Spot(
        message.header.stamp.to_sec(), message.position.x, message.position.y, message.camera,
        float(message.confidence), bool(message.mobile),
    )


def physical_map(recording: Recording) -> Optional[GridMap]:
    """The newest physical map of the bags; None if there is none."""
    found: List[GridMap] = [
        messages.grid_from_message(message) for _, message in messages_of(recording, (names.PHYSICAL_MAP,))
    ]
    return found[-1] if found else None


def todays_settings() -> Settings:
    """The parameters that the nodes start with today."""
    fusion, integration = config("vb_fusion", "border_fusion"), config("vb_map_integration", "map_integrator")
    known = set(IntegrationParams.__dataclass_fields__)
    return Settings(
        CollectorParams.from_mapping(fusion.get("collector"), "border_fusion/collector"),
        ExtractionParams.from_mapping(fusion.get("extraction"), "border_fusion/extraction"),
        IntegrationParams.from_mapping(
            {key: value for key, value in integration.items() if key in known}, "map_integrator"
        ),
    )


def config(package: str, name: str) -> dict:
    """A configuration file of a package."""
    path = Path(rospkg.RosPack().get_path(package)) / "config" / f"{name}.yaml"
    return yaml.safe_load(path.read_text(encoding="utf-8")) or {}
