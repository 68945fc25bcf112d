"""Draws what differs between people from the distributions of the configuration."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
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
        rest = dict(spec)
        low, high = float(rest.pop("low", -math.inf)), float(rest.pop("high", math.inf))
        ((kind, values),) = rest.items()
        if kind == "mixture":
            shares = np.array([float(part.get("share", 0.0)) for part in values])
            chosen = values[int(rng.choice(len(shares), p=shares / shares.sum()))]
            value = draw(key, {name: entry for name, entry in chosen.items() if name != "share"}, rng)
        elif kind == "scaled":
            value = float(values[1]) * draw(key, values[0], rng)
        else:
            value = _KINDS[kind](rng, *(float(entry) for entry in values))
    except ParameterError:
        raise
    except (TypeError, ValueError, KeyError, AttributeError):
        raise ParameterError(
            key, f"expected a number, or one of mixture, scaled, {', '.join(_KINDS)}, got {spec!r}"
        ) from None
    return min(max(value, low), high)


_KINDS: Dict[str, Callable[[np.random.Generator, float, float], float]] = {
    "uniform": lambda rng, low, high: float(rng.uniform(low, high)),
    "normal": lambda rng, mean, spread: float(rng.normal(mean, spread)),
    "lognormal": lambda rng, median, spread: median * math.exp(spread * float(rng.standard_normal())),
}

# what makes a mapping a distribution
KINDS = {"mixture", "scaled", *_KINDS}


class Population:
    """Draws participants: each trait from its own distribution.

    Args:
        settings: the section `participants` of the configuration. `traits` and `body`: a key of that section of
            vb_sim's models.yaml to its distribution; `stand_offset`, `margin`: distributions [m].
        model: what all participants have in common.

    Raises:
        ParameterError: names the key.
    """

    def __init__(self, settings: Mapping[str, Any], model: ParticipantModel) -> None:
        for key in settings:
            if key not in ("traits", "body", "stand_offset", "margin"):
                raise ParameterError(f"participants/{key}", "unknown key; known are traits, body, stand_offset, margin")
        self._model, self._settings = model, settings
        self._traits, self._body = (settings.get(part) or {} for part in ("traits", "body"))
        for part, specs, kind in (("traits", self._traits, ParticipantModel), ("body", self._body, BodyProportions)):
            for key in specs:
                if key not in [field.name for field in fields(kind)]:
                    raise ParameterError(f"participants/{part}/{key}", f"unknown trait of {kind.__name__}")

    def draw(self, streams: Streams) -> Traits:
        """Draws a participant; the same for the same streams."""
        values: Dict[str, Any] = {
            key: draw(f"participants/traits/{key}", spec, streams(key)) for key, spec in self._traits.items()
        }
        for key in ("drawing_speed", "tremor_band"):
            # models.yaml gives these as ranges; a person has one speed
            if key in values:
                values[key] = (values[key], values[key])
        mapping = {**{field.name: getattr(self._model, field.name) for field in fields(self._model)}, **values}
        body = {key: draw(f"participants/body/{key}", spec, streams(f"body {key}")) for key, spec in self._body.items()}
        stand = streams("stand")
        offset = tuple(self._length("stand_offset", stand) for _ in range(2))
        return Traits(
            ParticipantModel(**_possible(ParticipantModel, mapping)),
            BodyProportions(**_possible(BodyProportions, body)),
            offset,
            self._length("margin", streams("margin")),
        )

    def _length(self, key: str, rng: np.random.Generator) -> float:
        return draw(f"participants/{key}", self._settings.get(key, 0.0), rng)


def _possible(cls: Type[Parameters], values: Mapping[str, Any]) -> Dict[str, Any]:
    """Values within the limits of a parameter class: no person is 4 m tall, whatever was drawn and scaled."""
    limits = {field.name: field.metadata for field in fields(cls)}
    kept = dict(values)
    for key, value in values.items():
        low, high = limits[key].get("low"), limits[key].get("high")
        if isinstance(value, float):
            kept[key] = min(max(value, low if low is not None else value), high if high is not None else value)
    return kept
