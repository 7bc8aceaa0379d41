"""Who is shown what: trials, sides and orders, balanced over people as they come."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Assignment:
    """What one person sees.

    Attributes:
        trials: names, in the order in which they are asked.
        mirrored: whether columns and rows are exchanged.
        turn: the order of the options, see `order`.
    """

    trials: tuple[str, ...]
    mirrored: bool
    turn: int


def next_assignment(before: Iterable[Assignment], trials: Sequence[str], *, show_all: bool, mirror: bool) -> Assignment:
    """What the next person sees: what the fewest have been shown so far.

    With `show_all` every person is asked every trial, starting with each of them equally often. Among people with the
    same first trial, sides take turns; among those with the same side too, orders do.

    Args:
        before: what people have been shown so far, finished or not.
        trials: the names of the trials.
        show_all: ask all trials rather than one.
        mirror: whether sides are exchanged for half of the people.
    """
    counts = Counter((given.trials[0], given.mirrored) for given in before)
    sides = (False, True) if mirror else (False,)
    first = min(trials, key=lambda name: sum(counts[name, side] for side in sides))
    mirrored = min(sides, key=lambda side: counts[first, side])
    place = trials.index(first)
    asked = (*trials[place:], *trials[:place]) if show_all else (first,)
    return Assignment(asked, mirrored, counts[first, mirrored])


def order(names: Sequence[str], turn: int) -> list[str]:
    """The options in the order in which they are shown at this turn.

    Each option is at each place equally often over `2 * len(names)` turns, and before each other one as often as after
    it: the first half are the rotations of the list, the second half those of the reversed list.
    """
    count = len(names)
    row = list(names) if turn // count % 2 == 0 else list(reversed(names))
    start = turn % count
    return row[start:] + row[:start]
