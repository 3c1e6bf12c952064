import importlib.util
from pathlib import Path

import numpy as np
import pytest

from multicam.evaluation.recall import BOP_PIXELS, BOP_SHARES, auc_posecnn, average_recall, median, recall


def test_recall_is_the_share_below_the_threshold():
    assert recall([0.01, 0.02, 0.03, np.inf], 0.02) == 0.25
    assert np.isnan(recall([], 0.1))


def test_average_recall_by_hand():
    # 12 % of the diameter passes the thresholds 15 % to 50 %, that is 8 of 10; an infinite error none.
    assert average_recall([0.12, np.inf], BOP_SHARES) == pytest.approx(0.4)
    assert BOP_SHARES[0] == pytest.approx(0.05)
    assert BOP_SHARES[-1] == pytest.approx(0.5)
    assert list(BOP_PIXELS) == list(range(5, 55, 5))


def test_area_under_the_curve_by_hand():
    # Accuracy 1/3 from 0 to 20 mm (the value at the right end), 2/3 from 20 to 50 mm and on to 100 mm:
    # (20 / 3 + 30 * 2 / 3 + 50 * 2 / 3) / 100 = 0.6. The third error is beyond the limit.
    assert auc_posecnn([0.05, 0.02, 0.2]) == pytest.approx(0.6)


def test_missing_estimates_cost_area():
    assert auc_posecnn([0.0, 0.0]) == 1.0
    assert auc_posecnn([0.0, np.inf]) == 0.5
    assert auc_posecnn([np.inf]) == 0.0
    assert np.isnan(auc_posecnn([]))


def test_the_area_agrees_with_an_independent_implementation(bench_dir: Path, rng):
    spec = importlib.util.spec_from_file_location("score", bench_dir / "score.py")
    assert spec is not None
    assert spec.loader is not None
    score = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(score)
    for _ in range(20):
        errors = rng.exponential(0.06, size=rng.integers(1, 30))
        assert 100 * auc_posecnn(errors) == pytest.approx(score.auc(errors))


def test_the_median_counts_missing_estimates():
    assert median([0.01, np.inf, np.inf]) == np.inf
    assert median([0.01, 0.03, np.inf]) == 0.03
