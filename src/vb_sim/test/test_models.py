"""The models file: the same figures as in the code, and mistakes that are named."""

from dataclasses import fields

import pytest
import yaml

from vb_core.errors import CodedError, ParameterError
from vb_sim.models import MODELS, Models, load_models


def test_the_file_has_every_figure_of_the_code():
    assert load_models() == Models()
    written = yaml.safe_load(MODELS.read_text())
    for section in fields(Models):
        of_code = {entry.name for entry in fields(section.default_factory)}
        assert set(written[section.metadata.get("section", section.name)]) == of_code


@pytest.mark.parametrize(
    "text, words",
    [
        ("robot: {max_speed: -1.0}", "robot/max_speed"),
        ("scan: {beems: 3}", "scan/beems"),
        ("participant: {drawing_speed: 0.3}", "participant/drawing_speed"),
        ("scanner: {}", "expected sections robot, localisation"),
        ("[1]", "expected sections"),
        ("[1, 2", "line 1"),
        (None, "cannot read"),
    ],
)
def test_what_is_wrong_is_named(tmp_path, text, words):
    path = tmp_path / "models.yaml"
    if text is not None:
        path.write_text(text)
    with pytest.raises((CodedError, ParameterError), match=words):
        load_models(path)
