"""The study's configuration: people, changes, hash, and the worlds of the sensitivity analysis."""

import re
import textwrap
from collections import Counter, defaultdict
from dataclasses import replace
from itertools import chain, product

import numpy as np
import pytest
from scipy import stats

from vb_core.errors import CodedError, ParameterError
from vb_core.grid_map import UNKNOWN, sample
from vb_evaluation.counterbalancing import order_runs
from vb_evaluation.repository_revision import repository_root
from vb_evaluation.report.study_files import RUNS, WORLDS
from vb_evaluation.simulated_study import campaign, config, run_plan
from vb_evaluation.simulated_study.live_run import personal_scenario
from vb_sim import floor_plan

STUDY = config.load()


def test_people_differ_and_stay_who_they_are():
    traits = [STUDY.traits(number) for number in range(1, 9)]
    assert len({person.model.tremor for person in traits}) == 8
    assert len({person.body.height for person in traits}) == 8
    assert [STUDY.traits(number) for number in range(1, 9)] == traits
    assert STUDY.traits(3) != config.load(seed=2).traits(3)


@pytest.mark.parametrize(
    "spec, mean, spread",
    [
        (0.3, 0.3, 0.0),
        ({"uniform": [1.0, 3.0]}, 2.0, 2.0 / np.sqrt(12)),
        ({"normal": [1.0, 0.2]}, 1.0, 0.2),
        ({"scaled": [{"normal": [1.0, 0.2]}, 2.0]}, 2.0, 0.4),
        ({"mixture": [{"share": 3, "normal": [1.0, 0.0]}, {"share": 1, "normal": [5.0, 0.0]}]}, 2.0, np.sqrt(3.0)),
    ],
)
def test_distributions_have_their_moments(spec, mean, spread):
    rng = np.random.default_rng(0)
    values = [config.sample_value("trait", spec, rng) for _ in range(4000)]
    assert np.mean(values) == pytest.approx(mean, abs=0.12)
    assert np.std(values) == pytest.approx(spread, abs=0.06)


@pytest.mark.parametrize(
    "changes, named",
    [
        ({"participants/traits/tremour": 0.1}, "tremour"),
        ({"participants/traits/tremor": {"gauss": [0, 1]}}, "tremor"),
        ({"participants/clones": 1.0}, "clones"),
        ({"design/methods": ["telepathy"]}, "telepathy"),
        ({"marks/turn": {"normal": [0]}}, "turn"),
        ({"marks": 3}, "marks"),
        ({"design/participants": 0}, "participants"),
        ({"design/scenarios": ["attic"]}, "attic"),
        ({"models/optics/exposure_ms": -1.0}, "exposure_ms"),
    ],
)
def test_a_mistake_in_the_configuration_is_named(changes, named):
    with pytest.raises(CodedError, match=named):
        STUDY.changed(changes)


def test_a_file_of_ones_own_needs_only_what_differs(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("design: {participants: 3}\nparticipants: {traits: {tremor: 0.02}}\n")
    study = config.load(path)
    assert study.design == replace(STUDY.design, participants=3)
    usual = STUDY.traits(4)
    assert study.traits(4) == replace(usual, model=replace(usual.model, tremor=0.02)) != usual
    path.write_text("colour: red\n")
    with pytest.raises(ParameterError, match="colour"):
        config.load(path)
    with pytest.raises(CodedError, match="no_study|cannot read"):
        config.load(tmp_path / "nothing.yaml")


def test_hash_distinguishes_configurations():
    same, other = config.load(), STUDY.changed({"timing/save_s": 0.5})
    for hash_of in (lambda study: study.hash, campaign.configuration_hash):
        assert hash_of(same) == hash_of(STUDY)
        assert hash_of(other) != hash_of(STUDY)
    assert STUDY.changed({"world/robots/0/radius": 0.2}).hash != STUDY.hash


SCENARIOS, METHODS = ["room", "carpet", "corner"], ["nrs", "robot_only"]


@pytest.fixture(scope="module")
def studies():
    """The orders of the runs of 12 participants, of 100 studies."""
    return [[order_runs(number, 12, SCENARIOS, METHODS, seed) for number in range(1, 13)] for seed in range(100)]


def leads_of(orders):
    """Returns how many more began with nrs than with robot_only, before each participant and after the last."""
    return np.cumsum([0, *(1 if order[0][1] == "nrs" else -1 for order in orders)])


def test_everybody_does_all_runs_of_one_method_then_all_of_the_other(studies):
    for order in chain(*studies):
        assert {*order[:3]} in [{*product(SCENARIOS, [method])} for method in METHODS]
        assert {*order} == {*product(SCENARIOS, METHODS)}


def test_each_method_is_equally_often_first(studies):
    assert not any(leads_of(orders)[-1] for orders in studies)


def test_each_scenario_is_equally_often_at_each_position(studies):
    for orders, place in product(studies, range(6)):
        assert Counter(order[place][0] for order in orders) == dict.fromkeys(SCENARIOS, 4)


def test_orders_are_drawn(studies):
    assert min(len(set(map(tuple, orders))) for orders in studies) > 8


def test_the_next_method_is_foreseen_only_where_the_longest_block_must_become_even(studies):
    next_methods = defaultdict(set)
    for orders in studies:
        for lead, order in zip(leads_of(orders), orders):
            next_methods[lead].add(order[0][1])
    assert next_methods == {3: {"robot_only"}, **dict.fromkeys(range(-2, 3), {*METHODS}), -3: {"nrs"}}


def test_methods_need_not_be_even_before_the_last_participant(studies):
    assert (np.array([leads_of(orders) for orders in studies]) != 0).any(axis=0)[1:-1].all()


def test_columns_begin_with_the_contracts():
    contract = "participant scenario method seed completed".split()
    contract += "time_guide_s time_border_s time_seed_s time_total_s jaccard".split()
    assert list(campaign.columns(RUNS)[:10]) == contract
    assert list(campaign.columns(WORLDS)[:11]) == ["draw", *contract]
    assert {"error_mean_cm", "error_p95_cm", "error_max_cm"} <= set(campaign.columns(RUNS))


def test_the_marks_are_laid_for_each_person_beside_the_map():
    grid = floor_plan.physical_map(STUDY.world)
    laid = np.array([STUDY.marks(number, "room") for number in range(1, 201)])
    assert len(np.unique(laid, axis=0)) == 200
    assert np.allclose(laid[:, :2].std(axis=0), 0.02, rtol=0.2)
    for key in STUDY.design.scenarios:
        marks, scenario = STUDY.marks(1, key), STUDY.world.scenario(key)
        assert marks == STUDY.marks(1, key)
        assert marks != STUDY.marks(1, "elsewhere")
        lines = [personal_scenario(scenario, STUDY.traits(n), grid, marks).border for n in (1, 2)]
        assert 0.002 < np.linalg.norm(lines[0] - scenario.border, axis=1).max() < 0.2
        assert np.allclose(*lines) != scenario.closed  # people who draw round an object keep a margin


def test_people_stand_off_the_line_on_free_floor():
    world = STUDY.world
    grid = floor_plan.physical_map(world)
    everybody = product(range(1, 9), STUDY.design.scenarios)
    runs = [personal_scenario(world.scenario(key), STUDY.traits(number), grid, (0, 0, 0)) for number, key in everybody]
    places = np.array([run.stand for run in runs])
    assert (sample(grid, grid.data, places, UNKNOWN) == 0).all()
    assert len(np.unique(places, axis=0)) > 12


def leaves(document, path=""):
    """Yields the keys of all figures; a distribution counts as one."""
    for key, value in document.items():
        inner = isinstance(value, dict) and not {"normal", "uniform", "lognormal", "mixture"} & set(value)
        yield from leaves(value, f"{path}{key}/") if inner else [f"{path}{key}"]


def test_every_figure_has_its_source():
    """Figures of models, people, marks and delays: none lacks an entry, and no entry lacks its figure."""
    models = {key for key in leaves({"models": dict(STUDY.sources["models"])})}
    traits = set(STUDY.document["participants"]["traits"])
    models -= {f"models/participant/{key}" for key in traits} | {"models/body/height", "models/body/breadth"}
    study = set(leaves({key: STUDY.document[key] for key in ("participants", "marks", "timing")}))
    study -= {"timing/idle_every", "timing/time_limit_s"}
    assert models | study == set(run_plan.load_assumptions())
    assert all(entry.why for entry in run_plan.load_assumptions().values())


def test_worlds_are_a_latin_hypercube_of_everything():
    study = STUDY.changed({"design/worlds": 40})
    worlds = run_plan.draw_worlds(study)
    assert len(worlds[0]) > 60
    assert set(worlds[0]) == set(run_plan.varied_assumptions(STUDY))
    for key, entry in run_plan.varied_assumptions(STUDY).items():
        low, high = entry.range
        cells = np.floor(40 * np.log([factors[key] / low for factors in worlds]) / np.log(high / low) + 1e-3)
        assert len(set(np.clip(cells, 0, 39))) >= 39, key  # one draw in each of 40 equal parts
    assert worlds == run_plan.draw_worlds(study) != run_plan.draw_worlds(study.changed({"design/seed": 2}))
    values = np.array([list(factors.values()) for factors in worlds])
    assert np.abs(np.triu(stats.spearmanr(values).statistic, 1)).max() < 0.75, "as independent as 40 draws can be"


@pytest.mark.parametrize("index", [0, 1], ids=["lowest", "highest"])
def test_the_corners_of_every_range_are_possible(index):
    factors = {key: entry.range[index] for key, entry in run_plan.varied_assumptions(STUDY).items()}
    assert STUDY.changed(run_plan.scaled_values(STUDY, factors)).traits(1) != STUDY.traits(1)


def test_worlds_cover_all_scenarios_and_both_methods():
    jobs = run_plan.world_jobs(STUDY.changed({"design/worlds": 9}))
    assert len(jobs) == 18
    assert {(job.scenario, job.method) for job in jobs} == {*product(STUDY.design.scenarios, STUDY.design.methods)}
    assert len({job.participant for job in jobs}) == 9


def test_the_examples_of_the_documentation_work(tmp_path):
    text = (repository_root() / "docs" / "how-to" / "extend-the-study.md").read_text(encoding="utf-8")
    studies = []
    for number, document in enumerate(re.findall(r"```yaml\n(.*?)```", text, re.S)):
        (tmp_path / f"{number}.yaml").write_text(textwrap.dedent(document))
        studies.append(config.load(tmp_path / f"{number}.yaml"))
    assert len(studies) > 1
    assert [study.world.name for study in studies].count("studio") == 1


def test_the_quick_study_is_part_of_the_whole_one():
    def rows(quick):
        return [(job.file, *map(str, job.columns(1).values())) for job in run_plan.plan_jobs(STUDY, quick)]

    quick, whole = rows(True), rows(False)
    assert quick == whole[:6]
    assert len(set(whole)) == len(whole) == 100
    assert {row[0] for row in whole} == {"runs.csv", "worlds.csv"}
    # the names of the rows' files sort in the order of the jobs
    names = [job.name for job in run_plan.plan_jobs(STUDY)]
    for name_group in (names[:60], names[60::2]):
        assert name_group == sorted(name_group)
