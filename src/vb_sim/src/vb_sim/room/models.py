"""Reads config/models.yaml: one section per model of a sensor, a robot or a person."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Mapping, Type, TypeVar, Union

import rospkg
import yaml

from vb_core.errors import CodedError, ParameterError
from vb_core.parameters import Parameters

P = TypeVar("P", bound=Parameters)
MODELS = Path(rospkg.RosPack().get_path("vb_sim")) / "config" / "models.yaml"


def read_document(path: Path, what: str) -> Any:
    """Reads a YAML file; None if it is empty.

    Args:
        what: it is, "world": part of the codes and of the sentences.

    Raises:
        CodedError: "no_<what>" if there is no such file, "bad_<what>" if it is not YAML.
    """
    try:
        return yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise CodedError(f"no_{what}", f"cannot read the {what} file '{path}': {error.strerror}") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        where = getattr(error, "problem_mark", None)
        line = f" in line {where.line + 1}" if where else ""
        raise CodedError(f"bad_{what}", f"the {what} file '{path}' is not valid YAML{line}") from None


def load_models(path: Union[str, Path] = MODELS) -> Mapping[str, Any]:
    """Reads the sections of a models file, by default this package's own.

    Raises:
        CodedError: "no_models", "bad_models", as `read_document`.
        ParameterError: if it holds anything but sections.
    """
    document = read_document(Path(path), "models")
    if document is None:
        return {}
    if not isinstance(document, Mapping):
        raise ParameterError("models", f"expected sections at the top of '{path}'")
    return document


def read_section(models: Mapping[str, Any], name: str, cls: Type[P]) -> P:
    """Reads one section as a checked parameter class; what the file omits keeps its default.

    Raises:
        ParameterError: names the section and the key that is wrong.
    """
    return cls.from_mapping(models.get(name), name)
