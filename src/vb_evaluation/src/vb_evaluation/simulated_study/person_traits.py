"""Draws people's individual traits from the distributions in the configuration."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import Any, Callable, Dict, Mapping, Tuple, Type

import numpy as np

from vb_core.errors import ParameterError
from vb_core.parameters import Parameters
from vb_sim.models import BodyProportions, ParticipantModel

# a random generator for each name: drawing from one leaves all others unchanged
Streams = Callable[[str], np.random.Generator]


@dataclass(frozen=True)
class Traits:
    """One participant.

    Attributes:
        model: how the person walks, points, speaks and errs.
        body: how tall and broad the person is.
        stand_offset: (x, y) [m] from the scenario's place to where this person prefers to stand.
        margin: [m] how far outside of a closed border's marks this person means to draw.
    """

    model: ParticipantModel
    body: BodyProportions = BodyProportions()
    stand_offset: Tuple[float, float] = (0.0, 0.0)
    margin: float = 0.0


def draw(key: str, spec: Any, rng: np.random.Generator) -> float:
    """Draws one value of a trait's distribution, as the configuration writes it.

    A number is the same for everybody. {uniform: [low, high]}, {normal: [mean, standard deviation]} and
    {lognormal: [median, standard deviation of the logarithm]} are drawn; `low` and `high` beside them are limits.
    {scaled: [distribution, factor]} is another distribution's value times a factor, beyond its limits too;
    {mixture: [{share: 0.7, normal: ...}, ...]} draws one of several distributions, for instance men's and women's.

    Raises:
        ParameterError: names the trait.
    """
    if isinstance(spec, (int, float)) and not isinstance(spec, bool):
        return float(spec)
    try:
        parameters = dict(spec)
        low, high = float(parameters.pop("low", -math.inf)), float(parameters.pop("high", math.inf))
        ((kind, values),) = parameters.items()
        if kind == "mixture":
            shares = np.array([float(part.get("share", 0.0)) for part in values])
            chosen = values[int(rng.choice(len(shares), p=shares / shares.sum()))]
            value = draw(key, {name: entry for name, entry in chosen.items() if name != "share"}, rng)
        elif kind == "scaled":
            value = float(values[1]) * draw(key, values[0], rng)
        else:
            value = _DISTRIBUTIONS[kind](rng, *(float(entry) for entry in values))
    except (TypeError, ValueError, KeyError, AttributeError):
        raise ParameterError(
            key, f"expected a number, or one of mixture, scaled, {', '.join(_DISTRIBUTIONS)}, got {spec!r}"
        ) from None
    return min(max(value, low), high)


_DISTRIBUTIONS: Dict[str, Callable[[np.random.Generator, float, float], float]] = {
    "uniform": lambda rng, low, high: float(rng.uniform(low, high)),
    "normal": lambda rng, mean, spread: float(rng.normal(mean, spread)),
    "lognormal": lambda rng, median, spread: median * math.exp(spread * float(rng.standard_normal())),
}

# the keys that make a mapping a distribution
DISTRIBUTIONS = {"mixture", "scaled", *_DISTRIBUTIONS}


def draw_traits(settings: Mapping[str, Any], model: ParticipantModel, streams: Streams) -> Traits:
    """Draws a participant, each trait from its own distribution; the same for the same streams.

    Args:
        settings: the section `participants` of the configuration. `traits` and `body` map keys of vb_sim's
            models.yaml to distributions; `stand_offset` and `margin` are distributions [m].
        model: what all participants have in common.

    Raises:
        ParameterError: names the key.
    """
    for key in settings:
        if key not in ("traits", "body", "stand_offset", "margin"):
            raise ParameterError(f"participants/{key}", "unknown key; known are traits, body, stand_offset, margin")
    drawn: Dict[str, Dict[str, Any]] = {}
    for part, kind, stream in (("traits", ParticipantModel, ""), ("body", BodyProportions, "body ")):
        specs = settings.get(part) or {}
        for key in specs:
            if key not in [field.name for field in fields(kind)]:
                raise ParameterError(f"participants/{part}/{key}", f"unknown trait of {kind.__name__}")
        drawn[part] = {
            key: draw(f"participants/{part}/{key}", spec, streams(stream + key)) for key, spec in specs.items()
        }
    traits = drawn["traits"]
    # models.yaml gives these as ranges; a person has one speed
    traits.update({key: (traits[key],) * 2 for key in ("drawing_speed", "tremor_band") if key in traits})

    def length(key: str, rng: np.random.Generator) -> float:
        return draw(f"participants/{key}", settings.get(key, 0.0), rng)

    stand = streams("stand")
    return Traits(
        replace(model, **_possible(ParticipantModel, traits)),
        BodyProportions(**_possible(BodyProportions, drawn["body"])),
        (length("stand_offset", stand), length("stand_offset", stand)),
        length("margin", streams("margin")),
    )


def _possible(cls: Type[Parameters], values: Mapping[str, Any]) -> Dict[str, Any]:
    """Clips values to the limits of a parameter class: no person is 4 m tall, whatever was drawn and scaled."""
    limits = {field.name: field.metadata for field in fields(cls)}
    clipped = dict(values)
    for key, value in values.items():
        low, high = limits[key].get("low"), limits[key].get("high")
        if isinstance(value, float):
            clipped[key] = min(max(value, low if low is not None else value), high if high is not None else value)
    return clipped
