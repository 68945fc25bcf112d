"""The report agrees with the CSV, has intervals and caveats, and copes with few or odd data; the published report."""

import html
import re
import shutil
from pathlib import Path

import numpy as np
import pandas
import pytest

import study_rows
from study_rows import PUBLISHED, rows_of
from refusals import refused
from vb_core.errors import CodedError
from vb_evaluation import statistics
from vb_evaluation.report import cross_checks, questionnaire
from vb_evaluation.report.findings import format_findings, write_page
from vb_evaluation.report.study_files import ERRORS, TIMES, pairs, read_sheet, read_study, write_table, yes_or_no
from vb_evaluation.report.map_figures import nearest_to_median
from vb_evaluation.report.outcomes import COMPARED
from vb_evaluation.report.html_page import report_tables, write_report
from vb_evaluation.statistics import Interval
from vb_evaluation.user_study import __main__ as command


@pytest.fixture(scope="module")
def full(tmp_path_factory):
    """Returns the folder of a study with every file, and its page."""
    folder = study_rows.make_study(tmp_path_factory.mktemp("study") / "full", participants=6)
    return folder, write_report(folder).read_text(encoding="utf-8")


def words_of(page):
    return html.unescape(re.sub(r"<[^>]+>", " ", re.sub(r"<style>.*?</style>", "", page, flags=re.S)))


def test_tables_hold_what_the_rows_say(full):
    folder, _ = full
    runs = pandas.read_csv(folder / "runs.csv")
    keys = {"Room exclusion": "room", "Carpet exclusion": "carpet", "Spot cleaning": "corner"}
    keys.update({"Network robot system": "nrs", "Robot only": "robot_only"})
    table = rows_of(folder / "tables" / "error.csv")
    assert len(table) == 6
    for row in table:
        cell = (runs.scenario == keys[row["Scenario"]]) & (runs.method == keys[row["Method"]])
        done = runs[cell & (runs.completed == 1)]
        for column, heading in zip(ERRORS, ("mean [cm]", "95 % of the boundary within [cm]", "largest [cm]")):
            assert float(row[heading]) == pytest.approx(done[column].median())
            assert float(row[f"{heading} low"]) <= float(row[heading]) <= float(row[f"{heading} high"])
        assert int(row["Runs"]) == len(done)


def test_simulated_people_have_no_p(full):
    assert not re.search(r"\bp [<=]|exact p|Wilcoxon signed-rank", words_of(full[1]))


@pytest.mark.parametrize("low, high, reading", [(0.975, 0.990, "better"), (0.78, 0.82, "worse"), (0.84, 0.88, "same")])
def test_better_than_the_paper_is_no_agreement(low, high, reading):
    ours = Interval((low + high) / 2, low, high, 0.95)
    row = cross_checks._compare("Jaccard index, robot only", 0.856, ours, digits=3, step=1e-3)
    assert row["Reading"] == reading


def test_each_conclusion_counts_the_worlds_that_it_is_about(tmp_path):
    """Seven worlds, each with (completed, time, error) of the network robot system and of the robot alone."""
    worlds = [
        ((1, 10.0, 3.0), (1, 20.0, 1.0)),  # faster, error within a cell
        ((1, 10.0, 3.6), (1, 10.0, 1.0)),  # equally fast, error larger by more than a cell
        ((1, 15.0, 1.0), (1, 20.0, 1.0)),  # faster, but not 1.5 times
        ((0, 10.0, 1.0), (1, 20.0, 1.0)),
        ((1, 30.0, 1.0), (0, 20.0, 1.0)),
        ((0, 30.0, 1.0), (0, 20.0, 1.0)),
        ((1, 10.0, 1.0), (1, 20.0, 1.0)),  # a camera was too bright in the first run
    ]
    columns = ("completed", "time_total_s", "error_mean_cm")
    same = {"scenario": "room", "seed": 1, "jaccard": 0.9, **dict.fromkeys(TIMES, 0)}
    rows = [
        {**same, "draw": draw, "participant": draw, "method": method, "too_bright": 0, **dict(zip(columns, result))}
        for draw, world in enumerate(worlds, 1)
        for method, result in zip(("nrs", "robot_only"), world)
    ]
    rows[12]["too_bright"] = 1
    study_rows.write(tmp_path / "runs.csv", rows)
    study_rows.write(tmp_path / "worlds.csv", rows)
    study_rows.write(tmp_path / "draws.csv", [{"draw": draw, "a": 1} for draw in range(1, 8)])
    counts = {"all": [], "no camera too bright": []}
    for row in cross_checks.worlds_table(read_study(tmp_path)).rows:
        share = row["holds in [%] of worlds"].estimate
        counts[row["Worlds"]].append((round(share * row["Number"] / 100), row["Number"]))
    assert counts["no camera too bright"] == [(3, 6), (2, 3), (1, 3), (2, 3), (3, 4), (4, 6), (4, 6)]
    assert counts["all"] == [(4, 7), (3, 4), (2, 4), (3, 4), (4, 5), (5, 7), (5, 7)]
    study_rows.write(tmp_path / "runs.csv", rows[::2])
    assert "worlds" not in {table.name for table in report_tables(read_study(tmp_path))}  # nothing to compare with


def test_the_page_stands_alone_and_is_the_same_again(full):
    folder, page = full
    assert not re.search(r'(?:src|href)="(?!data:|#)', page)
    assert write_report(folder).read_text(encoding="utf-8") == page


def test_maps_are_those_nearest_to_the_median(full):
    study = read_study(full[0])
    runs = pandas.read_csv(full[0] / "runs.csv")
    for scenario in study.scenarios:
        row = nearest_to_median(study, scenario, "nrs")
        done = runs[(runs.scenario == scenario) & (runs.method == "nrs") & (runs.completed == 1)].jaccard
        assert abs(row["jaccard"] - done.median()) == (done - done.median()).abs().min()


@pytest.mark.parametrize("participants", [1, 2])
def test_a_study_of_few_people_with_nothing_but_runs_has_its_page(tmp_path, participants):
    folder = study_rows.make_study(tmp_path / "study", participants, runs_only=True)
    (folder / "study.json").unlink()
    *rows, missing = rows_of(folder / "runs.csv")
    study_rows.write(folder / "runs.csv", rows)
    page = write_report(folder).read_text()
    assert "Beside the paper" in page
    assert "Plausible worlds" not in page and "nan" not in words_of(page)
    assert f"Missing runs (1): {missing['participant']}, " in page


@pytest.mark.parametrize("column", ["jaccard", "time_total_s", "error_mean_cm"])
def test_bad_data_is_reported_in_one_line(tmp_path, column, capsys):
    folder = study_rows.make_study(tmp_path / "study", 1, runs_only=True)
    rows = rows_of(folder / "runs.csv")
    rows[0][column] = "1,5"
    study_rows.write(folder / "runs.csv", rows)
    assert command.main(["report", str(folder)]) == 2
    assert f"line 2: {column}: expected a number, got '1,5'" in capsys.readouterr().err


def test_a_missing_file_or_column_is_named(tmp_path):
    with pytest.raises(CodedError, match="runs.csv is missing"):
        read_study(tmp_path)
    (tmp_path / "runs.csv").write_text("participant,scenario\n1,room\n")
    with pytest.raises(CodedError, match="the column method is missing"):
        read_study(tmp_path)


@pytest.mark.parametrize("column, expected", [("time_total_s", [(3.0, 5.0), (1.0, 6.0)]), ("jaccard", [(3.0, 5.0)])])
def test_a_pair_is_the_means_of_a_persons_rows_with_either_method(column, expected):
    a = [("a", "nrs", 1, 2.0), ("a", "nrs", 1, 4.0), ("a", "robot_only", 1, 5.0)]
    not_completed = [("b", "nrs", 0, 1.0), ("b", "robot_only", 1, 6.0)]
    one_method, no_value = [("c", "nrs", 1, 7.0)], [("d", "nrs", 1, np.nan), ("d", "robot_only", 1, 8.0)]
    rows = [*a, *not_completed, *one_method, *no_value]
    table = pandas.DataFrame(rows, columns=["participant", "method", "completed", column])
    assert list(zip(*pairs(table, column, ("nrs", "robot_only")))) == expected


def test_a_sheet_is_read_as_spreadsheets_write_it(tmp_path):
    path = tmp_path / "sheet.csv"
    path.write_text("\ufeffa; b;c\n1 ;x,y;\n;;\n 2;;z\n", encoding="utf-8")
    sheet = read_sheet(path, ["a"])
    assert sheet.index.tolist() == [2, 4] and sheet.a.tolist() == ["1", "2"]
    assert sheet[" b"].tolist() == ["x,y", ""] and sheet.c.tolist() == ["", "z"]
    write_table(path, ["a", "c"], [{"a": 1, "c": "x;y"}, {"a": 2.5}])
    assert path.read_text() == "a,c\n1,x;y\n2.5,\n"
    assert read_sheet(path, []).to_dict("list") == {"a": ["1", "2.5"], "c": ["x;y", ""]}
    assert [yes_or_no(text, "here", "bad") for text in ("yes", "NEIN", "1", "")] == [True, False, True, None]
    with pytest.raises(CodedError, match="here: expected yes or no or nothing, got 'perhaps'"):
        yes_or_no("perhaps", "here", "bad")


def test_methods_and_scenarios_keep_their_order_without_unplanned_runs(tmp_path):
    columns = ["participant", "scenario", "method", "seed", "completed", *TIMES, "jaccard", "as_planned", "helped"]
    rows = [
        {"participant": "p2", "scenario": "corner", "method": "robot_only", "completed": "true", "as_planned": ""},
        {"participant": "p1", "scenario": "door", "method": "other", "completed": "2", "as_planned": "1"},
        {"participant": "p1", "scenario": "desk", "method": "nrs", "completed": "0", "as_planned": "1"},
        {"participant": "p3", "scenario": "room", "method": "nrs", "completed": "", "as_planned": "0"},
    ]
    study_rows.write(tmp_path / "runs.csv", rows, columns)
    (tmp_path / "study.json").write_text('{"scenarios": {"desk": "The desk"}, "people": true}')
    study = read_study(tmp_path)
    assert study.methods == ["nrs", "other", "robot_only"] and study.comparison == ("nrs", "robot_only")
    assert study.scenarios == ["corner", "desk", "door"] and study.scenario_title("desk") == "The desk"
    assert study.runs.completed.tolist() == [1.0, 1.0, 0.0] and study.meta["deviating"] == 1
    assert len(study.missing) == 2 * 3 * 3 - 3 and "p2, The desk, Robot only" in study.missing
    assert np.isnan(study.runs.helped).all() and not cross_checks.worlds_table(study).rows
    cells = {(scenario, method): len(runs) for scenario, method, runs in study.by_method()}
    assert cells["door", "other"] == 1 and sum(cells.values()) == 3
    assert sum(len(runs) for *_, runs in study.by_method(completed=1)) == 2
    rows[3].update(as_planned="1", helped="often")
    study_rows.write(tmp_path / "runs.csv", rows, columns)
    assert np.isnan(read_study(tmp_path).runs.completed.iloc[3]), "what is not known is no failure"
    (tmp_path / "study.json").write_text("[]")
    with pytest.raises(CodedError, match="expected keys and values"):
        read_study(tmp_path)


# ------------------------------------------------------------------ the published study
PAGE = PUBLISHED.parent / "README.md"


def test_every_index_is_that_of_the_published_areas():
    """Recomputes the indices with numpy alone, as a reader without this program would."""
    areas = np.load(PUBLISHED / "areas.npz")
    saved = [row for row in rows_of(PUBLISHED / "runs.csv") if row["map"]]
    assert len(saved) > 20
    for row in saved:
        area, truth = areas[Path(row["map"]).stem], areas[f"truth_{row['scenario']}"]
        assert (area & truth).sum() / (area | truth).sum() == pytest.approx(float(row["jaccard"]), abs=6e-5)
        inside = [cells if row["scenario"] != "corner" else areas["floor"] & ~cells for cells in (area, truth)]
        index = (inside[0] & inside[1]).sum() / (inside[0] | inside[1]).sum()
        assert index == pytest.approx(float(row["jaccard_enclosed"]), abs=6e-5)


def test_the_page_answers_what_the_rows_say(tmp_path):
    page = Path(shutil.copy(PAGE, tmp_path))
    write_page(PUBLISHED, page)
    assert page.read_text(encoding="utf-8") == PAGE.read_text(encoding="utf-8")
    write_page(study_rows.make_study(tmp_path / "fewer", 11), page)
    assert page.read_text(encoding="utf-8") != PAGE.read_text(encoding="utf-8")
    page.write_text("# A page without a place for them\n")
    with refused("no_place"):
        write_page(PUBLISHED, page)


@pytest.mark.parametrize("scenario, beside", [("room", ["The paper's people"]), ("door", [])])
def test_a_lab_asks_its_own_scenarios(scenario, beside, tmp_path):
    folder = study_rows.make_study(tmp_path / "study", 6, runs_only=True)
    rows = [row for row in rows_of(folder / "runs.csv") if row["scenario"] == "room"]
    rows = [dict(row, scenario=scenario, pointed_right="") for row in rows]  # only a simulator knows pointed_right
    study_rows.write(folder / "runs.csv", rows)
    blocks = format_findings(read_study(folder))
    questions = [line.split("**")[1].rstrip("?") for line in blocks[1].splitlines()]
    assert questions == ["Faster", "Not less exact", "Completed as often", *beside]
    assert any(block.startswith("### Beside the paper") for block in blocks) is bool(beside)
    study_rows.write(folder / "runs.csv", [row for row in rows if row["method"] == "nrs"])
    with refused("no_comparison"):
        format_findings(read_study(folder))


# ------------------------------------------------------------------ the questionnaire
def person(name, nrs, robot_only, helped="yes"):
    """Returns a row with the same pair of answers to all statements."""
    return [name, *[answer for _ in questionnaire.STATEMENTS for answer in (nrs, robot_only)], helped]


def test_answers_not_given_are_left_out(tmp_path):
    people = [person("a", 5, ""), person("b", 4, 3, "no"), person("c", 5, 2, "")]
    path = study_rows.write(tmp_path / "a.csv", people, questionnaire.COLUMNS)
    answers = questionnaire.read_questionnaire(path)
    assert (answers.helped.sum(), answers.helped.count()) == (1, 2)
    first, *_ = questionnaire._compare_answers(answers, {"a statement": ["s1"]})
    assert (first["Pairs"], first["Network robot system"], first["Robot only"]) == (2, 4.5, 2.5)


def test_people_have_p_corrected_in_each_family_and_the_ueq_s_as_published(tmp_path):
    folder = study_rows.make_study(tmp_path / "study", 6, runs_only=True, people=True)
    # an answer to each statement, then the ticked box of each pair, whose good end is on the right
    answer_pairs = zip((5, 4, 5, 4, 5, 7, 7, 6, 5, 4, 3, 2, 1), (1, 2, 3, 3, 4, *(1,) * 8))
    row = [answer for pair in answer_pairs for answer in pair]
    rows = [[number, *row[:10], "yes", *row[10:]] for number in range(6)]
    study_rows.write(folder / "questionnaire.csv", rows, [*questionnaire.COLUMNS, *questionnaire.UEQ_COLUMNS])
    (folder / "warnings.csv").write_text("warning\n<b>![a](https://b.example/c.png)|d\n")
    page = words_of(write_report(folder).read_text())
    assert "exact p" in page and "Yes: 6 of 6" in page and "<b>![a](https://b.example/c.png)|d" in page
    assert "This is a simulation" not in page
    study = read_study(folder)
    tables = {table.name: table.rows for table in report_tables(study)}
    means = [(row["Network robot system"], row["Robot only"]) for row in tables["questionnaire"]]
    assert means == [(5, 1), (4, 2), (5, 3), (4, 3), (5, 4), (2.25, -3.0), (-1.5, -3.0), (0.375, -3.0)]
    # 5 and 3 times 2 of 2**6
    assert [row["p (Holm)"] for row in tables["questionnaire"]] == [".156"] * 5 + [".094"] * 3
    for column, (title, _, sign, margin) in COMPARED.items():
        family = study.differences(study.runs, column).values()
        ps = {"tests": [statistics.signed_rank_test(differences).p_exact for differences in family]}
        if column != "time_total_s":
            ps["not_worse"] = [statistics.noninferiority_p(sign * differences, margin) for differences in family]
        for name in ps:
            written = [row["p (Holm)"] for row in tables[name] if row["Measure"] == title]
            assert written == [statistics.format_p(p) for p in statistics.holm(ps[name])] and len(written) == 3


@pytest.mark.parametrize(
    "rows, columns, words",
    [
        ([person("a", 6, 3)], questionnaire.COLUMNS, "line 2: s1_nrs: expected a whole number from 1 to 5, got '6'"),
        ([person("a", 3.5, 3)], questionnaire.COLUMNS, "got '3.5'"),
        ([person("a", 3, 3), person("a", 3, 3)], questionnaire.COLUMNS, "line 3: participant"),
        ([person("a", 3, 3, "perhaps")], questionnaire.COLUMNS, "helped: expected yes or no"),
        ([], questionnaire.COLUMNS, "nobody has answered"),
        ([], ["participant"], "s1_nrs"),
    ],
)
def test_wrong_answers_name_line_or_column(rows, columns, words, tmp_path):
    path = study_rows.write(tmp_path / "a.csv", rows, columns)
    with refused("bad_questionnaire") as caught:
        questionnaire.read_questionnaire(path)
    assert words in str(caught.value)
    path.unlink()
    with refused("bad_questionnaire"):
        questionnaire.read_questionnaire(path)
