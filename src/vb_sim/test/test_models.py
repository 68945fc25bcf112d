"""The models file has the same figures as the code."""

from dataclasses import fields

import yaml

from vb_sim.models import MODELS, Models, load_models


def test_the_file_has_every_figure_of_the_code():
    assert load_models() == Models()
    written = yaml.safe_load(MODELS.read_text())
    for section in fields(Models):
        assert set(written[section.name]) == {entry.name for entry in fields(section.default)}
