"""Computes the paper's statistics of paired measurements (Sect. 5.8), with effect sizes and intervals beside p.

The Wilcoxon signed-rank test is reported as in SPSS and the paper. Zero differences are dropped, and ties share
their mean rank and shrink the variance. Z has no continuity correction and is never above 0.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from typing import Callable, Sequence

import numpy as np
from scipy import stats

from vb_core.errors import CodedError

CONFIDENCE = 0.95
RESAMPLES = 4999
ALPHA, POWER = 0.05, 0.8


@dataclass(frozen=True)
class Interval:
    """An estimate with its confidence interval. `confidence` is the level reached, 0 .. 1."""

    estimate: float
    low: float = math.nan
    high: float = math.nan
    confidence: float = math.nan

    def scaled(self, factor: float) -> "Interval":
        """Returns the interval times a factor: in another unit, or with the opposite sign."""
        low, high = sorted((self.low * factor, self.high * factor))
        return Interval(self.estimate * factor, low, high, self.confidence)

    def text(self, digits: int) -> str:
        """Writes "2.41 [2.10, 2.80]"; "2.41 [?]" without limits, a dash where nothing is known."""
        estimate, low, high = (format_number(value, digits) for value in (self.estimate, self.low, self.high))
        if math.isnan(self.estimate):
            return estimate
        return f"{estimate} [?]" if math.isnan(self.low) else f"{estimate} [{low}, {high}]"


UNKNOWN_INTERVAL = Interval(math.nan)


@dataclass(frozen=True)
class SignedRankTest:
    """Wilcoxon signed-rank test of paired differences, two-sided, with effect sizes.

    Attributes:
        n: pairs.
        w_plus, w_minus: sums of the ranks of positive and of negative differences; those of zero are dropped.
        z: z value of the smaller sum, at most 0; nan if nothing can be ranked.
        p_exact: p by the distribution of all 2^n signs, ties included ("Exact Sig.").
        r: effect size |Z| / sqrt(number of observations), two per pair (Rosenthal 1991; Field 2009, Sect. 15.4).
        rank_biserial: (W+ - W-) / (W+ + W-), -1 .. 1 (Kerby 2014).
        shift: Hodges-Lehmann estimate of the difference with its interval.
    """

    n: int
    w_plus: float
    w_minus: float
    z: float
    p_exact: float
    r: float
    rank_biserial: float
    shift: Interval


def paired_differences(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Subtracts the second of two paired samples (N,) from the first, without the noise that would hide ties.

    Raises:
        CodedError: "bad_sample" if they are not pairs of finite numbers.
    """
    first = _sample(first)
    second = _sample(second)
    if len(first) != len(second):
        raise CodedError("bad_sample", f"paired samples have the same length, got {len(first)} and {len(second)}")
    # 0.3 - 0.1 and 0.4 - 0.2 are a tie that floating point does not see
    return np.round(first - second, 9)


def signed_rank_test(differences: np.ndarray) -> SignedRankTest:
    """Tests paired differences (N,). Equal ones must be equal to the last bit to be ties."""
    differences = _sample(differences)
    n = len(differences)
    ranks = _signed_ranks(differences)
    w_plus = float(ranks[ranks > 0].sum())
    w_minus = float(-ranks[ranks < 0].sum())
    z = p_exact = rank_biserial = math.nan
    if len(ranks):
        # under random signs the sum of signed ranks has mean 0 and variance sum(ranks^2), ties included
        z = -abs(w_plus - w_minus) / math.sqrt(float(np.sum(ranks**2)))
        rank_biserial = (w_plus - w_minus) / (w_plus + w_minus)
    if n:
        larger_sums = ranks if w_plus >= w_minus else -ranks
        p_exact = min(1.0, 2.0 * _tail_probability(larger_sums))  # of all signs that are as one-sided, either way
    r = abs(z) / math.sqrt(2 * n) if n else math.nan
    return SignedRankTest(n, w_plus, w_minus, z, p_exact, r, rank_biserial, hodges_lehmann(differences))


def hodges_lehmann(differences: np.ndarray, confidence: float = CONFIDENCE) -> Interval:
    """Computes the median of all pairwise means of differences (N,), with the Wilcoxon test's interval.

    The interval is distribution-free (Hollander, Wolfe & Chicken 2014, Sect. 3.3). There is none where the widest does not
    reach the confidence: five differences reach 93.75 % at most.
    """
    differences = _sample(differences)
    n = len(differences)
    if n == 0:
        return UNKNOWN_INTERVAL
    rows, columns = np.triu_indices(n)
    means = np.sort((differences[rows] + differences[columns]) / 2.0)
    # P(W+ <= 0, 1, 2, ...); without ties every sum is a whole number
    cumulative = np.cumsum(_rank_sum_distribution(np.arange(1.0, n + 1)))[::2]
    # cuts off as many of the smallest means as the confidence allows
    tail = (1.0 - confidence) / 2.0
    cut = int(np.searchsorted(cumulative, tail, side="right")) - 1
    if cut < 0:
        return Interval(float(np.median(means)))
    reached = 1.0 - 2.0 * float(cumulative[cut])
    return Interval(float(np.median(means)), float(means[cut]), float(means[-1 - cut]), reached)


def noninferiority_p(gains: np.ndarray, margin: float) -> float:
    """Computes the one-sided exact Wilcoxon p of "the first method is worse by the margin or more".

    The two one-sided tests for equivalence (Schuirmann 1987) are this test of the gains and of their negatives.

    Args:
        gains: (N,) paired differences, larger is better.
        margin: > 0, in the same unit.
    """
    ranks = _signed_ranks(np.round(_sample(gains) + margin, 9))
    return _tail_probability(ranks) if len(ranks) else math.nan


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
    """Computes a statistic of one sample, or of paired ones, with a reproducible bootstrap interval.

    Args:
        statistic: takes the samples and `axis`.
        method: "BCa", or "percentile", which BCa falls back on where all resamples agree.
    """
    values = [_sample(sample) for sample in samples]
    if len({len(sample) for sample in values}) != 1:
        raise CodedError("bad_sample", "paired samples have the same length")
    if len(values[0]) == 0:
        return UNKNOWN_INTERVAL
    estimate = float(statistic(*values))
    if len(values[0]) == 1:
        return Interval(estimate)
    options = {"n_resamples": RESAMPLES, "confidence_level": CONFIDENCE, "random_state": 0}
    for name in (method, "percentile"):
        with warnings.catch_warnings(), np.errstate(invalid="ignore", divide="ignore"):
            warnings.simplefilter("ignore")
            result = stats.bootstrap(values, statistic, method=name, paired=True, vectorized=True, **options)
        low, high = map(float, result.confidence_interval)
        if math.isfinite(low + high):
            break
    return Interval(estimate, low, high, CONFIDENCE)


def holm(ps: Sequence[float]) -> np.ndarray:
    """Corrects the p of one family of tests by Holm's method, (N,). Unknown ones stay unknown and do not count."""
    # statsmodels takes a second to import, and a simulation does not need it
    from statsmodels.stats.multitest import multipletests

    corrected = np.array(ps, dtype=float)
    is_known = np.isfinite(corrected)
    if is_known.any():
        corrected[is_known] = multipletests(corrected[is_known], ALPHA, "holm")[1]
    return corrected


def required_sample_size(effect: float, tests: int = 1) -> int:
    """Computes how many pairs a two-sided Wilcoxon test needs for a power of 80 %.

    It is the t test's number divided by 3 / pi, the signed-rank test's efficiency for normal differences.

    Args:
        effect: mean difference over the differences' standard deviation (Cohen's d_z), > 0.
        tests: number of tests in the family; the strictest level of Holm's method is used.
    """
    from statsmodels.stats.power import TTestPower

    pairs = TTestPower().solve_power(effect_size=effect, alpha=ALPHA / tests, power=POWER)
    return int(math.ceil(float(pairs) * math.pi / 3.0))


def proportion(successes: int, n: int, confidence: float = CONFIDENCE) -> Interval:
    """Computes a success rate, 0 .. 1, with Wilson's interval."""
    if n == 0:
        return UNKNOWN_INTERVAL
    limits = stats.binomtest(int(successes), int(n)).proportion_ci(confidence, method="wilson")
    return Interval(successes / n, float(limits.low), float(limits.high), confidence)


def percentage(flags: np.ndarray) -> Interval:
    """Computes the share of ones among flags (N,) of 0 and 1 [%], with Wilson's interval."""
    return proportion(flags.sum(), len(flags)).scaled(100.0)


def difference_of_proportions(first: np.ndarray, second: np.ndarray, confidence: float = CONFIDENCE) -> Interval:
    """Computes the first sample's share of ones minus the second's, (N,) and (M,) of 0 and 1, with Newcombe's interval.

    All values count as independent: the interval is too wide for pairs, and too narrow for several runs of a person who
    fails more than once. Unlike a bootstrap, it allows for events that none of a few people had.
    """
    a = proportion(first.sum(), len(first), confidence)
    b = proportion(second.sum(), len(second), confidence)
    difference = a.estimate - b.estimate
    # Newcombe (1998), method 10: from the distances to the limits of Wilson's intervals
    below = math.hypot(a.estimate - a.low, b.high - b.estimate)
    above = math.hypot(a.high - a.estimate, b.estimate - b.low)
    low = difference - below
    high = difference + above
    return Interval(difference, low, high, confidence)


def format_number(value: float, digits: int, sign: str = "-") -> str:
    """Writes a number as the report shows it, or a dash for what is unknown. With the sign "+", also positive ones have one."""
    return "–" if math.isnan(value) else f"{value:{sign}.{digits}f}".replace("-", "\N{MINUS SIGN}")


def format_p(p: float) -> str:
    """Writes p as the paper does: "< .001", ".016", "1"."""
    if not math.isfinite(p):
        return "–"
    if p < 0.001:
        return "< .001"
    return f"{p:.3f}".lstrip("0") if p < 0.9995 else "1"


def _signed_ranks(differences: np.ndarray) -> np.ndarray:
    """Ranks the magnitudes of the differences (N,) that are not zero, and gives the ranks their signs."""
    ranked = differences[differences != 0.0]
    return np.sign(ranked) * stats.rankdata(np.abs(ranked))


def _tail_probability(signed_ranks: np.ndarray) -> float:
    """Computes the probability that random signs make the positive ranks' sum at least as large as it is."""
    doubled_sum = int(round(2 * signed_ranks[signed_ranks > 0].sum()))
    return float(_rank_sum_distribution(np.abs(signed_ranks))[doubled_sum:].sum())


def _rank_sum_distribution(ranks: np.ndarray) -> np.ndarray:
    """Computes the probability of each sum 0, 1/2, 1, ... of those ranks (N,) whose random sign is plus."""
    pmf = np.ones(1)
    for doubled in np.round(2.0 * ranks).astype(int):
        # the convolution with the two equally likely summands 0 and the rank
        pmf = 0.5 * (np.pad(pmf, (0, doubled)) + np.pad(pmf, (doubled, 0)))
    return pmf


def _sample(values: np.ndarray) -> np.ndarray:
    """Checks a sample and returns it as (N,) float64, all finite."""
    sample = np.asarray(values, dtype=float)
    if sample.ndim != 1 or not np.isfinite(sample).all():
        raise CodedError("bad_sample", "a sample is a list of finite numbers: leave out runs without a value")
    return sample
