"""Intervals and paired tests against values worked out by hand and against scipy's other routines."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from takeapart.experiments.paired_statistics import compare, mean_interval
from takeapart.experiments.paper_values import TABLE_1


def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def test_the_interval_of_a_mean_is_that_of_the_textbook() -> None:
    # 1, 2, 3: s = 1, t(0.975, 2) = 4.302653, half width 4.302653 / sqrt(3) = 2.484138
    found = mean_interval([1.0, 2.0, 3.0])
    assert (found.mean, found.low, found.high) == pytest.approx((2.0, 2.0 - 2.484138, 2.0 + 2.484138), abs=1e-6)


def test_too_few_values_have_no_interval() -> None:
    one, none = mean_interval([4.0]), mean_interval([])
    assert one.mean == 4.0 and math.isnan(one.low) and math.isnan(one.high)
    assert math.isnan(none.mean)


def test_a_comparison_by_hand() -> None:
    # Differences -1, -2, +0.5, -3: |d| ranks 2, 3, 1, 4; W = min(9, 1) = 1.
    found = compare([10.0, 10.0, 10.0, 10.0], [9.0, 8.0, 10.5, 7.0], rng())
    assert (found.pairs, found.smaller, found.equal, found.larger) == (4, 3, 0, 1)
    assert (found.first, found.second) == (10.0, 8.625)
    assert found.difference.mean == pytest.approx(-1.375)
    assert found.reduction == pytest.approx(0.1375)
    # All 16 signs are as likely; rank sums of at most 1: {}, {1}. Two-sided: 4 / 16.
    assert found.wilcoxon_p == pytest.approx(0.25)
    assert found.t_p == pytest.approx(stats.ttest_rel([9.0, 8.0, 10.5, 7.0], [10.0] * 4).pvalue)


def test_the_papers_table_1_as_scipy_sees_it() -> None:
    vanilla = [row.vanilla.shortest for row in TABLE_1]
    guided = [row.guided["single"].shortest for row in TABLE_1]
    found = compare(vanilla, guided, rng())
    assert (found.smaller, found.larger) == (14, 0)
    assert found.difference.mean == pytest.approx(-0.807, abs=1e-3)  # "on average 0.8 m shorter"
    assert found.t_p == pytest.approx(stats.ttest_rel(guided, vanilla).pvalue)
    assert found.wilcoxon_p == pytest.approx(2 / 2**14)  # every one of 14 differences has the same sign
    low, high = stats.t.interval(
        0.95, 13, np.mean(np.subtract(guided, vanilla)), stats.sem(np.subtract(guided, vanilla))
    )
    assert (found.difference.low, found.difference.high) == pytest.approx((low, high))
    resampled = stats.bootstrap(
        (np.subtract(guided, vanilla),), np.mean, method="percentile", n_resamples=20_000, rng=rng()
    )
    expected = resampled.confidence_interval
    assert found.bootstrap == pytest.approx((expected.low, expected.high), abs=0.02)
    assert found.reduction_low < found.reduction < found.reduction_high


def test_pairs_without_a_length_are_left_out() -> None:
    found = compare([10.0, math.inf, 12.0, 14.0], [9.0, 8.0, math.inf, 15.0], rng())
    assert (found.pairs, found.first, found.second) == (2, 12.0, 12.0)


def test_no_difference_at_all_proves_nothing() -> None:
    found = compare([1.0, 2.0, 3.0], [1.0, 2.0, 3.0], rng())
    assert (found.t_p, found.wilcoxon_p, found.reduction, found.equal) == (1.0, 1.0, 0.0, 3)


@pytest.mark.parametrize("pairs", [0, 1])
def test_a_single_pair_has_no_test(pairs: int) -> None:
    found = compare([2.0] * pairs, [1.0] * pairs, rng())
    assert found.pairs == pairs
    assert math.isnan(found.t_p) and math.isnan(found.wilcoxon_p) and math.isnan(found.bootstrap[0])


def test_the_same_numbers_give_the_same_interval() -> None:
    values = rng().normal(15, 1, 14), rng().normal(14, 1, 14)
    first, second = (compare(values[0].tolist(), values[1].tolist(), rng()) for _ in range(2))
    assert first == second
