"""Means with confidence intervals, and comparisons of two methods on the same problems."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from takeapart.model.geometry import Array

CONFIDENCE = 0.95
RESAMPLES = 10_000


@dataclass(frozen=True)
class Interval:
    """A mean and where it lies with 95 % confidence; NaN where there are too few values to say.

    Args:
        low, high: by Student's t.
    """

    mean: float
    low: float
    high: float


@dataclass(frozen=True)
class Comparison:
    """Method B against method A, pair by pair. Differences are B - A: negative where B is smaller.

    Args:
        pairs: number of them.
        first, second: means of A and of B.
        difference: mean, with its interval by Student's t.
        bootstrap: 95 % interval of the mean difference by resampling pairs (percentiles).
        reduction: (mean of A - mean of B) / mean of A.
        reduction_low, reduction_high: 95 % interval by resampling pairs.
        smaller, equal, larger: number of pairs with B below, at, above A.
        t_p, wilcoxon_p: of the two-sided paired t-test and of Wilcoxon's signed-rank test; NaN for a single pair.
    """

    pairs: int
    first: float
    second: float
    difference: Interval
    bootstrap: tuple[float, float]
    reduction: float
    reduction_low: float
    reduction_high: float
    smaller: int
    equal: int
    larger: int
    t_p: float
    wilcoxon_p: float


def mean_interval(values: Sequence[float]) -> Interval:
    """Mean with its 95 % interval by Student's t: mean +- t(n-1) * s / sqrt(n)."""
    numbers = np.asarray(values, dtype=float)
    if not len(numbers):
        return Interval(math.nan, math.nan, math.nan)
    mean = float(numbers.mean())
    if len(numbers) < 2:
        return Interval(mean, math.nan, math.nan)
    half = float(stats.t.ppf(0.5 + CONFIDENCE / 2, len(numbers) - 1) * numbers.std(ddof=1) / math.sqrt(len(numbers)))
    return Interval(mean, mean - half, mean + half)


def compare(first: Sequence[float], second: Sequence[float], rng: np.random.Generator) -> Comparison:
    """Compares two methods; pairs of which either is not finite are left out.

    Args:
        first, second: of A and B, in the same order.
        rng: for resampling.
    """
    pairs = np.array([pair for pair in zip(first, second, strict=True) if np.isfinite(pair).all()]).reshape(-1, 2)
    a, b = pairs.T
    difference = b - a

    def reduction_of(sample: Array) -> Array:
        means = sample.mean(axis=-2)
        reduction: Array = 1 - means[..., 1] / means[..., 0]
        return reduction

    low, high = _bootstrap(pairs, lambda sample: (sample[..., 1] - sample[..., 0]).mean(axis=-1), rng)
    reduction_low, reduction_high = _bootstrap(pairs, reduction_of, rng)
    return Comparison(
        pairs=len(pairs),
        first=float(a.mean()) if len(a) else math.nan,
        second=float(b.mean()) if len(b) else math.nan,
        difference=mean_interval(difference.tolist()),
        bootstrap=(low, high),
        reduction=float(reduction_of(pairs)) if len(pairs) else math.nan,
        reduction_low=reduction_low,
        reduction_high=reduction_high,
        smaller=int((difference < 0).sum()),
        equal=int((difference == 0).sum()),
        larger=int((difference > 0).sum()),
        t_p=_t_test(difference),
        wilcoxon_p=_wilcoxon(difference),
    )


def _bootstrap(pairs: Array, statistic: Callable[[Array], Array], rng: np.random.Generator) -> tuple[float, float]:
    if len(pairs) < 2:
        return math.nan, math.nan
    drawn = pairs[rng.integers(len(pairs), size=(RESAMPLES, len(pairs)))]
    low, high = np.quantile(statistic(drawn), [0.5 - CONFIDENCE / 2, 0.5 + CONFIDENCE / 2])
    return float(low), float(high)


def _t_test(difference: Array) -> float:
    if len(difference) < 2:
        return math.nan
    if np.ptp(difference) == 0:  # no spread: certain, one way or the other
        return 1.0 if difference[0] == 0 else 0.0
    return float(stats.ttest_1samp(difference, 0.0).pvalue)


def _wilcoxon(difference: Array) -> float:
    if len(difference) < 2:
        return math.nan
    if not difference.any():
        return 1.0
    return float(stats.wilcoxon(difference).pvalue)
