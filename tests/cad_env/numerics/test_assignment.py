"""Optimal assignment against scipy: the same total cost, with the right to stay alone for the price of the gate."""

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from cad_env.numerics.assignment import assign

costs = st.integers(0, 7).flatmap(
    lambda rows: st.integers(0, 7).flatmap(
        lambda columns: st.lists(
            st.one_of(st.floats(0.0, 6.0), st.sampled_from([0.0, 1.0, 2.0, 3.0, math.inf])),
            min_size=rows * columns,
            max_size=rows * columns,
        ).map(lambda cells: np.array(cells, np.float64).reshape(rows, columns))
    )
)


def matched(cost: np.ndarray, gate: float) -> np.ndarray:
    rows, columns = cost.shape
    roomy = np.full((rows + 2, columns + 3), -1.0)  # callers pass scratch with more room; what is there is not read
    roomy[:rows, :columns] = cost
    match = np.full(rows + 2, 99, np.int64)
    assign(roomy, rows, columns, gate, match)
    assert (match[rows:] == 99).all()
    return match[:rows]


def price(cost: np.ndarray, gate: float, match: np.ndarray) -> float:
    return sum(gate if j < 0 else cost[i, j] for i, j in enumerate(match))


@settings(max_examples=500)
@given(costs, st.sampled_from([0.5, 2.5, 3.0, 10.0]))
def test_the_total_is_the_least_that_scipy_finds(cost: np.ndarray, gate: float):
    rows, forbidden = len(cost), 1e6
    # Column `columns + i` is row i's right to stay alone.
    alone = np.where(np.eye(rows, dtype=bool), gate, forbidden)
    full = np.hstack([np.where(cost < gate, cost, forbidden), alone])
    i, j = linear_sum_assignment(full)
    match = matched(cost, gate)
    assert math.isclose(price(cost, gate, match), full[i, j].sum(), abs_tol=1e-9)


@settings(max_examples=500)
@given(costs, st.sampled_from([0.5, 2.5, 3.0]))
def test_nobody_is_given_away_twice_or_beyond_the_gate(cost: np.ndarray, gate: float):
    match = matched(cost, gate)
    taken = match[match >= 0]
    assert len(set(taken)) == len(taken)
    assert all(cost[i, j] < gate for i, j in enumerate(match) if j >= 0)


def test_the_nearest_is_not_always_taken():
    # Greedy would pair row 0 with column 0 and leave row 1 alone.
    assert matched(np.array([[1.0, 1.5], [1.2, 9.0]]), 3.0).tolist() == [1, 0]


def test_two_pairs_are_dearer_than_one_pair_and_a_loner():
    assert matched(np.array([[0.1, 2.9], [2.8, np.inf]]), 3.0).tolist() == [0, -1]
