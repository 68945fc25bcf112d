"""Who takes part: what differs between people, drawn from the distributions of the configuration."""
from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any, Callable, Dict, Mapping, Tuple, Type

import numpy as np

from vb_core.errors import ParameterError
from vb_core.parameters import Parameters
from vb_sim.room.bodies import Build
from vb_sim.room.models_participant import ParticipantModel

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
    body: Build = Build()
    stand_offset: Tuple[float, float] = (0.0, 0.0)
    margin: float = 0.0


class Distribution:
    """One trait's distribution, as the configuration writes it.

    A number is the same for everybody. {uniform: [low, high]}, {normal: [mean, standard deviation]} and
    {lognormal: [median, standard deviation of the logarithm]} are drawn; `low` and `high` beside them are limits.
    {scaled: [distribution, factor]} is another distribution's value times a factor, beyond its limits too;
    {mixture: [{share: 0.7, normal: ...}, ...]} draws one of several distributions, for instance men's and women's.

    Raises:
        ParameterError: names the trait.
    """

    def __init__(self, key: str, spec: Any) -> None:
        self._key = key
        self._limits = (-math.inf, math.inf)
        if isinstance(spec, (int, float)) and not isinstance(spec, bool):
            self._kind, self._values = "fixed", (float(spec),)
            return
        if not isinstance(spec, Mapping):
            raise ParameterError(key, f"expected a number or a distribution, got {spec!r}")
        rest = dict(spec)
        self._limits = (float(rest.pop("low", -math.inf)), float(rest.pop("high", math.inf)))
        if len(rest) != 1:
            raise ParameterError(key, f"expected one of uniform, normal, lognormal, mixture, scaled, got {spec!r}")
        self._kind, values = rest.popitem()
        if self._kind == "mixture":
            parts = [dict(part) for part in values]
            self._parts = [(float(part.pop("share", 0.0)), Distribution(key, part)) for part in parts]
            return
        if self._kind == "scaled":
            self._parts = [(float(values[1]), Distribution(key, values[0]))]
            return
        if self._kind not in ("uniform", "normal", "lognormal"):
            raise ParameterError(key, f"'{self._kind}' is unknown; known are uniform, normal, lognormal, mixture")
        if not isinstance(values, (list, tuple)) or len(values) != 2:
            raise ParameterError(key, f"expected two numbers for {self._kind}, got {values!r}")
        self._values = (float(values[0]), float(values[1]))

    def draw(self, rng: np.random.Generator) -> float:
        """One value."""
        if self._kind == "mixture":
            shares = np.array([share for share, _ in self._parts])
            value = self._parts[int(rng.choice(len(shares), p=shares / shares.sum()))][1].draw(rng)
        elif self._kind == "scaled":
            value = self._parts[0][0] * self._parts[0][1].draw(rng)
        elif self._kind == "fixed":
            value = self._values[0]
        elif self._kind == "uniform":
            value = float(rng.uniform(*self._values))
        elif self._kind == "normal":
            value = float(rng.normal(*self._values))
        else:
            value = self._values[0] * math.exp(self._values[1] * float(rng.standard_normal()))
        return min(max(value, self._limits[0]), self._limits[1])


class Population:
    """Draws participants: each trait from its own distribution.

    Args:
        settings: the section `participants` of the configuration. `traits` and `body`: a key of that section of vb_sim's
            models.yaml to its distribution; `stand_offset`, `margin`: distributions [m].
        model: what all participants have in common.

    Raises:
        ParameterError: names the key.
    """

    def __init__(self, settings: Mapping[str, Any], model: ParticipantModel) -> None:
        for key in settings:
            if key not in ("traits", "body", "stand_offset", "margin"):
                raise ParameterError(f"participants/{key}", "unknown key; known are traits, body, stand_offset, margin")
        self._model = model
        self._traits = _distributions("participants/traits", settings.get("traits"), ParticipantModel)
        self._body = _distributions("participants/body", settings.get("body"), Build)
        self._offset = Distribution("participants/stand_offset", settings.get("stand_offset", 0.0))
        self._margin = Distribution("participants/margin", settings.get("margin", 0.0))

    def draw(self, streams: Streams) -> Traits:
        """A participant; the same for the same streams."""
        values: Dict[str, Any] = {key: trait.draw(streams(key)) for key, trait in self._traits.items()}
        for key in ("drawing_speed", "tremor_band"):
            # models.yaml gives these as ranges; a person has one speed
            if key in values:
                values[key] = (values[key], values[key])
        mapping = {**{field.name: getattr(self._model, field.name) for field in fields(self._model)}, **values}
        body = Build(**_possible(Build, {key: trait.draw(streams(f"body {key}")) for key, trait in self._body.items()}))
        stand = streams("stand")
        person = ParticipantModel(**_possible(ParticipantModel, mapping))
        offset = (self._offset.draw(stand), self._offset.draw(stand))
        return Traits(person, body, offset, self._margin.draw(streams("margin")))


def _possible(cls: Type[Parameters], values: Mapping[str, Any]) -> Dict[str, Any]:
    """Values within the limits of a parameter class: no person is 4 m tall, whatever was drawn and scaled."""
    limits = {field.name: field.metadata for field in fields(cls)}
    kept = dict(values)
    for key, value in values.items():
        low, high = limits[key].get("low"), limits[key].get("high")
        if isinstance(value, float):
            kept[key] = min(max(value, low if low is not None else value), high if high is not None else value)
    return kept


def _distributions(where: str, specs: Any, cls: Type[Parameters]) -> Dict[str, Distribution]:
    known = [field.name for field in fields(cls)]
    for key in specs or {}:
        if key not in known:
            raise ParameterError(f"{where}/{key}", f"unknown trait; known are {', '.join(known)}")
    return {key: Distribution(f"{where}/{key}", spec) for key, spec in (specs or {}).items()}
