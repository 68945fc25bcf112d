"""Writes the report, section by section; every figure comes with what limits it.

The order is by importance: how far the border is from where it was wanted, then time, then the paper's Jaccard
index. For simulated people, effects have intervals and no p: their number is free, so that any effect can be
made significant. For real people, the paper's tests are reported too.
"""
from __future__ import annotations

import math
from typing import Any, Dict, List, Tuple

import numpy as np

from vb_evaluation import questionnaire, statistics
from vb_evaluation.report import charts, maps, paper, worlds
from vb_evaluation.report.blocks import Figure, Grid, Section, Text, interval_text
from vb_evaluation.report.data import CURVES, ERRORS, STATES, UNGATED, Study, Table, number, read_table
from vb_evaluation.report.paper import PAPER
from vb_evaluation.statistics import Interval

ERROR_TITLES = dict(zip(ERRORS, ("mean", "95 % of the boundary within", "largest")))
SWEEPS = {
    "coverage": ("Camera coverage", "part of the floor that ceiling cameras see"),
    "distance": ("Distance of the robot", "path of the robot to the border [m]"),
    "border_length": ("Border length", "length of the border [m]"),
    "robots": ("Number of robots", "robots"),
}


def title(study: Study) -> str:
    """The page's heading."""
    kind = "people" if study.people else "simulated people"
    return f"Drawing virtual borders: the study with {kind}"


def notices(study: Study) -> List[str]:
    """What readers must know before any figure."""
    count = len(study.runs.distinct("participant"))
    found = [f"{count} people, {len(study.runs.rows)} runs." if study.people else (
        f"This is a simulation: {count} simulated people, {len(study.runs.rows)} runs. No person took part. The figures follow "
        "from the assumptions that are listed below; they predict nothing about people, and user experience is not examined.")]
    made = [f"{name} {study.meta[name]}" for name in ("revision", "command", "machine", "date") if study.meta.get(name)]
    if made:
        found.append("Made by: " + "; ".join(made))
    if study.meta.get("deviating"):
        found.append(f"{study.meta['deviating']} runs were not done in the planned condition and are left out; runs.csv has them.")
    if study.meta.get("quick"):
        found.append("A quick run: few participants, wide intervals, no curves.")
    if study.missing:
        found.append(f"Missing runs ({len(study.missing)}): {'; '.join(study.missing[:12])}. Means take the runs that are there, "
                     "differences the participants who have both.")
    return found


def all_sections(study: Study) -> List[Section]:
    """Every section for which the study has something."""
    found = [summary(study), error(study), time(study), accuracy(study), completeness(study), beside(study), plausible(study),
             curves(study), ungated(study), order(study), experience(study), assumptions(study), runs(study)]
    return [section for section in found if section.blocks]


# ------------------------------------------------------------------ the parts
def summary(study: Study) -> Section:
    """Effects of the method, each with its interval."""
    if len(study.methods) < 2:
        return Section("summary", "Findings", [])
    rows = []
    for scenario in study.scenarios:
        here = study.runs.select(scenario=scenario)
        rows.append({
            "scenario": study.scenario_title(scenario),
            "pairs": len(here.pairs("time_total_s", study.comparison)[0]),
            "error": _shift(here, "error_mean_cm", study.comparison, True),
            "time": _shift(here, "time_total_s", study.comparison),
            "speedup": _ratio(here, study.comparison),
            "jaccard": _shift(here, "jaccard", study.comparison, True),
            "completed": _completed_difference(here, study.comparison),
        })
    names = [paper.method_title(method).lower() for method in study.comparison]
    grid = Grid("summary", {
        "scenario": "Scenario", "pairs": "Pairs", "error": "Mean boundary error [cm]", "time": "Time [s]", "speedup": "Speed-up",
        "jaccard": "Jaccard index", "completed": "Completed [points]"}, rows,
        {"error": 1, "time": 1, "jaccard": 3, "completed": 0},
        words=f"Differences are {names[0]} minus {names[1]}, paired by participant: Hodges-Lehmann estimate and 95 % interval "
              "(accuracy: who completed both). Speed-up: ratio of the mean times, bootstrap interval. [?]: too few pairs.")
    blocks: List[Any] = [grid]
    if not study.people:
        blocks.append(Text((
            "Part of the speed-up is an input, not a result: with the robot as the only camera the spot moves at most at the "
            "robot's 0.2 m/s (paper), with ceiling cameras at what is assumed for a hand, and the robot must first be led to the "
            "border. The intervals say how people of these assumptions differ; they leave out that the assumptions may be "
            "wrong, which the section on plausible worlds is about.",), "caveat"))
    return Section("summary", "Findings", blocks)


def error(study: Study) -> Section:
    """Boundary error in centimetres."""
    rows, panels = [], []
    for scenario in study.scenarios:
        groups = []
        for method in study.methods:
            done = study.runs.select(scenario=scenario, method=method, completed=1)
            row: Dict[str, Any] = {"scenario": study.scenario_title(scenario), "method": paper.method_title(method)}
            row.update({column: statistics.median(done.numbers(column)) for column in ERRORS})
            worst = done.numbers("error_max_cm")
            row.update(worst=float(worst.max()) if len(worst) else math.nan, runs=len(worst))
            rows.append(row)
            groups.append((method, paper.method_title(method), done.numbers("error_mean_cm"), None))
        panels.append((charts.boxes(groups, "mean boundary error [cm]"), study.scenario_title(scenario)))
    if not any(row["runs"] for row in rows):
        return Section("error", "Boundary error", [])
    columns = {"scenario": "Scenario", "method": "Method", **{key: f"{ERROR_TITLES[key]} [cm]" for key in ERRORS},
               "worst": "worst run's largest [cm]", "runs": "Runs"}
    return Section("error", "Boundary error", [
        Text(("How far the boundary that the robot respects lies from the one that was asked for, both ways, over completed runs. "
              "Of each run the mean, the 95th percentile and the largest distance along the boundary; in the table their medians "
              "over runs with bootstrap intervals.",)),
        Figure(panels), Grid("error", columns, rows, {key: 1 for key in (*ERRORS, "worst")}),
        Text(("The map's cells are 2.5 cm wide, so that single distances come in steps of about one cell.",), "caveat"),
        *_test_blocks(study, "error_mean_cm", "cm", True)])


def time(study: Study) -> Section:
    """Interaction time by state."""
    rows = []
    totals = study.runs.numbers("time_total_s")
    limit = 1.04 * float(totals.max()) if len(totals) else 1.0
    panels = []
    for scenario in study.scenarios:
        bars = []
        for method in study.methods:
            here = study.runs.select(scenario=scenario, method=method)
            means = {state: _mean(here.numbers(f"time_{state}_s")) for state in STATES}
            bars.append((method, paper.method_title(method), means, here.numbers("time_total_s")))
            rows.append({"scenario": study.scenario_title(scenario), "method": paper.method_title(method), **means,
                         "total": statistics.mean(here.numbers("time_total_s")), "runs": len(here.rows)})
        panels.append((charts.time_bars(bars, limit), study.scenario_title(scenario)))
    columns = {"scenario": "Scenario", "method": "Method", **{state: f"{state.capitalize()} [s]" for state in STATES},
               "total": "Total, mean [s]", "runs": "Runs"}
    return Section("time", "Interaction time", [
        Text(("From leaving the state Default to the border in the map, in the states Guide (orange), Border (blue) and Seed "
              "(green), attempts that were cancelled included (paper, Sect. 5.5).",)),
        Figure(panels, wide=True), Grid("time", columns, rows, {key: 1 for key in (*STATES, "total")}),
        *_test_blocks(study, "time_total_s", "s", False)])


def accuracy(study: Study) -> Section:
    """The paper's Jaccard index, and representative maps."""
    rows, panels = [], []
    for scenario in study.scenarios:
        groups = []
        for method in study.methods:
            done = study.runs.select(scenario=scenario, method=method, completed=1).numbers("jaccard")
            published = PAPER[scenario].jaccard[method] if paper.published(scenario, (method,)) else math.nan
            rows.append({"scenario": study.scenario_title(scenario), "method": paper.method_title(method), "runs": len(done),
                         "median": statistics.median(done), "least": float(done.min()) if len(done) else math.nan,
                         "paper": published})
            groups.append((method, paper.method_title(method), done, None if math.isnan(published) else published))
        panels.append((charts.boxes(groups, "Jaccard index"), f"{study.scenario_title(scenario)} (diamond: the paper's median)"))
    pictures, notes = maps.representatives(study)
    columns = {"scenario": "Scenario", "method": "Method", "median": "Median", "least": "Smallest", "paper": "Paper",
               "runs": "Runs"}
    blocks: List[Any] = [
        Text(("Restricted cells against those that were asked for, over completed runs.",)),
        Text(("The index saturates with the area's size: of the same error a large area shows little. A line across the 0.70 m "
              "doorway that is 2.5 cm off costs 0.002 to 0.003; the boundary error above tells such runs apart.",), "caveat"),
        Figure(panels), Grid("accuracy", columns, rows, {"median": 3, "least": 3, "paper": 3}),
        *_test_blocks(study, "jaccard", "", True)]
    if pictures:
        blocks += [Text(("Representative maps: the ground truth (yellow), and by method the run nearest to the median: agreement "
                         "(green), restricted beyond the ground truth (red), union (blue outline).",)),
                   Figure([(charts.data_uri(entry.png, "image/png"), _map_words(study, entry)) for entry in pictures])]
    if notes:
        blocks.append(Text(tuple(notes), "list"))
    return Section("accuracy", "Jaccard index", blocks)


def completeness(study: Study) -> Section:
    """Success rates."""
    rows, groups = [], []
    for scenario in study.scenarios:
        bars = []
        for method in study.methods:
            done = study.runs.select(scenario=scenario, method=method).numbers("completed")
            share = statistics.proportion(int(done.sum()), len(done))
            published = PAPER[scenario].completeness if paper.published(scenario, (method,)) else math.nan
            rows.append({"scenario": study.scenario_title(scenario), "method": paper.method_title(method),
                         "completed": f"{int(done.sum())} of {len(done)}", "share": _scaled(share, 100.0), "paper": 100 * published})
            bars.append((method, paper.method_title(method), share.estimate, share.low, share.high,
                         None if math.isnan(published) else published))
        groups.append((study.scenario_title(scenario), bars))
    columns = {"scenario": "Scenario", "method": "Method", "completed": "Completed", "share": "Share [%]", "paper": "Paper [%]"}
    return Section("completeness", "Completeness", [
        Text(("Runs that ended with a saved border and a seed on the side that was asked for; Wilson's 95 % intervals.",)),
        *([] if study.people else [Text((
            "How often simulated people err (wrong side, slips, wrong words) is assumed, so that the level is an input; only the "
            "difference between the methods is a result.",), "caveat")]),
        Figure([(charts.rates(groups), "Completed runs")], wide=True),
        Grid("completeness", columns, rows, {"share": 0, "paper": 1})])


# ------------------------------------------------------------------ the paper
_WHY = {
    ("speed-up", "above"): "The paper's people lost time with both methods alike (thinking, looking, talking), which makes a ratio "
                           "smaller; here only the assumed reactions, looks and words cost time.",
    ("speed-up", "below"): "The paper gives no times by method, so which state makes the difference is not known; the hand's and "
                           "the robot's speed are inputs here.",
    ("Jaccard", "above"): "The simulated lab or its people are still too kind here: tape, aim, localisation and calibration errors "
                          "are assumed, the paper's truth was drawn by hand over a laser map, and extraction is this project's.",
    ("Jaccard", "below"): "The people here mean, aim or close the line worse than the paper's did, or the map's errors are larger.",
    ("completed", "above"): "The share of mistakes is assumed.",
    ("completed", "below"): "The share of mistakes is assumed, and a person here gives up after a fixed number of tries.",
    ("Border", "above"): "The border is drawn at assumed speeds.",
    ("Border", "below"): "The border is drawn at assumed speeds.",
}


def beside(study: Study) -> Section:
    """Each figure of the paper beside ours, in both directions: being better does not count as agreement."""
    methods = ("nrs", "robot_only")
    rows: List[Dict[str, Any]] = []
    for scenario in PAPER if set(methods) <= set(study.methods) else ():
        here = study.runs.select(scenario=scenario)
        if not here.rows:
            continue
        published = PAPER[scenario]
        rows.append(_beside(study, scenario, "speed-up", published.speedup, _ratio(here, methods), 2))
        if published.border_gain_s is not None:
            gain = _mean_difference(here, "time_border_s", methods[::-1])
            rows.append(_beside(study, scenario, "Border state shorter by [s]", published.border_gain_s, gain, 1))
        for method in methods:
            done = here.select(method=method, completed=1).numbers("jaccard")
            rows.append(_beside(study, scenario, f"Jaccard index, {paper.method_title(method).lower()}", published.jaccard[method],
                                statistics.median(done), 3))
            if "jaccard_enclosed" in study.runs.columns and scenario == "corner":
                inside = here.select(method=method, completed=1).numbers("jaccard_enclosed")
                rows.append(_beside(study, scenario, f"Jaccard index of the area drawn round, {paper.method_title(method).lower()}",
                                    published.jaccard[method], statistics.median(inside), 3))
            flags = here.select(method=method).numbers("completed")
            share = _scaled(statistics.proportion(int(flags.sum()), len(flags)), 100.0)
            name = f"completed [%], {paper.method_title(method).lower()}"
            rows.append(_beside(study, scenario, name, 100 * published.completeness, share, 1))
    if not rows:
        return Section("paper", "Beside the paper", [])
    counts = {word: sum(row["reading"].startswith(word) for row in rows) for word in ("same", "better", "worse")}
    grid = Grid("beside_the_paper", {"scenario": "Scenario", "quantity": "Quantity", "paper": "Paper", "here": "Here [95 %]",
                                     "difference": "Here minus paper", "reading": "Reading", "why": "Why, as far as known"}, rows)
    return Section("paper", "Beside the paper", [
        Text((f"{paper.CITATION}. It measured 15 people in a real lab.",
              "Same: the paper's figure lies in our 95 % interval. Otherwise better or worse, and neither is agreement: a simulation "
              "whose people are better than people is wrong in that figure, too. "
              f"Of {len(rows)} figures {counts['same']} are the same, {counts['better']} better, {counts['worse']} worse.")),
        grid,
        Text(("Spot cleaning's index can be read in two ways. Of the restricted floor, all but 3.2 of 40 m\u00b2, the paper's .878 would "
              "need a border that is more than a metre off everywhere; of the 3.2 m\u00b2 that its people drew round it needs about "
              "11 cm. The paper's maps colour \"the area to be specified\", so that the second reading is the likelier one, and both "
              "are given. For room exclusion no reading was found under which .971 is less than some 30 cm.",)),
        Text(("The paper prints no intervals; its figures are of 15 people and uncertain themselves, so that fewer figures differ "
              "than the table says. With few participants our intervals are wide, too, and \"same\" says little.",), "caveat")])


def _beside(study: Study, scenario: str, quantity: str, published: float, ours: Interval, digits: int) -> Dict[str, Any]:
    low, high = (ours.estimate if math.isnan(limit) else limit for limit in (ours.low, ours.high))
    tolerance = 0.5 * 10.0 ** -(3 if digits == 3 else 1)  # the paper's figures are rounded
    above = ours.estimate > published
    reading = "same" if low - tolerance <= published <= high + tolerance else ("better" if above else "worse")
    if math.isnan(ours.estimate):
        reading = "unknown"
    side = "above" if above else "below"
    why = next((words for (start, which), words in _WHY.items() if quantity.startswith(start) and which == side), "")
    text = f"{ours.estimate - published:+.{digits}f}".replace("-", "\N{MINUS SIGN}")
    return {"scenario": study.scenario_title(scenario), "quantity": quantity, "paper": f"{published:.{digits}f}",
            "here": interval_text(ours, digits), "difference": text, "reading": reading,
            "why": why if reading in ("better", "worse") and not study.people else ""}


# ------------------------------------------------------------------ sensitivity
def plausible(study: Study) -> Section:
    """The conclusions over worlds in which all assumptions differ at once."""
    found = worlds.read(study)
    if found is None:
        return Section("worlds", "Plausible worlds", [])
    holds = Grid("worlds", {"conclusion": "Conclusion", "scenario": "Scenario", "holds": "holds in [%] of worlds", "n": "Worlds"},
                 [{**row, "holds": _scaled(row["holds"], 100.0)} for row in found.conclusions], {"holds": 0},
                 words="Wilson's 95 % intervals. A world is a draw of all assumptions, with one person who tries both methods.")
    panels, rows = [], []
    for outcome, entries in found.deciding.items():
        panels.append((charts.rank_bars([(entry["assumption"], *entry["_rho"]) for entry in entries[:12]],
                                        f"rank correlation with {outcome}", found.noise), f"What decides: {outcome}"))
        rows += [{"outcome": outcome, **entry, "rho": Interval(*entry["_rho"], 0.95)} for entry in entries[:12]]
    deciding = Grid("deciding", {"outcome": "Outcome", "assumption": "Assumption", "rho": "Rank correlation", "n": "Pairs",
                                 "clear": "beyond chance"}, rows, folded=True, words="The assumptions with the largest correlations")
    return Section("worlds", "Plausible worlds", [
        Text((f"All {found.dimensions} assumptions vary together over their plausible ranges (last section): a Latin hypercube of "
              f"{found.draws} draws.",)),
        holds, Figure(panels, wide=True),
        Text((f"Grey: what the largest of {found.dimensions} correlations reaches by pure chance in 95 % of cases "
              f"(±{found.noise:.2f}); a bar within it decides nothing that this number of draws could show. Ranges are themselves "
              "assumed; a share of worlds is no probability that a conclusion is true.",), "caveat"),
        deciding])


def curves(study: Study) -> Section:
    """Speed-up, time and boundary error over coverage, distance, length and number of robots."""
    if CURVES not in study.tables or len(study.methods) < 2:
        return Section("curves", "Curves", [])
    table, blocks = study.tables[CURVES], []
    blocks.append(Text((f"All else is kept; {len(table.distinct('participant'))} participants at each point, completed runs. Bands are "
                        "95 % bootstrap intervals over participants; with so few they are too narrow rather than too wide.",), "caveat"))
    for sweep in table.distinct("sweep"):
        name, axis = SWEEPS.get(sweep, (sweep.replace("_", " ").capitalize(), sweep.replace("_", " ")))
        blocks += _curve(study, table.select(sweep=sweep), sweep, name, axis)
    return Section("curves", "Curves", blocks)


def _curve(study: Study, table: Table, sweep: str, name: str, axis: str) -> List[Any]:
    rows: List[Dict[str, Any]] = []
    lines: Dict[str, List[Tuple]] = {"speedup": [], "time": [], "error": []}
    for index, scenario in enumerate(study.scenarios):
        here = table.select(scenario=scenario)
        values = sorted(here.distinct("value"), key=float)
        if not values:
            continue
        style = {"color": charts.SERIES[(index + 2) % len(charts.SERIES)], "marker": charts.MARKERS[index % len(charts.MARKERS)]}
        x, points = [float(value) for value in values], [here.select(value=value) for value in values]
        ratios = [_ratio(point, study.comparison, True) for point in points]
        label = study.scenario_title(scenario)
        lines["speedup"].append((label, x, [one.estimate for one in ratios], [one.low for one in ratios],
                                 [one.high for one in ratios], style))
        for key, column, of in (("time", "time_total_s", np.mean), ("error", "error_mean_cm", np.median)):
            for method, line in zip(study.comparison, ("-", "--")):
                samples = [point.select(method=method, completed=1).numbers(column) for point in points]
                y = [float(of(sample)) if len(sample) else math.nan for sample in samples]
                lines[key].append((f"{label}, {paper.method_title(method).lower()}", x, y, None, None, {**style, "linestyle": line}))
        rows += [{"scenario": label, "value": value, "speedup": ratio, "runs": len(point.rows),
                  "completed": int(point.numbers("completed").sum())} for value, ratio, point in zip(values, ratios, points)]
    figures = [(charts.lines(lines[key], axis, words), f"{name}: {words}") for key, words in (
        ("speedup", "speed-up"), ("time", "mean time [s]"), ("error", "mean boundary error [cm], median"))]
    columns = {"scenario": "Scenario", "value": axis, "speedup": "Speed-up", "completed": "Completed", "runs": "Runs"}
    return [Figure(figures), Grid(f"curve_{sweep}", columns, rows, folded=True, words=f"{name}: table")]


def ungated(study: Study) -> Section:
    """A random part of the runs with every image searched, beside the same runs of the study."""
    if UNGATED not in study.tables:
        return Section("ungated", "Every picture searched", [])
    table, rows = study.tables[UNGATED], []
    gated = {tuple(row[key] for key in ("participant", "scenario", "method")): row for row in study.runs.rows}
    pairs = [(row, gated[key]) for row in table.rows
             for key in [tuple(row[name] for name in ("participant", "scenario", "method"))] if key in gated]
    for column, words in (("time_total_s", "time [s]"), ("error_mean_cm", "mean boundary error [cm]"), ("jaccard", "Jaccard index"),
                          ("spots", "spots"), ("false_spots", "spots farther than 0.3 m from the true one"),
                          ("completed", "completed")):
        values = [(number(full, column), number(cut, column)) for full, cut in pairs]
        known = np.array([value for value in values if np.isfinite(value).all()]).reshape(-1, 2)
        if len(known):
            rows.append({"measure": words, "full": float(known[:, 0].mean()), "cut": float(known[:, 1].mean()), "runs": len(known),
                         "difference": statistics.hodges_lehmann(np.round(known[:, 0] - known[:, 1], 9)),
                         "largest": float(np.abs(known[:, 0] - known[:, 1]).max())})
    return Section("ungated", "Every picture searched", [
        Text((f"To save time a run renders and searches only pictures, and parts of pictures, in which the true spot can be seen, so "
              f"that false spots elsewhere cannot happen. {len(pairs)} runs, drawn at random over all scenarios and methods, were "
              "done again with every picture of every camera rendered and searched as a whole.",)),
        Grid("ungated", {"measure": "Measure", "full": "Everything searched", "cut": "As in the study", "difference": "Difference",
                         "largest": "Largest difference", "runs": "Runs"}, rows, {"difference": 3, "largest": 3}),
        Text(("Which images are left out is decided by where the true spot is; a detector that is disturbed elsewhere at that moment "
              "is not seen by the study, only by these runs.",), "caveat")])


def order(study: Study) -> Section:
    """Whether it matters which method came first (a two-period crossover), and whether people learn."""
    if "order" not in study.runs.columns or len(study.methods) != 2:
        return Section("order", "Order", [])
    rows = []
    for column, words, digits in (("time_total_s", "time [s]", 1), ("error_mean_cm", "mean boundary error [cm]", 2)):
        groups = _by_first(study, column)
        sizes = [len(group) for group in groups.values()]
        if len(groups) != 2 or min(sizes) < 2:
            continue
        first, second = (np.array(group) for group in groups.values())
        # Hills & Armitage 1979: halves of the difference tell the period, sums what is carried over
        for effect, a, b in (("period: second minus first", (second[:, 0] - second[:, 1]) / 2, (first[:, 0] - first[:, 1]) / 2),
                             ("carry-over", first.sum(axis=1), second.sum(axis=1))):
            found = statistics.unpaired(a, b)
            rows.append({"measure": words, "effect": effect, "difference": interval_text(found.shift, digits),
                         "p": statistics.format_p(found.p) if study.people else "", "groups": f"{sizes[0]} + {sizes[1]}"})
    if not rows:
        return Section("order", "Order", [])
    words = ("Half of the people began with one method, half with the other. Differences between the two groups, Hodges-Lehmann with "
             "95 % interval, means over each person's scenarios. The test of carry-over is weak: none shown is not none there.")
    if not study.people:
        words += " Simulated people neither learn nor tire: an interval without 0 would be chance or a fault."
    columns = {"measure": "Measure", "effect": "Effect", "difference": "Difference", "groups": "People"}
    return Section("order", "Order", [Text((words,), "caveat"),
                                      Grid("order", {**columns, "p": "p (Mann-Whitney)"} if study.people else columns, rows)])


def _by_first(study: Study, column: str) -> Dict[str, List[Tuple[float, float]]]:
    """(mean with the first method, mean with the baseline) of each person, by the method that came first."""
    groups: Dict[str, List[Tuple[float, float]]] = {method: [] for method in study.comparison}
    for person in study.runs.distinct("participant"):
        own = study.runs.select(participant=person)
        known = [row for row in own.rows if math.isfinite(number(row, "order"))]
        means = tuple(_mean(own.select(method=method).numbers(column)) for method in study.comparison)
        if known and all(len(own.select(method=method).numbers(column)) for method in study.comparison):
            groups[min(known, key=lambda row: number(row, "order"))["method"]].append(means)  # type: ignore[arg-type]
    return {method: group for method, group in groups.items() if group}


def experience(study: Study) -> Section:
    """Who took part and what they answered; empty for simulated people."""
    path, about = study.folder / "questionnaire.csv", study.folder / "demographics.csv"
    blocks: List[Any] = []
    if study.people and about.is_file():
        table = read_table(about, ("participant",))
        counted = [{"question": column, "answers": "; ".join(
            f"{value}: {len(table.select(**{column: value}).rows)}" for value in sorted(table.distinct(column)))}
            for column in table.columns if column != "participant"]
        blocks.append(Grid("demographics", {"question": "Question", "answers": f"Answers of {len(table.rows)} people"}, counted))
    if not study.people or not path.is_file():
        return Section("experience", "People and their experience", blocks)
    rows = []
    for entry in questionnaire.table(questionnaire.read(path)):
        rows.append({"statement": entry["text"], "nrs": entry["mean_nrs"], "robot_only": entry["mean_robot_only"],
                     "shift": Interval(entry["shift"], entry["shift_low"], entry["shift_high"], 0.95),
                     "p": statistics.format_p(entry["p_exact"]), "n": entry["n"]})
    columns = {"statement": "Statement", "nrs": "Network robot system", "robot_only": "Robot only", "shift": "Difference",
               "p": "exact p", "n": "People"}
    return Section("experience", "People and their experience", [
        *blocks, Text(("The paper's five statements (1 to 5, 5 is the good end) and the UEQ-S (−3 to 3): means, Hodges-Lehmann difference, "
              "Wilcoxon signed-rank test.",)), Grid("questionnaire", columns, rows)])


def assumptions(study: Study) -> Section:
    """Everything that was put in, with where it comes from."""
    entries = study.meta.get("assumptions") or []
    blocks: List[Any] = []
    if study.meta.get("caveats"):
        blocks.append(Text(tuple(study.meta["caveats"]), "list"))
    if entries:
        counts = {source: sum(entry["source"] == source for entry in entries) for source in ("paper", "data", "literature", "assumed")}
        blocks += [Text((f"{len(entries)} figures: " + ", ".join(f"{count} {source}" for source, count in counts.items()) + ".",)),
                   Grid("assumptions", {"key": "Figure", "value": "Value", "unit": "Unit", "range": "Plausible range",
                                        "source": "Source", "why": "Where from"}, entries, folded=True, words="Every figure")]
    return Section("assumptions", "What was assumed, and where the simulation is too kind", blocks)


def runs(study: Study) -> Section:
    """Every row."""
    rows = [{**row, "line": line} for row, line in zip(study.runs.rows, study.runs.lines)]
    blocks: List[Any] = []
    if study.meta.get("rerun"):
        blocks.append(Text((f"A row again, alone, with its own columns in place of the names in braces: {study.meta['rerun']}",)))
    blocks.append(Grid("runs", {column: column for column in study.runs.columns}, rows, folded=True, words="All runs"))
    return Section("runs", "Every run", blocks)


# ------------------------------------------------------------------ numbers
def _mean(values: np.ndarray) -> float:
    return float(values.mean()) if len(values) else math.nan


def _scaled(value: Interval, factor: float) -> Interval:
    return Interval(value.estimate * factor, value.low * factor, value.high * factor, value.confidence)


def _shift(table: Table, column: str, methods: Tuple[str, str], completed: bool = False) -> Interval:
    first, second = table.pairs(column, methods, completed)
    # 0.3 - 0.1 and 0.4 - 0.2 are a tie that floating point does not see
    found = statistics.hodges_lehmann(np.round(first - second, 9))
    return found if found.confidence >= 0.9 else Interval(found.estimate, math.nan, math.nan, math.nan)


def _ratio(table: Table, methods: Tuple[str, str], completed: bool = False) -> Interval:
    """Speed-up of the first method."""
    first, second = table.pairs("time_total_s", methods, completed)
    return statistics.ratio_of_means(second, first)


def _mean_difference(table: Table, column: str, methods: Tuple[str, str]) -> Interval:
    first, second = table.pairs(column, methods)
    return statistics.mean(first - second)


def _completed_difference(table: Table, methods: Tuple[str, str]) -> Interval:
    """Percentage points between the success rates."""
    first, second = table.pairs("completed", methods)
    return _scaled(statistics.mean(first - second), 100.0)


def _test_blocks(study: Study, column: str, unit: str, completed: bool) -> List[Any]:
    """The paper's Wilcoxon test; of people only."""
    if not study.people or len(study.methods) < 2:
        return []
    rows = []
    for scenario in study.scenarios:
        first, second = study.runs.select(scenario=scenario).pairs(column, study.comparison, completed)
        if len(first):
            found = statistics.compare(first, second)
            rows.append({"scenario": study.scenario_title(scenario), "n": found.n, "z": found.test.z,
                         "p": statistics.format_p(found.test.p_exact), "r": found.r, "rank_biserial": found.rank_biserial,
                         "shift": found.shift})
    columns = {"scenario": "Scenario", "n": "Pairs", "z": "Z", "p": "exact p", "r": "r", "rank_biserial": "rank-biserial",
               "shift": f"Difference {f'[{unit}]' if unit else ''}"}
    return [Grid(f"test_{column}", columns, rows, {"z": 3, "shift": 3}, words=(
        "Wilcoxon signed-rank test: Z as SPSS gives it (zero differences left out, ties corrected, no continuity correction), exact "
        "p over all signs, r = |Z| / √(2 × pairs), Hodges-Lehmann difference."))] if rows else []


def _map_words(study: Study, entry: maps.MapPicture) -> str:
    scenario = study.scenario_title(entry.scenario)
    if not entry.line:
        return f"{scenario}: ground truth"
    return f"{scenario}: {paper.method_title(entry.method).lower()}, Jaccard {entry.jaccard:.3f}, line {entry.line}"
