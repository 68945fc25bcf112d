"""Reads config/models.yaml: one section per model of a sensor, a robot or a person."""
from __future__ import annotations

from pathlib import Path
from typing import Any, Mapping, Type, TypeVar

import yaml

from vb_core.errors import CodedError, ParameterError
from vb_core.parameters import Parameters

P = TypeVar("P", bound=Parameters)


def load_models(path: str) -> Mapping[str, Any]:
    """The sections of a models file.

    Raises:
        CodedError: "no_models" if there is no such file, "bad_models" if it is not YAML.
        ParameterError: if it holds anything but sections.
    """
    try:
        document = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise CodedError("no_models", f"cannot read the models file '{path}': {error.strerror}") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        where = getattr(error, "problem_mark", None)
        line = f" in line {where.line + 1}" if where else ""
        raise CodedError("bad_models", f"the models file '{path}' is not valid YAML{line}") from None
    if document is None:
        return {}
    if not isinstance(document, Mapping):
        raise ParameterError("models", f"expected sections at the top of '{path}'")
    return document


def section(models: Mapping[str, Any], name: str, cls: Type[P]) -> P:
    """One section as a checked parameter class; what the file omits keeps its default.

    Raises:
        ParameterError: names the section and the key that is wrong.
    """
    return cls.from_mapping(models.get(name), name)
