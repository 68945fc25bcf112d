"""The report agrees with the rows, has intervals and caveats, and copes with few or odd data; the published report."""

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
from vb_evaluation.report import comparisons, cross_checks, questionnaire
from vb_evaluation.report.document import compute_tables, format_document, write_page, write_report
from vb_evaluation.report.map_figures import nearest_to_median
from vb_evaluation.report.study_files import ERRORS, TIMES, StudyResults, read_flags, read_sheet, read_study
from vb_evaluation.report.study_files import write_table
from vb_evaluation.statistics import Interval
from vb_evaluation.user_study import __main__ as command


@pytest.fixture(scope="module")
def full(tmp_path_factory):
    """Returns the folder of a study with every file, and its page."""
    folder = study_rows.make_study(tmp_path_factory.mktemp("study") / "full", participants=6)
    return folder, write_report(folder).read_text(encoding="utf-8")


def numbers_of(cell):
    """Returns the numbers in a table's cell: an estimate and its limits."""
    return [float(number) for number in re.findall(r"[-\d.]+", cell.replace("−", "-"))]


def words_of(page):
    return html.unescape(re.sub(r"<[^>]+>", " ", re.sub(r"<style>.*?</style>", "", page, flags=re.S)))


def test_tables_hold_what_the_rows_say(full):
    folder, _ = full
    runs = pandas.read_csv(folder / "runs.csv")
    keys = {"Room exclusion": "room", "Carpet exclusion": "carpet", "Spot cleaning": "corner"}
    keys.update({"Network robot system": "nrs", "Robot only": "robot_only"})
    table = compute_tables(read_study(folder))["error"]
    assert len(table) == 6
    for row in table:
        cell = (runs.scenario == keys[row["Scenario"]]) & (runs.method == keys[row["Method"]])
        done = runs[cell & (runs.completed == 1)]
        for column, heading in zip(ERRORS, ("mean [cm]", "95 % of the boundary within [cm]", "largest [cm]")):
            median, low, high = numbers_of(row[heading])
            assert median == pytest.approx(done[column].median(), abs=0.0501)
            assert low <= median <= high
        assert int(row["Runs"]) == len(done)


def test_simulated_people_have_no_p(full):
    assert not re.search(r"\bp [<=]|exact p|Wilcoxon signed-rank", words_of(full[1]))


@pytest.mark.parametrize("low, high, reading", [(0.8566, 0.9, "better"), (0.7, 0.8554, "worse"), (0.8564, 0.9, "same")])
def test_better_than_the_paper_is_no_agreement(low, high, reading):
    ours = Interval((low + high) / 2, low, high)
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
    for row in cross_checks.count_worlds(read_study(tmp_path)):
        share, *_ = numbers_of(row["holds in [%] of worlds"])
        counts[row["Worlds"]].append((round(share * row["Number"] / 100), row["Number"]))
    assert counts["no camera too bright"] == [(3, 6), (2, 3), (1, 3), (2, 3), (3, 4), (4, 6), (4, 6)]
    assert counts["all"] == [(4, 7), (3, 4), (2, 4), (3, 4), (4, 5), (5, 7), (5, 7)]
    study_rows.write(tmp_path / "runs.csv", rows[::2])
    assert "worlds" not in compute_tables(read_study(tmp_path))  # nothing to compare with


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
    study_rows.write(folder / "runs.csv", rows_of(folder / "runs.csv")[:-1])
    page = write_report(folder).read_text()
    assert "Beside the paper" in page
    assert "Plausible worlds" not in page and "nan" not in words_of(page)
    assert f"1 of {6 * participants} runs are missing" in page


@pytest.mark.parametrize("column", ["jaccard", "time_total_s", "error_mean_cm", "helped", "completed"])
def test_bad_data_is_reported_in_one_line(tmp_path, column, capsys):
    folder = study_rows.make_study(tmp_path / "study", 1, runs_only=True)
    rows = rows_of(folder / "runs.csv")
    rows[0][column] = "1,5"
    study_rows.write(folder / "runs.csv", rows)
    assert command.main(["report", str(folder)]) == 2
    expected = "0 or 1" if column == "completed" else "a number"
    assert f"line 2: {column}: expected {expected}, got '1,5'" in capsys.readouterr().err


def test_a_missing_file_or_column_is_named(tmp_path):
    with pytest.raises(CodedError, match="cannot read .*runs.csv"):
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
    table = pandas.DataFrame(rows, columns=["participant", "method", "completed", column]).assign(scenario="room")
    study = StudyResults(Path(), table, 0, pandas.DataFrame(), pandas.DataFrame(), {})
    assert list(zip(*study.pairs(column, "room"))) == expected


def test_a_sheet_is_read_as_spreadsheets_write_it(tmp_path):
    path = tmp_path / "sheet.csv"
    path.write_text("\ufeffa; b;c\n1 ;x,y;\n;;\n 2;;z\n", encoding="utf-8")
    sheet = read_sheet(path, ["a"])
    assert sheet.index.tolist() == [2, 4] and sheet.a.tolist() == ["1", "2"]
    assert sheet[" b"].tolist() == ["x,y", ""] and sheet.c.tolist() == ["", "z"]
    write_table(path, ["a", "c"], [{"a": 1, "c": "x;y"}, {"a": 2.5}])
    assert path.read_text() == "a,c\n1,x;y\n2.5,\n"
    assert read_sheet(path, []).to_dict("list") == {"a": ["1", "2.5"], "c": ["x;y", ""]}


def test_flags_are_what_people_write_for_yes_and_no():
    flags = read_flags(pandas.Series(["yes", "NEIN", "1", ""]), Path("sheet.csv"), "bad")
    assert flags.tolist() == [True, False, True, None]
    with pytest.raises(CodedError, match="sheet.csv, line 0: completed: expected yes or no or nothing, got 'perhaps'"):
        read_flags(pandas.Series(["perhaps"], name="completed"), Path("sheet.csv"), "bad")


def test_methods_and_scenarios_keep_their_order_without_unplanned_runs(tmp_path):
    columns = ["participant", "scenario", "method", "seed", "completed", *TIMES, "jaccard", "as_planned", "helped"]
    rows = [
        {"participant": "p2", "scenario": "corner", "method": "robot_only", "completed": "1", "as_planned": ""},
        {"participant": "p1", "scenario": "door", "method": "other", "completed": "1", "as_planned": "1"},
        {"participant": "p1", "scenario": "desk", "method": "nrs", "completed": "0", "as_planned": "1"},
        {"participant": "p3", "scenario": "room", "method": "nrs", "completed": "", "as_planned": "0"},
    ]
    study_rows.write(tmp_path / "runs.csv", rows, columns)
    (tmp_path / "study.json").write_text('{"scenarios": {"desk": "The desk"}, "people": true}')
    study = read_study(tmp_path)
    assert list(study.methods) == ["nrs", "other", "robot_only"]
    assert study.comparison == ("nrs", "robot_only")
    assert study.scenarios == {"corner": "Spot cleaning", "desk": "The desk", "door": "Door"}
    assert study.runs.completed.tolist() == [1.0, 1.0, 0.0]
    assert study.deviating == 1
    assert np.isnan(study.runs.helped).all()
    assert cross_checks.count_worlds(study) == []
    completeness = {(row["Scenario"], row["Method"]): row["Completed"] for row in compute_tables(study)["completeness"]}
    assert completeness["Door", "Other"] == "1 of 1"
    assert list(completeness.values()).count("0 of 0") == 3 * 3 - 3
    assert "15 of 18 runs are missing" in write_report(tmp_path).read_text()
    rows[3].update(as_planned="1")
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
    document = format_document(read_study(folder))
    assert re.findall(r"\*\*(.*)\?\*\*", document) == ["Faster", "Not less exact", "Completed as often", *beside]
    assert ("### Beside the paper" in document) is bool(beside)


def test_a_study_of_one_method_is_described_without_answers(tmp_path):
    folder = study_rows.make_study(tmp_path / "study", 6, runs_only=True)
    study_rows.write(folder / "runs.csv", [row for row in rows_of(folder / "runs.csv") if row["method"] == "nrs"])
    headings = re.findall("^### (.*)", format_document(read_study(folder)), re.M)
    described = ["Boundary error", "Interaction time", "Jaccard index", "Completed", "Every run that was not completed"]
    assert headings == described
    assert "Faster?" not in write_report(folder).read_text()


# ------------------------------------------------------------------ the questionnaire
def person(name, nrs, robot_only, helped="yes"):
    """Returns a row with the same pair of answers to all statements."""
    return [name, *[answer for _ in questionnaire.STATEMENTS for answer in (nrs, robot_only)], helped]


@pytest.fixture
def people(tmp_path):
    """The folder of a study with six people, who have not answered yet."""
    return study_rows.make_study(tmp_path / "study", 6, runs_only=True, people=True)


def test_answers_not_given_are_left_out(people):
    answers = [person("a", 5, ""), person("b", 4, 3, "no"), person("c", 5, 2, "")]
    study_rows.write(people / "questionnaire.csv", answers, questionnaire.COLUMNS)
    first, *_, last = questionnaire.compare_ratings(read_study(people))
    assert (first["Pairs"], first["Network robot system"], first["Robot only"]) == (2, "4.50", "2.50")
    assert last["Network robot system"] == "yes: 1 of 2"


def test_the_statements_have_p_corrected_over_their_family(people):
    ratings = [rating for pair in zip((5, 4, 5, 4, 5), (1, 2, 3, 3, 4)) for rating in pair]
    rows = [[number, *ratings, "yes"] for number in range(6)]
    study_rows.write(people / "questionnaire.csv", rows, questionnaire.COLUMNS)
    *statements, _ = compute_tables(read_study(people))["ratings"]
    means = [(row["Network robot system"], row["Robot only"]) for row in statements]
    assert means == [("5.00", "1.00"), ("4.00", "2.00"), ("5.00", "3.00"), ("4.00", "3.00"), ("5.00", "4.00")]
    assert [row["p (Holm)"] for row in statements] == [".156"] * 5  # 5 times 2 of 2**6


def test_measures_have_p_corrected_over_the_scenarios(people):
    study = read_study(people)
    tests = compute_tables(study)["tests"]
    for column, measure in comparisons.COMPARED.items():
        ps = [statistics.signed_rank_test(study.differences(column, scenario)).p for scenario in study.scenarios]
        # Holm (1979) multiplies the sorted p by 3, 2 and 1, and makes none smaller than the one before
        factors = 3 - np.argsort(np.argsort(ps))
        corrected = [max(min(1.0, q * factor) for q, factor in zip(ps, factors) if q <= p) for p in ps]
        rows = [row for row in tests if row["Measure"] == measure.title]
        assert [row["exact p"] for row in rows] == [statistics.format_p(p) for p in ps]
        assert [row["p (Holm)"] for row in rows] == [statistics.format_p(p) for p in corrected]


def test_the_page_of_a_study_with_people_has_their_tests_and_notes_as_they_are(people):
    rows = rows_of(people / "runs.csv")
    rows[0].update(completed="0", note="<b>![a](https://b.example/c.png)|d")
    study_rows.write(people / "runs.csv", rows)
    page = words_of(write_report(people).read_text())
    assert "exact p" in page
    assert "<b>![a](https://b.example/c.png)|d" in page
    assert "This is a simulation" not in page


@pytest.mark.parametrize(
    "rows, columns, words",
    [
        ([person("a", 6, 3)], questionnaire.COLUMNS, "line 2: s1_nrs: expected a whole number from 1 to 5, got '6'"),
        ([person("a", 3.5, 3)], questionnaire.COLUMNS, "got '3.5'"),
        ([person("a", 3, 3), person("a", 3, 3)], questionnaire.COLUMNS, "line 3: participant"),
        ([person("a", 3, 3, "perhaps")], questionnaire.COLUMNS, "helped: expected yes or no"),
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
