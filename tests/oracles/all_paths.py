"""All paths of a small network by enumeration, up to a number of steps: slow and obvious."""

from __future__ import annotations

from collections.abc import Iterator, Sequence


def all_paths(steps: Sequence[tuple[int, int]], origin: int, destination: int, most: int) -> Iterator[tuple[int, ...]]:
    """Each path as the numbers of its steps; a path may come through a state again, up to `most` steps."""
    waiting: list[tuple[int, tuple[int, ...]]] = [(origin, ())]
    while waiting:
        state, path = waiting.pop()
        if state == destination:
            yield path
        elif len(path) < most:
            waiting += [(end, (*path, number)) for number, (start, end) in enumerate(steps) if start == state]
