"""Grid-world paths, and their overlap, by plain recursion and loops."""

from __future__ import annotations

from itertools import pairwise
from math import hypot

Path = tuple[tuple[int, int], ...]


def all_paths(size: int) -> list[Path]:
    """Every shortest path from corner to corner, by recursion."""

    def onward(x: int, y: int) -> list[list[tuple[int, int]]]:
        if (x, y) == (size - 1, size - 1):
            return [[(x, y)]]
        ahead = []
        if x < size - 1:
            ahead += onward(x + 1, y)
        if y < size - 1:
            ahead += onward(x, y + 1)
        return [[(x, y), *rest] for rest in ahead]

    return [tuple(path) for path in onward(0, 0)]


def mean_distance(path: Path, centre: tuple[int, int]) -> float:
    return sum(hypot(x - centre[0], y - centre[1]) for x, y in path) / len(path)


def path_size(paths: list[Path], chosen: int) -> float:
    """sum over the path's links of (1 / its length) / (number of paths that use the link)."""
    links = [list(pairwise(path)) for path in paths]
    length = len(links[chosen])
    return sum(1 / length / sum(link in other for other in links) for link in links[chosen])
