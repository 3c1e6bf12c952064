import numpy as np

from multicam.evaluation.assignment import assign_greedily, found_below, found_share


def distance(a: float, b: float) -> float:
    return abs(a - b)


def test_better_scored_estimates_choose_first_and_each_truth_is_used_once():
    # The first estimate takes the truth 10, though the second would fit it better.
    assert assign_greedily([12, 10], [10, 50], distance) == [(0, 2), (1, 40)]


def test_further_guesses_do_not_count():
    assert assign_greedily([99, 10], [10], distance) == [(0, 89)]


def test_missing_estimates_leave_their_truth_unanswered():
    assert assign_greedily([11], [10, 50], distance) == [(0, 1), None]
    assert assign_greedily([], [10], distance) == [None]


def test_an_estimate_that_fits_nothing_leaves_its_truth_to_the_next():
    # At 10 the first estimate is right for neither truth, and the second may take the first one.
    errors = np.array([[12.0, 30], [5, 40]])
    assert found_below(errors, 10).tolist() == [True, False]
    # At 20 the first takes it, and the second has nothing left but the other truth.
    assert found_below(errors, 20).tolist() == [True, False]
    assert found_below(errors, 50).tolist() == [True, True]


def test_the_better_scored_takes_its_best_even_if_another_needs_it():
    errors = np.array([[1.0, 2], [1, 9]])
    assert found_below(errors, 5).tolist() == [True, False]


def test_an_error_at_the_threshold_is_not_below_it():
    assert found_below(np.array([[5.0]]), 5).tolist() == [False]


def test_shares_by_hand():
    # 12 passes 20 and 50 of four thresholds; without estimates nothing is found.
    assert found_share(np.array([[12.0]]), (5, 10, 20, 50)).tolist() == [0.5]
    assert found_share(np.zeros((0, 2)), (5, 10)).tolist() == [0, 0]
