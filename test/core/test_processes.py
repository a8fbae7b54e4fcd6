"""Work spread over processes: each piece once, in order, by several, and an error comes through."""

import os

import pytest

from uuv_optical_array.core.processes import spread


def test_results_come_in_order_from_several_processes():
    results = list(spread(lambda i: (i * i, os.getpid()), 40, 2, 4))
    assert [square for square, _ in results] == [i * i for i in range(40)]
    assert os.getpid() not in {process for _, process in results}


@pytest.mark.parametrize(("processes", "chunk"), [(1, 1), (None, 40)])
def test_what_is_one_piece_is_done_here(processes, chunk):
    assert set(spread(lambda i: os.getpid(), 40, processes, chunk)) == {os.getpid()}


@pytest.mark.parametrize("processes", [1, 2])
def test_an_error_of_the_work_is_raised_where_it_was_asked_for(processes):
    def work(i):
        if i == 2:
            raise ValueError("the third")
        return i

    results = spread(work, 4, processes)
    assert [next(results), next(results)] == [0, 1]
    with pytest.raises(ValueError, match="the third"):
        next(results)
