"""What recordings and a scene call the same joints: names that differ by a prefix or by their separators alone."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import takewhile

from pipeline.errors import ParameterError


def matched_names(recorded: Sequence[str], ours: Sequence[str]) -> dict[str, str]:
    """By name in the recordings, the scene's name of the same joint; of joints that both have by the same name, too.

    Names are compared without case and separators: `left/joint_1` is `left_joint1`. Of the others, those are the same
    whose names are once a prefix of all of these names is left out on either side, such as `fr3` and `panda`.

    Args:
        recorded: names in the recordings.
        ours: names in the scene.

    Raises:
        ParameterError: two prefixes match equally many joints, as with recordings of two arms and a scene of one.
    """
    found = {name: name for name in recorded if name in ours}
    plain = {_plain(name): name for name in ours if name not in found.values()}
    for name in recorded:
        if name not in found and (same := plain.get(_plain(name))) is not None and same not in found.values():
            found[name] = same
    others = _by_prefix(
        [name for name in recorded if name not in found], [name for name in ours if name not in found.values()]
    )
    return found | others if len(others) > max(1, len(found)) else found


def renamed(matches: dict[str, str]) -> dict[str, str]:
    """Of the matches those whose names differ: what a task has as `joint_names`."""
    return {theirs: ours for theirs, ours in matches.items() if theirs != ours}


def _by_prefix(recorded: Sequence[str], ours: Sequence[str]) -> dict[str, str]:
    candidates: dict[tuple[str, str], dict[str, str]] = {}
    for theirs in recorded:
        for mine in ours:
            ends = _plain(theirs), _plain(mine)
            shared = _shared_end(*ends)
            prefixes = (ends[0][: len(ends[0]) - shared], ends[1][: len(ends[1]) - shared])
            if shared and prefixes not in candidates:
                candidates[prefixes] = _under(prefixes, recorded, ours)
    if not candidates:
        return {}
    most = max(len(found) for found in candidates.values())
    best = [found for found in candidates.values() if len(found) == most]
    if most > 1 and any(set(one.items()) != set(best[0].items()) for one in best):
        said = "; or ".join(", ".join(f"{theirs}: {mine}" for theirs, mine in one.items()) for one in best[:2])
        raise ParameterError(
            f"the recordings have several joints that could be the scene's: {said}; name the ones that you mean with "
            "--joint-name RECORDED=SCENE, once for each joint"
        )
    return best[0]


def _under(prefixes: tuple[str, str], recorded: Sequence[str], ours: Sequence[str]) -> dict[str, str]:
    """The joints that are the same once these prefixes are left out."""
    rest = {_plain(mine)[len(prefixes[1]) :]: mine for mine in ours if _plain(mine).startswith(prefixes[1])}
    found = {}
    for theirs in recorded:
        if _plain(theirs).startswith(prefixes[0]) and (end := _plain(theirs)[len(prefixes[0]) :]) in rest and end:
            found[theirs] = rest[end]
    return found


def _shared_end(one: str, other: str) -> int:
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], zip(reversed(one), reversed(other), strict=False)))


def _plain(name: str) -> str:
    return re.sub(r"[\W_]+", "", name).lower()
