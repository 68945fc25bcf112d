"""Computes the paper's statistics of paired measurements (Sect. 5.8), with effect sizes and intervals beside p.

The Wilcoxon signed-rank test is reported as in SPSS and the paper. Zero differences are dropped, and ties share
their mean rank and shrink the variance. Z has no continuity correction and is never above 0. Samples are finite numbers.
"""

from __future__ import annotations

import math
import warnings
from typing import Callable, NamedTuple

import numpy as np
from scipy import stats

CONFIDENCE = 0.95
RESAMPLES = 4999


class Interval(NamedTuple):
    """An estimate with the limits of its confidence interval; nan for what is unknown."""

    estimate: float = math.nan
    low: float = math.nan
    high: float = math.nan

    def scaled(self, factor: float) -> "Interval":
        """Returns the interval in another unit: times a factor > 0."""
        return Interval(*(value * factor for value in self))

    def text(self, digits: int) -> str:
        """Writes "2.41 [2.10, 2.80]"; "2.41 [?]" without limits, a dash where nothing is known."""
        estimate, low, high = (format_number(value, digits) for value in self)
        if math.isnan(self.estimate):
            return estimate
        return f"{estimate} [?]" if math.isnan(self.low) else f"{estimate} [{low}, {high}]"


class SignedRankTest(NamedTuple):
    """Wilcoxon signed-rank test of paired differences, two-sided.

    Attributes:
        w_plus, w_minus: sums of the ranks of positive and of negative differences; those of zero are dropped.
        z: z value of the smaller sum, at most 0; nan if nothing can be ranked.
        p: by the distribution of all signs, ties included ("Exact Sig."); 1 if nothing can be ranked.
    """

    w_plus: float
    w_minus: float
    z: float
    p: float


def paired_differences(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Subtracts the second of two paired samples (N,) from the first, without the noise that would hide ties."""
    # 0.3 - 0.1 and 0.4 - 0.2 are a tie that floating point does not see
    return np.round(np.subtract(first, second), 9)


def signed_rank_test(differences: np.ndarray) -> SignedRankTest:
    """Tests paired differences (N,). Equal ones must be equal to the last bit to be ties."""
    differences = np.asarray(differences, dtype=float)
    ranked = differences[differences != 0.0]
    ranks = stats.rankdata(np.abs(ranked))
    w_plus = float(ranks[ranked > 0].sum())
    w_minus = float(ranks[ranked < 0].sum())
    # under random signs the sum of signed ranks has mean 0 and variance sum(ranks^2), ties included
    z = -abs(w_plus - w_minus) / math.sqrt(float(np.sum(ranks**2))) if len(ranks) else math.nan
    doubled_sum = int(round(2 * max(w_plus, w_minus)))
    tail = float(_rank_sum_distribution(ranks)[doubled_sum:].sum())
    return SignedRankTest(w_plus, w_minus, z, min(1.0, 2.0 * tail))  # of all signs that are as one-sided, either way


def hodges_lehmann(differences: np.ndarray, confidence: float = CONFIDENCE) -> Interval:
    """Computes the median of all pairwise means of differences (N,), with the Wilcoxon test's interval.

    The interval is distribution-free (Hollander, Wolfe & Chicken 2014, Sect. 3.3). There is none where the widest does not
    reach the confidence: five differences reach 93.75 % at most.
    """
    differences = np.asarray(differences, dtype=float)
    n = len(differences)
    if n == 0:
        return Interval()
    rows, columns = np.triu_indices(n)
    means = np.sort((differences[rows] + differences[columns]) / 2.0)
    estimate = float(np.median(means))
    # P(W+ <= 0, 1, 2, ...); without ties every sum is a whole number
    cumulative = np.cumsum(_rank_sum_distribution(np.arange(1.0, n + 1)))[::2]
    # cuts off as many of the smallest means as the confidence allows
    cut = int(np.searchsorted(cumulative, (1.0 - confidence) / 2.0, side="right")) - 1
    return Interval(estimate) if cut < 0 else Interval(estimate, float(means[cut]), float(means[-1 - cut]))


def ratio_of_means(numerator: np.ndarray, denominator: np.ndarray) -> Interval:
    """Computes the ratio of the means of two paired samples (N,), for instance a speed-up, with a bootstrap interval."""
    return bootstrap(lambda a, b, axis=-1: np.mean(a, axis=axis) / np.mean(b, axis=axis), numerator, denominator)


def median(values: np.ndarray) -> Interval:
    """Computes the median of values (N,) with a bootstrap interval."""
    return bootstrap(np.median, values, method="percentile")


def mean(values: np.ndarray) -> Interval:
    """Computes the mean of values (N,) with a bootstrap interval."""
    return bootstrap(np.mean, values)


def bootstrap(statistic: Callable[..., np.ndarray], *samples: np.ndarray, method: str = "BCa") -> Interval:
    """Computes a statistic of one sample (N,), or of paired ones, with a reproducible bootstrap interval.

    Args:
        statistic: takes the samples and `axis`.
        method: "BCa" or "percentile".
    """
    n = len(samples[0])
    estimate = float(statistic(*samples)) if n else math.nan
    if n < 2:
        return Interval(estimate)
    options = {"n_resamples": RESAMPLES, "confidence_level": CONFIDENCE, "random_state": 0}
    with warnings.catch_warnings(), np.errstate(invalid="ignore", divide="ignore"):
        warnings.simplefilter("ignore")
        result = stats.bootstrap(samples, statistic, method=method, paired=True, vectorized=True, **options)
    low, high = map(float, result.confidence_interval)
    # BCa corrects by the resamples' spread, and has no limits where all of them agree
    return Interval(estimate, estimate, estimate) if math.isnan(low) else Interval(estimate, low, high)


def proportion(successes: int, n: int) -> Interval:
    """Computes a success rate, 0 .. 1, with Wilson's interval."""
    if n == 0:
        return Interval()
    limits = stats.binomtest(int(successes), int(n)).proportion_ci(CONFIDENCE, method="wilson")
    return Interval(successes / n, float(limits.low), float(limits.high))


def percentage(flags: np.ndarray) -> Interval:
    """Computes the share of ones among flags (N,) of 0 and 1 [%], with Wilson's interval."""
    return proportion(flags.sum(), len(flags)).scaled(100.0)


def difference_of_proportions(first: np.ndarray, second: np.ndarray, confidence: float = CONFIDENCE) -> Interval:
    """Computes the first sample's share of ones minus the second's, (N,) and (M,) of 0 and 1, with Newcombe's interval.

    All values count as independent: the interval is too wide for pairs, and too narrow for several runs of a person who
    fails more than once. Unlike a bootstrap, it allows for events that none of a few people had.
    """
    # statsmodels takes a second to import, and a simulation does not need it
    from statsmodels.stats.proportion import confint_proportions_2indep

    if not len(first) or not len(second):
        return Interval()
    counts = (first.sum(), len(first), second.sum(), len(second))
    low, high = confint_proportions_2indep(*counts, method="newcomb", compare="diff", alpha=1.0 - confidence)
    return Interval(first.mean() - second.mean(), float(low), float(high))


def format_number(value: float, digits: int, sign: str = "-") -> str:
    """Writes a number as the report shows it, or a dash for what is unknown. With the sign "+", also positive ones have one."""
    return "–" if math.isnan(value) else f"{value:{sign}.{digits}f}".replace("-", "\N{MINUS SIGN}")


def format_p(p: float) -> str:
    """Writes p as the paper does: "< .001", ".016", "1"."""
    if p < 0.001:
        return "< .001"
    return f"{p:.3f}".lstrip("0") if p < 0.9995 else "1"


def _rank_sum_distribution(ranks: np.ndarray) -> np.ndarray:
    """Computes the probability of each sum 0, 1/2, 1, ... of those ranks (N,) whose random sign is plus."""
    pmf = np.ones(1)
    for doubled in np.round(2.0 * ranks).astype(int):
        # the convolution with the two equally likely summands 0 and the rank
        pmf = 0.5 * (np.pad(pmf, (0, doubled)) + np.pad(pmf, (doubled, 0)))
    return pmf
