"""How right labels are counted."""

import numpy as np
import pytest

from kinran.compare.chart_regions import right


def test_a_region_counts_as_what_most_of_it_is() -> None:
    truth = np.array([0, 0, 0, 1, 1, 1, 2, 2])
    labels = np.array([5, 5, 5, 3, 3, 5, 0, 0])
    pure = np.array([1, 1, 1, 1, 1, 0, 1, 1], bool)
    assert right(labels, truth, pure) == {"all texels": pytest.approx(7 / 8), "pure texels": 1.0}


def test_two_threads_in_one_region_are_half_wrong() -> None:
    truth = np.repeat([0, 1], 50)
    assert right(np.zeros(100, int), truth, np.ones(100, bool))["all texels"] == 0.5
