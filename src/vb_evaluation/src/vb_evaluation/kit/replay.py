"""Runs today's point set, extraction and integration on recorded spots; compares with the recording."""
from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Dict, Iterable, List, Optional, Union

import numpy as np
import shapely

from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_evaluation import metrics
from vb_evaluation.kit.recording import Recording
from vb_fusion.collector import Collection, Collector, CollectorParams, Spot
from vb_fusion.extraction import ExtractionParams
from vb_fusion.live_extraction import extract_chain, extract_seed_of
from vb_map_integration.border import VirtualBorder
from vb_map_integration.integration import IntegrationParams, integrate


@dataclass(frozen=True)
class StateChange:
    """A message on /virtual_borders/state, as far as the point set uses it."""

    state: str
    interaction_id: str
    entered: float
    outcome: str = ""


Event = Union[StateChange, Spot]


@dataclass(frozen=True)
class Settings:
    """Parameters of today's code."""

    collector: CollectorParams = field(default_factory=CollectorParams)
    extraction: ExtractionParams = field(default_factory=ExtractionParams.robust)
    integration: IntegrationParams = field(default_factory=IntegrationParams)


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


def collections(events: Iterable[Event], params: CollectorParams) -> Dict[str, Collection]:
    """The point set of each interaction, as it stood when the interaction ended.

    Args:
        events: in the order in which they arrived.
    """
    collector = Collector(params)
    found: Dict[str, Collection] = {}
    for event in events:
        if isinstance(event, Spot):
            collector.add(event)
            continue
        if event.state == "default" and collector.state != "default":
            found[collector.interaction_id] = collector.collection()
        collector.set_state(event.state, event.interaction_id, event.entered)
    if collector.state != "default":  # the recording ended before the interaction
        found[collector.interaction_id] = collector.collection()
    return found


def border_of(collection: Collection, params: ExtractionParams) -> VirtualBorder:
    """Today's border of a point set.

    Raises:
        CodedError: why there is none.
    """
    chain = extract_chain(collection, params)
    return VirtualBorder(chain.points, extract_seed_of(collection), closed=chain.closed)


def compare(
    recording: Recording,
    events: Iterable[Event],
    settings: Optional[Settings] = None,
    physical: Optional[GridMap] = None,
    truths: Optional[Dict[str, np.ndarray]] = None,
) -> List[Comparison]:
    """Replays every interaction of a recording.

    Args:
        physical: the physical map; None takes the recording's.
        truths: (H, W) bool by interaction id, the ground truths.
    """
    settings = settings or Settings()
    physical = physical or recording.physical()
    drawn = collections(events, settings.collector)
    results = []
    for interaction in recording.interactions:
        collection = drawn.get(interaction.id)
        truth = (truths or {}).get(interaction.id)
        if collection is None:
            results.append(
                Comparison(
                    interaction.id, interaction.outcome, 0, "not_recorded", "the bag does not hold this interaction"
                )
            )
            continue
        spots = collection.border_total + collection.seed_total
        made = recording.result(interaction)
        before = metrics.restricted_cells(physical, made[0]) if made else None
        recorded = metrics.jaccard(truth, before) if truth is not None and before is not None else math.nan
        try:
            border = border_of(collection, settings.extraction)
            after = integrate(physical, border, settings.integration).region
        except CodedError as error:
            results.append(
                Comparison(interaction.id, interaction.outcome, spots, error.code, error.message, recorded=recorded)
            )
            continue
        results.append(
            Comparison(
                interaction.id,
                interaction.outcome,
                spots,
                "ok",
                "",
                metrics.jaccard(before, after) if before is not None else math.nan,
                _distance(made[1], border) if made else math.nan,
                recorded,
                metrics.jaccard(truth, after) if truth is not None else math.nan,
            )
        )
    return results


def _distance(a: VirtualBorder, b: VirtualBorder) -> float:
    """[m] between two chains."""
    lines = [
        shapely.linestrings(np.vstack([border.points, border.points[:1]]) if border.closed else border.points)
        for border in (a, b)
    ]
    return float(shapely.hausdorff_distance(lines[0], lines[1], densify=0.05))
