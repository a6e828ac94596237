"""Every episode of a scoring run, in the order of its table: condition, scenario, method, seed."""

import re
from collections.abc import Iterable, Sequence
from typing import NamedTuple

CHUNK = 25  # episodes that a process takes at a time
MOST_EPISODES = 10_000_000  # of a scenario and method

# condition (None: what the settings say), scenario, method, seed: what tells an episode from all others
Key = tuple[str | None, str, str, int]
NO_CONDITION = (None,)  # of a run without named ones


class Task(NamedTuple):
    """Episodes that are driven in one go."""

    scenario: str
    method: str
    seeds: Sequence[int]
    condition: str | None = None

    def episodes(self) -> list[Key]:
        """Its episodes."""
        return [(self.condition, self.scenario, self.method, seed) for seed in self.seeds]


def grid(
    scenarios: Sequence[str],
    methods: Sequence[str],
    seeds: range,
    shard: str | None = None,
    conditions: Iterable[str | None] = NO_CONDITION,
) -> list[Task]:
    """All tasks, or those of a shard `i/n`: every n-th, from the i-th on.

    >>> [task.seeds for task in grid(["left_turn"], ["expert"], range(60), "2/2")]
    [range(25, 50)]
    """
    number, count = (1, 1) if shard is None else shard_of(shard)
    tasks = [
        Task(scenario, method, seeds[start : start + CHUNK], condition)
        for condition in conditions
        for scenario in scenarios
        for method in methods
        for start in range(0, len(seeds), CHUNK)
    ]
    return tasks[number - 1 :: count]


def shard_of(text: str) -> tuple[int, int]:
    """The numbers of `i/n`; ValueError unless 1 <= i <= n <= 100000."""
    found = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text, re.ASCII)
    number, count = map(int, found.groups()) if found else (0, 0)
    if not 1 <= number <= count <= 100_000:
        raise ValueError(f"shard must be i/n with i from 1 to n, such as 2/8, got {text!r}")
    return number, count
