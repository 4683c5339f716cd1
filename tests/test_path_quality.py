"""The experiment on the quality of first answers."""

from __future__ import annotations

import pytest

from path_quality import Sample, refined, table


def test_no_answer_is_shorter_than_the_best_one_or_the_bound() -> None:
    samples = refined("single/01", count=3, seconds=0.2, seed=1)
    assert len(samples) == 3
    for sample in samples:
        assert sample.bound <= sample.best + 1e-9
        assert sample.best <= sample.first
        assert sample.attempts > 1 or sample.best <= sample.bound + 1e-4


def test_figures_by_hand() -> None:
    samples = [Sample(1.0, 1.0, 0.8, 1), Sample(1.1, 1.0, 1.0, 3), Sample(1.02, 1.0, 0.5, 5)]
    assert [sample.ratio for sample in samples] == pytest.approx([1.0, 1.1, 1.02])
    row = [cell.strip() for cell in table(samples, 30.0).splitlines()[2].strip("| ").split("|")]
    assert row == ["3", "3", "1.0200", "1.0840", "1.0400", "67 %", "1.250"]
