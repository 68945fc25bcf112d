"""Statistics against published worked examples, and against the paper's own results."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy import stats

from vb_evaluation import statistics
from vb_evaluation.report.comparisons import tabulate_tests

# Field (2009), Discovering Statistics Using SPSS, 3rd ed., Sect. 15.4: depression on Sunday and on Wednesday
ECSTASY = ([15, 35, 16, 18, 19, 17, 27, 16, 13, 20], [28, 35, 35, 24, 39, 32, 27, 29, 36, 35])
ALCOHOL = ([16, 15, 20, 15, 16, 13, 14, 19, 18, 18], [5, 6, 30, 8, 9, 7, 6, 17, 3, 10])
# depression in Hollander & Wolfe (1973), Nonparametric Statistical Methods, Table 3.1, and in R's ?wilcox.test
FIRST_VISIT = [1.83, 0.50, 1.62, 2.48, 1.68, 1.88, 1.55, 3.06, 1.30]
SECOND_VISIT = [0.878, 0.647, 0.598, 2.05, 1.06, 1.29, 1.06, 3.14, 1.29]


@pytest.mark.parametrize(
    "sunday_wednesday, sums, z, r",
    # two differences of ECSTASY are zero and are left out
    [(ECSTASY, (0.0, 36.0), -2.53, 0.57), (ALCOHOL, (47.0, 8.0), -1.99, 0.44)],
)
def test_the_signed_rank_test_is_that_of_fields_textbook(sunday_wednesday, sums, z, r):
    differences = statistics.paired_differences(*sunday_wednesday)
    test = statistics.signed_rank_test(differences)
    assert (test.w_plus, test.w_minus) == sums
    assert round(test.z, 2) == z
    (row,) = tabulate_tests([{}], [differences])
    assert float(row["r"]) == pytest.approx(r, abs=0.0101)  # the book divides the rounded Z


def test_exact_p_estimate_and_interval_are_hollander_and_wolfes():
    differences = statistics.paired_differences(SECOND_VISIT, FIRST_VISIT)
    test = statistics.signed_rank_test(differences)
    assert (test.w_plus, test.w_minus) == (5.0, 40.0)
    assert test.p == 2 * 0.01953125  # R: V = 40, one-sided p = 0.01953
    # of confidence .961
    assert statistics.hodges_lehmann(differences, confidence=0.96) == pytest.approx((-0.46, -0.786, -0.010))
    assert statistics.hodges_lehmann(differences, confidence=0.962) != pytest.approx((-0.46, -0.786, -0.010))


@pytest.mark.parametrize(
    "ties, z",
    # Sect. 5.8.1: all 15 participants were faster, and the three Z differ only by ties of times in whole seconds
    [((), -3.408), ((2, 2), -3.409), ((3,), -3.411)],
)
def test_the_papers_z_of_the_interaction_times(ties, z):
    differences = -np.arange(1.0, 16.0)
    start = 0
    for size in ties:
        differences[start : start + size] = differences[start]
        start += size + 1
    test = statistics.signed_rank_test(differences)
    assert round(test.z, 3) == z
    assert test.p == 2.0**-14


@pytest.mark.parametrize("positive_ranks, z, p", [((1, 11, 12, 13), -0.594, ".588"), ((1,), -3.110, "< .001")])
def test_paper_accuracy_is_an_exact_test_of_13_pairs(positive_ranks, z, p):
    # Sect. 5.8.4: Z and p agree for an exact test of 13 pairs, those with both runs completed (93.3 % each)
    differences = np.array([rank if rank in positive_ranks else -rank for rank in range(1, 14)], float)
    test = statistics.signed_rank_test(differences)
    assert round(test.z, 3) == z
    assert statistics.format_p(test.p) == p


def ranks_of(values):
    """Returns the mean ranks of the magnitudes, and the sum of the positive values' ranks for each choice of signs."""
    sizes = np.abs(values)
    ranks = np.array([(sizes < size).sum() + ((sizes == size).sum() + 1) / 2 for size in sizes])
    choices = itertools.product((0, 1), repeat=len(ranks))
    return ranks, np.array([sum(itertools.compress(ranks, signs)) for signs in choices])


@settings(max_examples=60, deadline=None)
@given(st.lists(st.integers(-6, 6), min_size=1, max_size=9))
def test_exact_p_is_the_share_of_all_signs(values):
    test = statistics.signed_rank_test(np.array(values, float))
    ranked = np.array([value for value in values if value])
    if len(ranked) == 0:
        assert test.p == 1.0
        assert math.isnan(test.z)
        return
    ranks, sums = ranks_of(ranked)
    assert test.p == pytest.approx(min(1.0, 2 * np.mean(sums <= min(test.w_plus, test.w_minus) + 1e-9)))
    assert test.z <= 1e-12
    assert test.w_plus + test.w_minus == pytest.approx(ranks.sum())


@settings(max_examples=60, deadline=None)
@given(st.lists(st.integers(-40, 40), min_size=2, max_size=10, unique=True), st.sampled_from([0.6, 0.8, 0.9, 0.95]))
def test_the_interval_is_what_the_test_does_not_reject(values, confidence):
    """There is none where there are too few values for the requested confidence."""
    interval = statistics.hodges_lehmann(np.array(values, float), confidence)
    if 2.0 ** (1 - len(values)) > 1 - confidence:
        assert math.isnan(interval.low)
        return
    means = [(a + b) / 2 for a, b in itertools.combinations_with_replacement(values, 2)]
    assert interval.estimate == np.median(means)
    assert {interval.low, interval.high} <= set(means)
    for limit, outward in ((interval.low, -1e-6), (interval.high, 1e-6)):
        inside = statistics.signed_rank_test(np.array(values) - limit + outward).p
        outside = statistics.signed_rank_test(np.array(values) - limit - outward).p
        assert outside <= 1 - confidence + 1e-9
        assert inside > 1 - confidence + 1e-9


@pytest.mark.parametrize(
    "values, text",
    [((2.411, 2.1, 2.8), "2.41 [2.10, 2.80]"), ((2.411, math.nan, math.nan), "2.41 [?]"), ((math.nan,) * 3, "–")],
)
def test_an_interval_is_written_with_what_is_known_of_it(values, text):
    assert statistics.Interval(*values).text(2) == text


def test_a_comparison_of_few_participants_claims_no_more_than_they_show():
    assert statistics.hodges_lehmann([2.0, 3.0, 4.0]).text(0) == "3 [?]"
    assert statistics.signed_rank_test([2.0, 3.0, 4.0]).p == 0.25
    assert statistics.signed_rank_test([1.0]).p == 1.0
    assert statistics.signed_rank_test([]).p == 1.0
    assert math.isnan(statistics.hodges_lehmann([]).estimate)
    assert tabulate_tests([{}], [[]]) == []
    # ties hidden by floating-point error
    assert list(statistics.paired_differences([0.3, 0.4, 0.0], [0.1, 0.2, 0.1])) == [0.2, 0.2, -0.1]
    equal = statistics.signed_rank_test([0.0, 0.0])
    assert equal.p == 1.0
    assert math.isnan(equal.z)


def test_bootstrap_intervals_are_scipys_and_repeat_exactly():
    slow, fast = np.array([52.0, 61, 48, 75, 66, 58]), np.array([21.0, 25, 22, 30, 24, 26])
    ratio = statistics.ratio_of_means(slow, fast)
    assert ratio.estimate == pytest.approx(slow.mean() / fast.mean())
    assert ratio.low < ratio.estimate < ratio.high
    assert ratio == statistics.ratio_of_means(slow, fast)
    assert statistics.ratio_of_means(np.ones(4), np.ones(4)) == (1.0, 1.0, 1.0)
    assert statistics.median([1.0, 2.0, 9.0]).estimate == 2.0
    for method, expected in (("BCa", statistics.mean(slow)), ("percentile", statistics.median(slow))):
        statistic = np.mean if method == "BCa" else np.median
        theirs = stats.bootstrap((slow,), statistic, n_resamples=4999, method=method, random_state=0)
        assert (expected.low, expected.high) == theirs.confidence_interval
    alone = statistics.median([1.0])
    assert alone.estimate == 1.0
    assert math.isnan(alone.low)
    assert math.isnan(statistics.median([]).estimate)


def test_a_difference_of_two_proportions_has_newcombes_interval():
    # Newcombe (1998), Statistics in Medicine 17, 873-890, Table II, method 10: 56 of 70 and 48 of 80, 98 of 98 and none
    def shares(a, n, b, m, **options):
        return statistics.difference_of_proportions(np.arange(n) < a, np.arange(m) < b, **options)

    difference = shares(56, 70, 48, 80)
    assert difference.estimate == pytest.approx(0.2)
    assert (round(difference.low, 4), round(difference.high, 4)) == (0.0524, 0.3339)
    few = shares(8, 8, 8, 8, confidence=0.9)
    assert few.estimate == 0.0
    assert few.low == pytest.approx(-few.high)
    assert few.high > 0.2  # the proportions may still differ
    assert math.isnan(shares(0, 0, 1, 1).estimate)


def test_a_success_rate_has_newcombes_interval():
    assert math.isnan(statistics.proportion(0, 0).estimate)
    # Newcombe (1998), Statistics in Medicine 17, Table I, method 3: 15 of 148
    interval = statistics.proportion(15, 148)
    assert (round(interval.low, 4), round(interval.high, 4)) == (0.0624, 0.1605)


@pytest.mark.parametrize("p, text", [(0.0004, "< .001"), (0.001, ".001"), (0.0164, ".016"), (1.0, "1"), (0.9996, "1")])
def test_p_is_written_as_in_the_paper(p, text):
    assert statistics.format_p(p) == text
