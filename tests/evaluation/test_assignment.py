from multicam.evaluation.assignment import assign_greedily


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
