"""Optimal one-to-one assignment in compiled code (Hungarian method by shortest augmenting paths).

scipy.optimize.linear_sum_assignment cannot be called from compiled code; it is this module's oracle in the tests.
"""

import math

import numpy as np

from cad_env.numerics.jit import compiled, compiled_part
from cad_env.types import Floats, Ints


@compiled
def assign(cost: Floats, rows: int, columns: int, gate: float, match: Ints) -> None:
    """Write to match[:rows] the column of each row, or -1: least total cost, where a row left alone costs `gate`.

    cost: (>= rows, >= columns); a pair dearer than the gate is never made.
    """
    if _take_undisputed(cost, rows, columns, gate, match):
        return
    _augment(cost, rows, columns, gate, match)


@compiled_part
def _take_undisputed(cost: Floats, rows: int, columns: int, gate: float, match: Ints) -> bool:
    """True if no row and no column has two partners within the gate: then those pairs are the optimum."""
    taken = np.zeros(columns, np.bool_)
    for i in range(rows):
        match[i] = -1
        for j in range(columns):
            if cost[i, j] < gate:
                if match[i] >= 0 or taken[j]:
                    return False
                match[i] = j
                taken[j] = True
    return True


@compiled_part
def _augment(cost: Floats, rows: int, columns: int, gate: float, match: Ints) -> None:
    """The general case. Column `columns + i` is row i's right to stay alone, so every row finds a place."""
    width = columns + rows
    row_price, column_price = np.zeros(rows), np.zeros(width)
    owner = np.full(width, -1, np.int64)
    for start in range(rows):
        slack, previous = np.full(width, math.inf), np.full(width, -1, np.int64)
        settled = np.zeros(width, np.bool_)
        row, column = start, -1
        while True:
            best, chosen = math.inf, -1
            for j in range(width):
                if settled[j]:
                    continue
                price = cost[row, j] if j < columns else (gate if j - columns == row else math.inf)
                if j < columns and price >= gate:
                    price = math.inf
                reduced = price - row_price[row] - column_price[j]
                if reduced < slack[j]:
                    slack[j] = reduced
                    previous[j] = column
                if slack[j] < best:
                    best, chosen = slack[j], j
            row_price[start] += best
            for j in range(width):
                if settled[j]:
                    row_price[owner[j]] += best
                    column_price[j] -= best
                else:
                    slack[j] -= best
            settled[chosen] = True
            column = chosen
            if owner[chosen] < 0:
                break
            row = owner[chosen]
        while column >= 0:
            before = previous[column]
            owner[column] = start if before < 0 else owner[before]
            column = before
    for j in range(columns):
        if owner[j] >= 0:
            match[owner[j]] = j
    for i in range(rows):
        if owner[columns + i] == i:
            match[i] = -1
