"""Where the routes of a map meet beyond their lines, and who gives way there: priority to the right."""

import math

import numpy as np

from cad_env.scenarios.lanes import IN_THE_WAY
from cad_env.types import Command, Floats, Ints
from cad_env.world.dynamics import wrapped
from cad_env.world.state import Routes

_SQUARE = math.radians(45.0)  # rad that a direction may be off from one that is square to it
_BEFORE, _AFTER = 10.0, 40.0  # m before and after their lines, between which routes are asked where they meet
_MERGED = 15.0  # m after two ways have become one, from where on who follows whom is settled


def with_priority(routes: Routes) -> Routes:
    """The routes with `meets` and `yields` filled in for all that have a line."""
    lined = np.flatnonzero(np.isfinite(routes.line)).tolist()
    for a in lined:
        for b in lined:
            found = _meeting(routes, a, b)
            if found is not None:
                routes.meets[a, b] = found
                routes.yields[a, b] = _lets_pass(routes, a, b)
    return routes


def _meeting(routes: Routes, a: int, b: int) -> tuple[float, float, float, float] | None:
    """m from where to where a has b in its way, then b a; None if nowhere, or if the two come from one arm."""
    own, other = _window(routes, a), _window(routes, b)
    near = np.linalg.norm(routes.point[a, own][:, None] - routes.point[b, other][None], axis=-1) < IN_THE_WAY
    if near[0, 0] or not near.any():
        return None
    mine, theirs = own[near.any(axis=1)] * routes.spacing, other[near.any(axis=0)] * routes.spacing
    return mine[0], min(mine[-1], mine[0] + _MERGED), theirs[0], min(theirs[-1], theirs[0] + _MERGED)


def _window(routes: Routes, route: int) -> Ints:
    """The samples of a route that are near its line."""
    line: float = routes.line[route]
    samples: Ints = np.arange(int((line - _BEFORE) / routes.spacing), int((line + _AFTER) / routes.spacing))
    return samples


def _lets_pass(routes: Routes, a: int, b: int) -> bool:
    """True if b comes from the right of a, or towards it while a turns left and b does not."""
    turn = wrapped(_heading(routes, b) - _heading(routes, a))
    if abs(turn - 0.5 * math.pi) < _SQUARE:
        return True
    opposed = abs(turn) > math.pi - _SQUARE
    return opposed and _turns_left(routes, a) and not _turns_left(routes, b)


def _heading(routes: Routes, route: int) -> float:
    """rad, of a route at its line."""
    return float(routes.heading[route, int(routes.line[route] / routes.spacing)])


def _turns_left(routes: Routes, route: int) -> bool:
    commands: Floats = routes.command[route]
    return bool((commands == Command.TURN_LEFT).any())
