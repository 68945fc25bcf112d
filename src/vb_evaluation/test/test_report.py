"""The report says what the CSV says: each number found again, nothing from outside, few or odd data."""
import csv
import html
import json
import math
import re
import statistics as plain
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from vb_core.errors import CodedError
from vb_evaluation.report import __main__ as command
from vb_evaluation.report import charts, write_report
from vb_evaluation.report.data import read_study
from vb_evaluation.report.ledger import Ledger, spans

sys.path.insert(0, str(Path(__file__).parent))
import study_rows  # noqa: E402


@pytest.fixture(scope="module")
def full(tmp_path_factory):
    """A study with everything, and its page."""
    folder = study_rows.make_study(tmp_path_factory.mktemp("study") / "full", participants=6)
    return folder, write_report(folder).read_text(encoding="utf-8")


@pytest.fixture
def no_pictures(monkeypatch):
    """Figures are made but not rendered: most of a page's time."""
    monkeypatch.setattr(charts, "_svg", lambda figure: charts.plt.close(figure) or "data:image/svg+xml;base64,")


def rows_of(path):
    with open(str(path), newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def lines_of(text):
    """{2, 3, 4, 7} of "2-4, 7"."""
    found = set()
    for part in filter(None, text.split(", ")):
        first, _, last = part.partition("-")
        found |= set(range(int(first), int(last or first) + 1))
    return found


def again(folder, entry):
    """The value of a line of numbers.csv, computed anew with other means from the lines that it names."""
    lines = (folder / entry["file"]).read_text().splitlines()
    rows = list(csv.DictReader([lines[0]] + [lines[number - 1] for number in sorted(lines_of(entry["lines"]))]))
    for name, wanted in (part.split("=") for part in entry["where"].split("; ") if part):
        assert all(row[name] in wanted.split("|") for row in rows), entry
    number = lambda row: float(row[entry["column"]])  # noqa: E731
    if not entry["methods"]:
        values = [number(row) for row in rows]
        simple = {
            "n": len,
            "sum": sum,
            "mean": plain.fmean,
            "median": plain.median,
            "min": min,
            "max": max,
            "sd": plain.stdev,
        }
        return float(simple[entry["statistic"]](values)) if entry["statistic"] in simple else None
    first, second = entry["methods"].split(" vs ")
    keys = ("participant", "scenario", "sweep", "value", "parameter", "factor")
    by_key = {}
    for row in rows:
        by_key.setdefault(tuple(row.get(key) for key in keys), {})[row["method"]] = number(row)
    a = np.array([pair[first] for pair in by_key.values()])
    b = np.array([pair[second] for pair in by_key.values()])
    differences = np.round(a - b, 9)
    simple = {
        "pairs": lambda: len(a),
        "faster": lambda: int(sum(a < b)),
        "difference": lambda: np.mean(a - b),
        "median_difference": lambda: plain.median(a) - plain.median(b),
        "ratio": lambda: b.mean() / a.mean(),
        "shapiro_p": lambda: stats.shapiro(differences).pvalue,
        "p": lambda: stats.wilcoxon(differences, zero_method="wilcox", correction=False, mode="approx").pvalue,
    }
    return float(simple[entry["statistic"]]()) if entry["statistic"] in simple else None


@pytest.mark.filterwarnings("ignore")
def test_every_number_is_found_again_from_the_lines_that_it_names(full):
    folder, page = full
    numbers = rows_of(folder / "numbers.csv")
    assert len(numbers) > 300
    checked = 0
    for entry in numbers:
        value = float(entry["value"])
        if math.isnan(value):
            assert entry["text"] == "–"
            continue
        expected = again(folder, entry)
        if expected is not None:
            assert value == pytest.approx(expected, rel=1e-9, abs=1e-9), entry
            checked += 1
    assert checked > 0.5 * len(numbers)


def test_every_number_on_the_page_leads_to_its_origin(full):
    folder, page = full
    numbers = {entry["id"]: entry for entry in rows_of(folder / "numbers.csv")}
    shown = re.findall(r'<a class="n" href="#(n\d+)" title="([^"]*)">([^<]*)</a>', page)
    assert len(shown) > 300 and {key for key, _, _ in shown} <= set(numbers)
    for key, title, text in shown:
        assert html.unescape(text) == numbers[key]["text"]
        assert numbers[key]["file"] in title and numbers[key]["column"] in title
    for key in numbers:
        assert f'<tr id="{key}">' in page


def test_numbers_in_the_text_of_tables_are_all_linked(full):
    _, page = full
    # a cell of digits without a link would be a number without an origin; the tables at the end are the data itself
    body = page[: page.index('<section id="agreement">')]
    for cell in re.findall(r"<td[^>]*>([^<]*)</td>", body):
        assert not re.fullmatch(r"[−-]?\d*\.\d+( %)?", cell) or cell in PAPER_TEXTS or cell in SETTINGS, cell


PAPER_TEXTS = {".971", ".974", ".856", ".779", ".878", ".906", "93.3 %", "86.7 %", "2.8", "2.2"}
SETTINGS = {str(value) for value in (0.5, 0.0, 0.25, 0.75, 1.0, 2.5, 4.0, 5.5, 8.0, 0.7, 2.0, 6.5, 9.0, 0.15, 0.6)}


def test_the_page_stands_alone(full):
    _, page = full
    assert not re.search(r"""(src|href)\s*=\s*["']?\s*(https?:|//)""", page)
    assert "@import" not in page and "<script" not in page and "url(" not in page
    assert all(source.startswith("data:image/") for source in re.findall(r'src="([^"]*)"', page))
    targets = set(re.findall(r'id="([^"]+)"', page))
    assert {anchor for anchor in re.findall(r'href="#([^"]+)"', page)} <= targets


def test_it_says_what_it_is_and_invents_no_opinions(full):
    _, page = full
    top = page[page.index("<body>") : page.index("Findings</h2>")]
    assert "This is a simulation" in top and "No person took part" in top
    assert "no opinions" in page
    for word in ("questionnaire", "Likert", "intuitive", "demanding", "−3.051"):
        assert word not in page


def test_tables_are_csv_too(full):
    folder, _ = full
    names = {path.stem for path in (folder / "tables").glob("*.csv")}
    assert names == {
        "times",
        "time_tests",
        "accuracy",
        "accuracy_tests",
        "completeness",
        "beside_the_paper",
        "curves",
        "sensitivity",
    }
    runs = [row for row in rows_of(folder / "runs.csv") if (row["scenario"], row["method"]) == ("carpet", "nrs")]
    (row,) = [
        row
        for row in rows_of(folder / "tables" / "times.csv")
        if row["scenario"].startswith("Carpet") and row["method"].startswith("Net")
    ]
    assert float(row["border"]) == pytest.approx(np.mean([float(run["time_border_s"]) for run in runs]))


def test_runs_through_ros_stand_beside_those_of_the_study(full):
    folder, page = full
    part = page[page.index('<section id="agreement">') : page.index('<section id="trace">')]
    for row in rows_of(folder / "agreement.csv"):
        assert f"<td>{row['runner']}</td>" in part and f"<td>{row['time_total_s']}</td>" in part


def test_every_run_has_its_command(full):
    folder, page = full
    for row in rows_of(folder / "runs.csv"):
        assert (
            html.escape(
                f"make study ROW='{row['participant']} {row['scenario']} {row['method']} {row['seed']}'", quote=False
            ).replace("'", "&#39;")
            in page
        )


def test_the_same_study_gives_the_same_page(full):
    folder, page = full
    assert write_report(folder).read_text(encoding="utf-8") == page


def test_maps_are_those_nearest_to_the_median(full):
    from vb_evaluation.report.maps import nearest_to_median

    folder, page = full
    study = read_study(folder)
    for scenario in ("room", "carpet", "corner"):
        values = [
            float(row["jaccard"])
            for row in rows_of(folder / "runs.csv")
            if (row["scenario"], row["method"], row["completed"]) == (scenario, "nrs", "1")
        ]
        line, row = nearest_to_median(study, scenario, "nrs")
        assert abs(float(row["jaccard"]) - plain.median(values)) == min(
            abs(value - plain.median(values)) for value in values
        )
        assert f'href="#run{line}"' in page
    assert page.count("Jaccard 0.") + page.count("Jaccard 1.") >= 6


@pytest.mark.usefixtures("no_pictures")
def test_a_map_that_does_not_fit_its_line_is_told(tmp_path):
    folder = study_rows.make_study(tmp_path / "s", participants=1, sweeps=False)
    rows = rows_of(folder / "runs.csv")
    for row in rows:
        row["completed"], row["jaccard"] = "1", row["jaccard"] or "0.5"
    chosen = next(row for row in rows if row["map"])
    chosen["jaccard"] = "0.1234"
    study_rows.write(folder / "runs.csv", study_rows.RUN_COLUMNS, rows)
    assert "the line says 0.123" in write_report(folder).read_text()


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("participants", [1, 5])
def test_few_participants_and_nothing_but_runs(tmp_path, participants):
    folder = study_rows.make_study(tmp_path / "s", participants=participants, sweeps=False, maps=False)
    page = write_report(folder).read_text()
    assert "Quick run" in page and "There are no maps" in page and "Sensitivity" not in page
    if participants == 5:
        assert "pairs can reach p = 0.0625 at best" in page


@pytest.mark.usefixtures("no_pictures")
def test_a_study_under_way_has_other_rows_missing(tmp_path):
    folder = study_rows.make_study(tmp_path / "s", participants=3, sweeps=False, maps=False)
    rows = rows_of(folder / "runs.csv")
    study_rows.write(folder / "runs.csv", study_rows.RUN_COLUMNS, rows[:7])
    page = write_report(folder).read_text()
    assert "Network robot system" in page and "Not every participant has every run" in page
    study_rows.write(folder / "runs.csv", study_rows.RUN_COLUMNS, [row for row in rows if row["method"] == "nrs"])
    assert "Beside the paper" not in write_report(folder).read_text()


@pytest.mark.usefixtures("no_pictures")
def test_runs_that_are_missing_are_named(tmp_path):
    folder = study_rows.make_study(tmp_path / "s", participants=3, sweeps=False, maps=False)
    assert "Missing:" not in write_report(folder).read_text()
    rows = rows_of(folder / "runs.csv")
    lost = ("p02", "carpet", "robot_only")
    kept = [row for row in rows if (row["participant"], row["scenario"], row["method"]) != lost]
    study_rows.write(folder / "runs.csv", study_rows.RUN_COLUMNS, kept)
    assert "Missing: Carpet exclusion, robot only: participant p02." in write_report(folder).read_text()


def test_scenarios_stand_in_the_order_of_the_study_not_of_the_first_participant(tmp_path):
    folder = study_rows.make_study(tmp_path / "s", participants=3, sweeps=False, maps=False)
    rows = rows_of(folder / "runs.csv")
    study_rows.write(folder / "runs.csv", study_rows.RUN_COLUMNS, rows[::-1])
    titles = ("Room exclusion", "Carpet exclusion", "Spot cleaning")
    assert [read_study(folder).scenario_title(key) for key in read_study(folder).scenarios] == list(titles)


@pytest.mark.usefixtures("no_pictures")
def test_scenarios_methods_and_metrics_of_ones_own(tmp_path):
    random = np.random.default_rng(1)
    rows = []
    for who in study_rows.every(6, ("nrs", "robot_only", "magic"), ("carpet",)):
        row = study_rows.run(random, *who)
        rows.append(dict(row, scenario="play_mat", way_m=f"{random.normal(5, 1):.3f}", remark="text"))
    study_rows.write(tmp_path / "runs.csv", [*study_rows.RUN_COLUMNS[:-1], "way_m", "remark"], rows)
    (tmp_path / "study.json").write_text(json.dumps({"scenarios": {"play_mat": "The <play> mat"}}))
    page = write_report(tmp_path).read_text()
    assert "The &lt;play&gt; mat" in page and "<play>" not in page
    assert "Magic" in page and "Further measures" in page and "way_m" in page and "Beside the paper" not in page


@pytest.mark.parametrize(
    "change, words",
    [
        (lambda rows: [dict(row, jaccard="much") for row in rows], "line 2: jaccard"),
        (lambda rows: rows + [rows[0]], "the same participant, scenario and method twice"),
        (lambda rows: [], "no rows"),
    ],
)
def test_bad_data_is_one_line(tmp_path, change, words, capsys):
    folder = study_rows.make_study(tmp_path / "s", participants=2, sweeps=False, maps=False)
    rows = rows_of(folder / "runs.csv")
    study_rows.write(folder / "runs.csv", study_rows.RUN_COLUMNS, change(rows))
    assert command.main([str(folder)]) == 2
    error = capsys.readouterr().err
    assert words in error and error.count("\n") == 1


def test_a_curve_over_words_is_told(tmp_path):
    folder = study_rows.make_study(tmp_path / "s", participants=1, sweeps=True, maps=False)
    text = (folder / "curves.csv").read_text().replace("coverage,0.5,", "coverage,half,")
    (folder / "curves.csv").write_text(text)
    with pytest.raises(CodedError) as caught:
        read_study(folder)
    assert "curves.csv, line" in str(caught.value) and "value" in str(caught.value)


def test_a_missing_file_or_column(tmp_path):
    with pytest.raises(CodedError) as caught:
        write_report(tmp_path)
    assert "make study" in str(caught.value)
    (tmp_path / "runs.csv").write_text("participant,scenario\n1,room\n")
    with pytest.raises(CodedError) as caught:
        write_report(tmp_path)
    assert "the column method is missing" in str(caught.value)


def test_pairs_go_by_participant_not_by_order(tmp_path):
    folder = study_rows.make_study(tmp_path / "s", participants=6, sweeps=False, maps=False)
    before = Ledger(read_study(folder)).two(
        "runs.csv", "time_total_s", "z", "z", ("nrs", "robot_only"), scenario="room"
    )
    rows = rows_of(folder / "runs.csv")
    np.random.default_rng(0).shuffle(rows)
    study_rows.write(folder / "runs.csv", study_rows.RUN_COLUMNS, rows)
    after = Ledger(read_study(folder)).two("runs.csv", "time_total_s", "z", "z", ("nrs", "robot_only"), scenario="room")
    assert before.value == after.value and before.lines != after.lines


def test_spans():
    assert spans([7, 2, 3, 4]) == "2-4, 7" and spans([]) == "" and lines_of("2-4, 7") == {2, 3, 4, 7}
