"""The study's configuration: people, changes, hash, what curves and sensitivity consist of."""
import re

import numpy as np
import pytest
import yaml

from vb_core.errors import CodedError, ParameterError
from vb_evaluation.study import campaign, config, measures, plan, sweeps
from vb_evaluation.study.methods import Method, methods
from vb_evaluation.study.people import Distribution
from vb_evaluation.study.runner import personal_scenario
from vb_sim import floor_plan

STUDY = config.load()


def test_people_differ_and_stay_who_they_are():
    traits = [STUDY.traits(number) for number in range(1, 9)]
    assert len({person.model.tremor for person in traits}) == 8 and len({person.body.height for person in traits}) == 8
    assert [STUDY.traits(number) for number in range(1, 9)] == traits
    assert STUDY.traits(3) != config.load(seed=2).traits(3)


def test_one_trait_leaves_the_others_alone():
    before, after = STUDY.traits(4), STUDY.changed({"participants/traits/tremor": 0.02}).traits(4)
    assert after.model.tremor == 0.02
    assert (after.model.reach, after.model.drawing_speed, after.body) == (before.model.reach, before.model.drawing_speed, before.body)


@pytest.mark.parametrize("spec, mean, spread", [
    (0.3, 0.3, 0.0), ({"uniform": [1.0, 3.0]}, 2.0, 2.0 / np.sqrt(12)), ({"normal": [1.0, 0.2]}, 1.0, 0.2),
    ({"scaled": [{"normal": [1.0, 0.2]}, 2.0]}, 2.0, 0.4),
    ({"mixture": [{"share": 3, "normal": [1.0, 0.0]}, {"share": 1, "normal": [5.0, 0.0]}]}, 2.0, np.sqrt(3.0)),
])
def test_distributions_have_their_moments(spec, mean, spread):
    rng = np.random.default_rng(0)
    distribution = Distribution("trait", spec)
    values = [distribution.draw(rng) for _ in range(4000)]
    assert np.mean(values) == pytest.approx(mean, abs=0.12) and np.std(values) == pytest.approx(spread, abs=0.06)


@pytest.mark.parametrize("changes, named", [
    ({"participants/traits/tremour": 0.1}, "tremour"),
    ({"participants/traits/tremor": {"gauss": [0, 1]}}, "tremor"),
    ({"participants/traits/tremor": {"normal": [0]}}, "tremor"),
    ({"participants/model": "clones"}, "clones"),
    ({"design/participants": 0}, "participants"),
    ({"design/scenarios": ["attic"]}, "attic"),
    ({"models/optics/exposure_ms": -1.0}, "exposure_ms"),
    ({"plugins": ["no_such_module_anywhere"]}, "no_such_module_anywhere"),
])
def test_mistakes_are_named(changes, named):
    with pytest.raises(CodedError, match=named):
        STUDY.changed(changes)


def test_a_file_of_ones_own_needs_only_what_differs(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("design: {participants: 3}\nparticipants: {traits: {tremor: 0.02}}\n")
    study = config.load(path)
    assert study.design.participants == 3 and study.design.scenarios == STUDY.design.scenarios
    assert study.traits(1).model.tremor == 0.02 and study.traits(1).model.reach == STUDY.traits(1).model.reach
    path.write_text("colour: red\n")
    with pytest.raises(ParameterError, match="colour"):
        config.load(path)
    with pytest.raises(CodedError, match="no_study|cannot read"):
        config.load(tmp_path / "nothing.yaml")


def test_hash_tells_configurations_apart():
    same, other = config.load(), STUDY.changed({"timing/save_s": 0.5})
    assert same.hash == STUDY.hash and campaign.configuration(same) == campaign.configuration(STUDY)
    assert other.hash != STUDY.hash and campaign.configuration(other) != campaign.configuration(STUDY)
    assert STUDY.changed({"world/robots/0/radius": 0.2}).hash != STUDY.hash


def test_order_is_random_within_each_participant():
    jobs = plan.main_jobs(STUDY, 8)
    assert len(jobs) == len({job.task for job in jobs}) == 8 * 6
    orders = []
    for participant in range(1, 9):
        own = [job for job in jobs if job.task.participant == participant]
        assert [job.order for job in own] == list(range(1, 7))
        # one method after the other, as in the paper
        assert len({job.task.method for job in own[:3]}) == len({job.task.method for job in own[3:]}) == 1
        orders.append(tuple((job.task.scenario, job.task.method) for job in own))
    assert len(set(orders)) > 4
    # who takes part besides changes nothing
    assert plan.main_jobs(STUDY, 2) == jobs[:12]


def test_columns_begin_with_the_contracts():
    contract = ("participant,scenario,method,seed,completed,time_guide_s,time_border_s,time_seed_s,time_total_s,jaccard").split(",")
    assert list(campaign.columns(STUDY, plan.RUNS)[:10]) == contract
    for file, first in ((plan.CURVES, ["sweep", "value"]), (plan.SENSITIVITY, ["parameter", "factor", "value", "unit"])):
        assert list(campaign.columns(STUDY, file)[: len(first) + 10]) == first + contract
    assert set(measures.PAPER) <= set(contract)


def test_people_stand_off_the_line_on_free_floor():
    grid = floor_plan.physical_map(STUDY.world)
    places = set()
    for participant in range(1, 9):
        for key in STUDY.design.scenarios:
            place = personal_scenario(STUDY.world, STUDY.world.scenario(key), STUDY.traits(participant), grid).stand
            assert grid.values_at(place[None])[0] == 0
            places.add(tuple(place))
    assert len(places) > 12


def test_every_assumed_figure_is_varied():
    names = {assumption.name for assumption in sweeps.assumptions(STUDY)}
    assert {"optics/halo_share", "localisation/yaw_sigma", "participant/tremor", "participant/notice_time", "body/height"} <= names
    # what has a source, and mechanics, are left alone
    assert not {"optics/laser_power_mw", "robot/max_speed", "camera_noise/frames"} & names
    jobs = sweeps.sensitivity_jobs(STUDY, 1, ["optics/white_level", "participant/tremor"])
    values = {(job.conditions["parameter"], job.conditions["factor"]): job.conditions["value"] for job in jobs}
    # a limit of what is possible counts
    assert values["optics/white_level", 2.0] == "255.0" and values["optics/white_level", 0.5] == "115.0"
    varied = {job.conditions["factor"]: STUDY.changed(job.changes).traits(1).model.tremor for job in jobs if job.conditions["parameter"] == "participant/tremor"}
    assert varied[2.0] == pytest.approx(4.0 * varied[0.5])


def test_coverage_goes_from_none_to_all():
    jobs = sweeps.curve_jobs(STUDY, 1, ["coverage"])
    values = sorted({job.conditions["value"] for job in jobs})
    assert values[0] == 0.0 and values[-1] == 1.0 and len(values) == 5
    # the baseline does not notice the ceiling; the paper's cameras are the study itself
    assert all(not job.changes for job in jobs if job.task.method == "robot_only")
    assert sum(not job.changes for job in jobs if job.task.method == "nrs") == len(STUDY.design.scenarios)


def test_borders_grow_with_their_regions():
    for job in sweeps.curve_jobs(STUDY, 1, ["border_length"]):
        scenario = STUDY.changed(job.changes).world.scenario(job.task.scenario)
        edges = {tuple(corner) for corner in scenario.region}
        assert sum(tuple(corner) in edges for corner in scenario.border) >= 2


def test_a_method_of_ones_own():
    class Follow(methods.get("robot_only")):  # type: ignore[misc]
        follow = "true"

    methods.register("follow")(Follow)
    study = STUDY.changed({"design/methods": ["nrs", "follow"]})
    assert {job.task.method for job in plan.main_jobs(study, 1)} == {"nrs", "follow"} and issubclass(methods.get("follow"), Method)


def test_the_documented_configuration_is_yaml_with_a_source_for_each_trait():
    text = config.DEFAULT.read_text(encoding="utf-8")
    part = text[text.index("participants:\n") : text.index("\ncurves:")]
    for key in yaml.safe_load(text)["participants"]["traits"]:
        line = next(line for line in part.splitlines() if line.strip().startswith(f"{key}:"))
        assert "#" in line, f"{key} has neither a source nor the word assumed"


def test_the_examples_of_the_documentation_work(tmp_path, monkeypatch):
    text = (config.top() / "docs" / "study-extending.md").read_text(encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    for code in re.findall(r"```python\n(.*?)```", text, re.S):
        (tmp_path / code.split("\n")[0].lstrip("# ")).write_text(code)
    studies = []
    for number, document in enumerate(re.findall(r"```yaml\n(.*?)```", text, re.S)):
        (tmp_path / f"{number}.yaml").write_text(document)
        studies.append(config.load(tmp_path / f"{number}.yaml"))
    assert [study.world.name for study in studies].count("studio") == 1
    assert any(study.traits(1) == study.traits(2) for study in studies)
    assert any("ceiling_only" in study.design.methods for study in studies)
    assert any("robot_turned_rad" in campaign.columns(study, plan.RUNS) for study in studies)
    for study in studies:
        assert sweeps.curve_jobs(study, 1, ["coverage", "robots"])
