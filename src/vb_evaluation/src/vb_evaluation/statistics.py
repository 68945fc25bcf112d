"""Computes the paper's statistics of paired measurements (Sect. 5.8), with effect sizes and intervals beside p.

The Wilcoxon signed-rank test is reported as in SPSS and the paper. Zero differences are dropped, and ties share
their mean rank and shrink the variance. Z has no continuity correction and is never above 0.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from typing import Callable, Dict, Sequence

import numpy as np
from scipy import stats

from vb_core.errors import CodedError

CONFIDENCE = 0.95
RESAMPLES = 4999
ALPHA, POWER = 0.05, 0.8


@dataclass(frozen=True)
class SignedRank:
    """Wilcoxon signed-rank test of paired differences, two-sided.

    Attributes:
        w_plus, w_minus: sums of the ranks of positive and of negative differences; those of zero are dropped.
        z: z value of the smaller sum, at most 0; nan if nothing can be ranked.
        p_exact: p by the distribution of all 2^n signs, ties included ("Exact Sig.").
    """

    w_plus: float
    w_minus: float
    z: float
    p_exact: float


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
class PairedComparison:
    """All statistics of two paired samples. Differences are first minus second.

    Attributes:
        n: pairs.
        test: Wilcoxon.
        r: effect size |Z| / sqrt(number of observations), two per pair (Rosenthal 1991; Field 2009, Sect. 15.4).
        rank_biserial: (W+ - W-) / (W+ + W-), -1 .. 1 (Kerby 2014).
        shift: Hodges-Lehmann estimate of the difference with its interval.
    """

    n: int
    test: SignedRank
    r: float
    rank_biserial: float
    shift: Interval


def compare_paired(first: np.ndarray, second: np.ndarray, confidence: float = CONFIDENCE) -> PairedComparison:
    """Compares two paired samples (N,) by the paper's statistics and further ones.

    Raises:
        CodedError: "bad_sample" if they are not pairs of finite numbers.
    """
    first, second = (_sample(values) for values in (first, second))
    if len(first) != len(second):
        raise CodedError("bad_sample", f"paired samples have the same length, got {len(first)} and {len(second)}")
    # 0.3 - 0.1 and 0.4 - 0.2 are a tie that floating point does not see
    differences = np.round(first - second, 9)
    test = signed_rank(differences)
    ranks = test.w_plus + test.w_minus
    return PairedComparison(
        n=len(differences),
        test=test,
        r=abs(test.z) / math.sqrt(2 * len(differences)) if len(differences) else math.nan,
        rank_biserial=(test.w_plus - test.w_minus) / ranks if ranks else math.nan,
        shift=hodges_lehmann(differences, confidence),
    )


def signed_rank(differences: np.ndarray) -> SignedRank:
    """Tests differences (N,) by Wilcoxon's signed ranks. Equal ones must be equal to the last bit to be ties."""
    differences = _sample(differences)
    ranked = differences[differences != 0.0]
    if not len(ranked):
        return SignedRank(0.0, 0.0, math.nan, 1.0 if len(differences) else math.nan)
    ranks = stats.rankdata(np.abs(ranked))
    w_plus, w_minus = float(ranks[ranked > 0].sum()), float(ranks[ranked < 0].sum())
    with warnings.catch_warnings():
        # SciPy warns that the normal approximation is poor for n < 10, but the exact p is reported too
        warnings.simplefilter("ignore", UserWarning)
        approximation = stats.wilcoxon(ranked, zero_method="wilcox", correction=False, mode="approx")
    tail = _distribution(ranks)[: int(round(2 * min(w_plus, w_minus))) + 1].sum()
    p_exact = min(1.0, 2.0 * float(tail))
    return SignedRank(w_plus, w_minus, float(approximation.zstatistic), p_exact)


def hodges_lehmann(differences: np.ndarray, confidence: float = CONFIDENCE) -> Interval:
    """Computes the median of all pairwise means of differences (N,), with the Wilcoxon test's interval.

    The interval is distribution-free (Hollander, Wolfe & Chicken 2014, Sect. 3.3) and, with few differences,
    the widest there is: five of them reach 93.75 % at most.
    """
    differences = _sample(differences)
    n = len(differences)
    if n == 0:
        return UNKNOWN_INTERVAL
    rows, columns = np.triu_indices(n)
    walsh = np.sort((differences[rows] + differences[columns]) / 2.0)
    cumulative = np.cumsum(_distribution(np.arange(1.0, n + 1)))[::2]
    # cuts off as many of the smallest means as the confidence allows
    cut = max(int(np.searchsorted(cumulative, (1.0 - confidence) / 2.0, side="right")) - 1, 0)
    reached = 1.0 - 2.0 * float(cumulative[cut])
    return Interval(float(np.median(walsh)), float(walsh[cut]), float(walsh[-1 - cut]), reached)


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


def noninferiority_p(gains: np.ndarray, margin: float) -> float:
    """Computes the one-sided exact Wilcoxon p of "the first method is worse by the margin or more".

    The two one-sided tests for equivalence (Schuirmann 1987) are this test of the gains and of their negatives.

    Args:
        gains: (N,) paired differences, larger is better.
        margin: > 0, in the same unit.
    """
    shifted = np.round(_sample(gains) + margin, 9)
    shifted = shifted[shifted != 0.0]
    if not len(shifted):
        return math.nan
    ranks = stats.rankdata(np.abs(shifted))
    return float(_distribution(ranks)[int(round(2 * ranks[shifted > 0].sum())) :].sum())


def holm(ps: Sequence[float]) -> np.ndarray:
    """Corrects the p of one family of tests by Holm's method, (N,). Unknown ones stay unknown and do not count."""
    # statsmodels takes a second to import, and a simulation does not need it
    from statsmodels.stats.multitest import multipletests

    corrected = np.array(ps, dtype=float)
    is_known = np.isfinite(corrected)
    if is_known.any():
        corrected[is_known] = multipletests(corrected[is_known], ALPHA, "holm")[1]
    return corrected


def compare_completed(first: np.ndarray, second: np.ndarray) -> Dict[str, float]:
    """Counts pairs (N,) of 0 and 1 by which of the two were completed; `p` is McNemar's, exact."""
    from statsmodels.stats.contingency_tables import mcnemar

    first, second = (_sample(values).astype(bool) for values in (first, second))
    counts = {
        "both": int((first & second).sum()),
        "first": int((first & ~second).sum()),
        "second": int((~first & second).sum()),
        "neither": int((~first & ~second).sum()),
    }
    table = [[counts["both"], counts["first"]], [counts["second"], counts["neither"]]]
    return {**counts, "p": float(mcnemar(table, exact=True).pvalue)}


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


def difference_of_proportions(first: np.ndarray, second: np.ndarray, confidence: float = CONFIDENCE) -> Interval:
    """Computes the first sample's share of ones minus the second's, (N,) and (M,) of 0 and 1, with Newcombe's interval.

    All values count as independent: the interval is too wide for pairs, and too narrow for several runs of a person who
    fails more than once. Unlike a bootstrap, it allows for events that none of a few people had.
    """
    from statsmodels.stats.proportion import confint_proportions_2indep

    first, second = (_sample(values) for values in (first, second))
    if not len(first) or not len(second):
        return UNKNOWN_INTERVAL
    counts = first.sum(), len(first), second.sum(), len(second)
    low, high = confint_proportions_2indep(*counts, method="newcomb", compare="diff", alpha=1.0 - confidence)
    return Interval(float(first.mean() - second.mean()), float(low), float(high), confidence)


def proportion(successes: int, n: int) -> Interval:
    """Computes a success rate, 0 .. 1, with Wilson's interval."""
    if n == 0:
        return UNKNOWN_INTERVAL
    limits = stats.binomtest(int(successes), int(n)).proportion_ci(CONFIDENCE, method="wilson")
    return Interval(successes / n, float(limits.low), float(limits.high), CONFIDENCE)


def format_number(value: float, digits: int) -> str:
    """Writes a number as the report shows it, or a dash for what is unknown."""
    return "–" if math.isnan(value) else f"{value:.{digits}f}".replace("-", "\N{MINUS SIGN}")


def format_p(p: float) -> str:
    """Writes p as the paper does: "< .001", ".016", "1"."""
    if not math.isfinite(p):
        return "–"
    if p < 0.001:
        return "< .001"
    return f"{p:.3f}".lstrip("0") if p < 0.9995 else "1"


def _distribution(ranks: np.ndarray) -> np.ndarray:
    """Computes the probability of each sum 0, 1/2, 1, ... of those ranks (N,) whose random sign is plus."""
    pmf = np.ones(1)
    for doubled in np.round(2.0 * np.asarray(ranks)).astype(int):
        grown = np.zeros(len(pmf) + doubled)
        grown[: len(pmf)] += 0.5 * pmf
        grown[doubled:] += 0.5 * pmf
        pmf = grown
    return pmf


def _sample(values: np.ndarray) -> np.ndarray:
    """Checks a sample and returns it as (N,) float64, all finite."""
    sample = np.asarray(values, dtype=float)
    if sample.ndim != 1 or not np.isfinite(sample).all():
        raise CodedError("bad_sample", "a sample is a list of finite numbers: leave out runs without a value")
    return sample
