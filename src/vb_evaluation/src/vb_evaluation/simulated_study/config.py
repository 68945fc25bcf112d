"""Reads and checks a study's configuration, one YAML file, and samples people's traits from its distributions."""

from __future__ import annotations

import copy
import hashlib
import json
import math
import zlib
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Callable, Dict, Mapping, Optional, Tuple, Type

import numpy as np
import rospkg

from vb_core.errors import CodedError, ParameterError
from vb_core.parameters import Parameters, param
from vb_evaluation.repository_revision import repository_root
from vb_sim.model_params import BodyProportions, Models, ParticipantModel, read_document
from vb_sim.world import World, world_from_mapping

# the ceiling cameras that a method uses: the paper's uses all of them, its baseline none
METHODS: Dict[str, Callable[[World], Tuple[str, ...]]] = {
    "nrs": lambda world: tuple(camera.name for camera in world.cameras),
    "robot_only": lambda world: (),
}
PACKAGE = Path(rospkg.RosPack().get_path("vb_evaluation"))
DEFAULT = PACKAGE / "config" / "study.yaml"
# a random generator for each name: sampling with one leaves all others unchanged
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


def sample_value(key: str, spec: Any, rng: np.random.Generator) -> float:
    """Samples one value of a trait's distribution, as the configuration writes it.

    A number is the same for everybody. {uniform: [low, high]}, {normal: [mean, standard deviation]} and
    {lognormal: [median, standard deviation of the logarithm]} are sampled, within `low` and `high` if these are given.
    {scaled: [distribution, factor]} samples a distribution and multiplies the value, after its limits, by a factor.
    {mixture: [{share: 0.7, normal: ...}, ...]} samples one of several, for instance men's and women's.

    Raises:
        ParameterError: names the trait.
    """
    if isinstance(spec, (int, float)) and not isinstance(spec, bool):
        return float(spec)
    try:
        parameters = dict(spec)
        low = float(parameters.pop("low", -math.inf))
        high = float(parameters.pop("high", math.inf))
        ((kind, values),) = parameters.items()
        if kind == "mixture":
            shares = np.array([float(part.get("share", 0.0)) for part in values])
            chosen = values[int(rng.choice(len(shares), p=shares / shares.sum()))]
            value = sample_value(key, {name: entry for name, entry in chosen.items() if name != "share"}, rng)
        elif kind == "scaled":
            value = float(values[1]) * sample_value(key, values[0], rng)
        else:
            value = _DISTRIBUTIONS[kind](rng, *(float(entry) for entry in values))
    except (TypeError, ValueError, KeyError, AttributeError):
        expected = f"expected a number, or one of mixture, scaled, {', '.join(_DISTRIBUTIONS)}"
        raise ParameterError(key, f"{expected}, got {spec!r}") from None
    return min(max(value, low), high)


_DISTRIBUTIONS: Dict[str, Callable[[np.random.Generator, float, float], float]] = {
    "uniform": lambda rng, low, high: float(rng.uniform(low, high)),
    "normal": lambda rng, mean, spread: float(rng.normal(mean, spread)),
    "lognormal": lambda rng, median, spread: median * math.exp(spread * float(rng.standard_normal())),
}

# the keys that make a mapping a distribution
DISTRIBUTIONS = {"mixture", "scaled", *_DISTRIBUTIONS}


def sample_traits(settings: Mapping[str, Any], model: ParticipantModel, streams: Streams) -> Traits:
    """Samples a participant, each trait from its own distribution; the same for the same streams.

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
    traits: Dict[str, Any] = dict(_sample_section(ParticipantModel, "traits", settings, streams))
    for key in ("drawing_speed", "tremor_band"):
        if key in traits:
            # models.yaml gives these as ranges; a person has one speed
            traits[key] = (traits[key], traits[key])
    body = _sample_section(BodyProportions, "body", settings, lambda key: streams(f"body {key}"))

    def length(key: str, rng: np.random.Generator) -> float:
        return sample_value(f"participants/{key}", settings.get(key, 0.0), rng)

    stand = streams("stand")
    stand_offset = (length("stand_offset", stand), length("stand_offset", stand))
    margin = length("margin", streams("margin"))
    return Traits(replace(model, **traits), BodyProportions(**body), stand_offset, margin)


def _sample_section(
    cls: Type[Parameters], section: str, settings: Mapping[str, Any], streams: Streams
) -> Dict[str, float]:
    """Samples a section's values, clipped to the limits of its class: no person is 4 m tall, whatever was sampled."""
    limits = {field.name: field.metadata for field in fields(cls)}
    values = {}
    for key, spec in (settings.get(section) or {}).items():
        if key not in limits:
            raise ParameterError(f"participants/{section}/{key}", f"unknown trait of {cls.__name__}")
        value = sample_value(f"participants/{section}/{key}", spec, streams(key))
        low, high = limits[key].get("low"), limits[key].get("high")
        if low is not None:
            value = max(value, low)
        if high is not None:
            value = min(value, high)
        values[key] = value
    return values


@dataclass(frozen=True)
class Design(Parameters):
    """The study's size: participants, scenarios, methods and worlds."""

    seed: int = param(1, low=0)
    participants: int = param(10, low=1, high=300)  # exact tests of more take minutes
    scenarios: list = param(["room", "carpet", "corner"])
    methods: list = param(["nrs", "robot_only"])
    worlds: int = param(20, low=0, high=100000)


@dataclass(frozen=True)
class Timing(Parameters):
    """The delays of processors and network in the live system, which a run in one process lacks."""

    command_s: float = param(0.04, "s", low=0.0, high=5.0)
    save_s: float = param(0.4, "s", low=0.0, high=10.0)
    spot_s: float = param(0.02, "s", low=0.0, high=1.0)
    extraction_s: float = param(0.06, "s", low=0.0, high=5.0)
    idle_every: int = param(5, low=1, high=25)
    time_limit_s: float = param(400.0, "s", above=0.0)


@dataclass(frozen=True)
class Study:
    """A configuration, ready to run. Made by `load`.

    Attributes:
        document: the YAML document with all defaults filled in, of which the hash is made.
        sources: YAML documents of the files that it names, by their name in the document; do not change them.
        models: models of sensors, robot and people; traits in which people differ are sampled by `traits`.
    """

    document: Mapping[str, Any]
    sources: Mapping[str, Any]
    design: Design
    timing: Timing
    world: World
    models: Models

    def traits(self, participant: int) -> Traits:
        """Samples a participant, numbered from 1."""
        return sample_traits(self.document["participants"], self.models.participant, self.streams(participant))

    def marks(self, participant: int, scenario: str) -> Tuple[float, float, float]:
        """Samples (dx, dy) [m] and turn [rad] by which the marks on the floor are off the map.

        They are laid anew for each participant, so that intervals over participants include this variation; both
        methods have the same marks.
        """
        settings = self.document.get("marks") or {}
        rng = self.streams(participant)(f"marks {scenario}")
        offset = settings.get("offset", 0.0)
        dx = sample_value("marks/offset", offset, rng)
        dy = sample_value("marks/offset", offset, rng)
        turn = sample_value("marks/turn", settings.get("turn", 0.0), rng)
        return dx, dy, math.radians(turn)

    def streams(self, participant: int) -> Streams:
        """Returns the random generators of one participant, by name."""
        return lambda name: np.random.default_rng([self.design.seed, participant, zlib.crc32(name.encode())])

    def run_seed(self, participant: int) -> int:
        """Returns the seed of the simulated lab's nodes for one participant's runs."""
        return self.design.seed * 1000 + participant

    @property
    def hash(self) -> str:
        """Identifies the configuration: the same for the same content of all files."""
        text = json.dumps([self.document, self.sources], sort_keys=True, default=str)
        return hashlib.sha256(text.encode()).hexdigest()[:12]

    def changed(self, changes: Mapping[str, Any]) -> "Study":
        """Returns the same study with other values.

        Args:
            changes: new values by key, such as "design/seed", "timing/save_s", "participants/traits/tremor",
                "models/optics/exposure_ms" or "world/cameras".

        Raises:
            ParameterError: names the key that is wrong.
        """
        document = copy.deepcopy({**self.document, **self.sources})
        for key, value in changes.items():
            _set(document, key, value)
        sources = {name: document.pop(name) for name in self.sources}
        return study_from_mapping(document, sources)


def _set(document: Any, path: str, value: Any) -> None:
    *parents, last = path.split("/")
    for name in parents:
        document = document[int(name)] if isinstance(document, list) else document.setdefault(name, {})
    index = int(last) if isinstance(document, list) else last
    document[index] = value


def load(path: Optional[Path] = None, seed: Optional[int] = None) -> Study:
    """Reads a study's configuration. What the file omits is as in config/study.yaml.

    Args:
        seed: instead of the file's.

    Raises:
        CodedError: "no_study" or "bad_study" if the file is missing or malformed.
        ParameterError: names the key that is wrong.
    """
    document = _read(DEFAULT)
    folder = DEFAULT.parent
    if path is not None:
        folder = Path(path).resolve().parent
        document = _merge(document, _read(path))
    if seed is not None:
        document.setdefault("design", {})["seed"] = seed
    sources = {name: _read(_find_file(str(document.pop(name)), folder)) for name in ("world", "models")}
    return study_from_mapping(document, sources)


def study_from_mapping(document: Mapping[str, Any], sources: Mapping[str, Any]) -> Study:
    """Builds and checks the study that a document and the files named in it describe. See `Study`."""
    known_keys = ("design", "timing", "participants", "marks")
    for key in document:
        if key not in known_keys:
            raise ParameterError(str(key), f"unknown key of a study; known are world, models, {', '.join(known_keys)}")
        if not isinstance(document[key], Mapping):
            raise ParameterError(str(key), f"expected keys and values, got {document[key]!r}")
    design = Design.from_mapping(document.get("design"), "design")
    world = world_from_mapping(sources["world"])
    for key in design.scenarios:
        world.scenario(key)
    for key in design.methods:
        if key not in METHODS:
            raise ParameterError("design/methods", f"'{key}' is unknown; known are {', '.join(METHODS)}")
    timing = Timing.from_mapping(document.get("timing"), "timing")
    study = Study(document, sources, design, timing, world, Models.from_mapping(sources["models"]))
    study.traits(1)  # a mistake in a distribution is found now, not in the tenth run
    study.marks(1, "")
    return study


def _read(path: Path) -> Dict[str, Any]:
    document = read_document(path, "study")
    if document is None:
        return {}
    if not isinstance(document, dict):
        raise CodedError("bad_study", f"expected keys and values at the top of '{path}'")
    return {key: value for key, value in document.items() if value is not None}


def _merge(base: Mapping[str, Any], changes: Mapping[str, Any]) -> Dict[str, Any]:
    """Merges sections key by key. Replaces a distribution, a list or a number as a whole."""
    merged = dict(base)
    for key, value in changes.items():
        are_sections = isinstance(value, Mapping) and isinstance(base.get(key), Mapping)
        if are_sections and not DISTRIBUTIONS & set(value):
            merged[key] = _merge(base[key], value)
        else:
            merged[key] = value
    return merged


def _find_file(name: str, folder: Path) -> Path:
    """Finds a file beside the configuration, in the current folder, in the repository or in vb_sim."""
    for path in (folder / name, Path(name), repository_root() / name, repository_root() / "src" / "vb_sim" / name):
        if path.is_file():
            return path
    raise CodedError("no_file", f"'{name}' is neither beside the configuration nor in the repository")
