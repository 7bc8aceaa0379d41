"""Alternatives that somebody else sampled: judged as recordings and sampled ones are."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.arrays import BoolArray, FloatArray, IndexArray, IntArray
from pipeline.errors import StageError
from pipeline.formats.parquet.foreign_arrays import ForeignArrays, foreign_arrays
from pipeline.params import Ingest
from pipeline.replay.ends import distances
from pipeline.replay.mechanism.limits import judge_positions
from pipeline.replay.scene import Scene
from pipeline.trajectories.samplers import Fate, Tally
from pipeline.trajectories.timebase import to_branch, unwrap
from pipeline.vocabulary import GIVEN
from pipeline.workspace.anchors import Ends
from pipeline.workspace.plausibility import is_far

COLUMN = "waypoints"
NAMED_BY = "sample.given"
_ALIKE = 10  # decimals; rows that agree in these are the same trajectory, perhaps reported in another turn
_SMOOTHER = 2.0  # times as smooth in the other order: the numbers are in that order
_MANY = 0.5  # share of trajectories beyond the limits from which on all are refused


@dataclass(frozen=True, eq=False)
class Given:
    """Trajectories of a file.

    Attributes:
        path: the file.
        digest: SHA-256 of the bytes that were read.
        waypoints: (P, T, J), unwrapped, on the branch of the scene's start; equal ones are equal in every bit. Sorted,
            so that the order in the file changes nothing.
        within: (P,) no joint is beyond its limits.
        notes: what is to be said of them, a sentence each.
    """

    path: Path
    digest: str
    waypoints: FloatArray
    within: BoolArray
    notes: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Pool:
    """The given trajectories of one anchor.

    Attributes:
        rows: (N,) which of the given trajectories start and end as it does.
        fates: (N,) `Fate` of each.
        notes: what is to be said of them, a sentence each.
    """

    rows: IndexArray
    fates: IntArray
    notes: tuple[str, ...]

    @property
    def size(self) -> int:
        """How many can be used."""
        return int((self.fates == Fate.KEPT).sum())

    def choose(self, rng: np.random.Generator, count: int) -> tuple[IndexArray, Tally]:
        """`count` of those that can be used, each as likely as any other, and what was passed over on the way."""
        order = rng.permutation(len(self.rows))
        kept = np.flatnonzero(self.fates[order] == Fate.KEPT)[:count]
        seen = self.fates[order[: kept[-1] + 1]]
        fates = {fate: int((seen == fate).sum()) for fate in Fate}
        tally = Tally(
            GIVEN, len(seen), fates[Fate.OUTSIDE_LIMITS], fates[Fate.THROUGH_SURFACE], fates[Fate.IN_COLLISION]
        )
        return self.rows[order[kept]], tally


def read_given(path: Path, scene: Scene, waypoints: int) -> Given:
    """The trajectories of the column `waypoints` of a Parquet file: lists of T poses of J joints, or of T x J numbers.

    Raises:
        StageError: the file cannot be read, its trajectories have another shape or are not finite, or most of them are
            beyond the joints' limits.
    """
    with foreign_arrays(path, COLUMN, NAMED_BY, waypoints * len(scene.joints)) as column:
        paths = _shaped(column, waypoints, scene.joints)
    turned, within, notes = _judged(path, paths, scene)
    reference = turned[0, 0] if scene.start is None else scene.start
    branched = np.stack([to_branch(unwrap(one, scene.continuous), reference, scene.continuous) for one in turned])
    same, repeated = _first_alike(branched)
    said = [f"{repeated} of {len(paths)} trajectories are the same as others"] if repeated else []
    order = np.lexsort(branched[same].reshape(len(paths), -1).T[::-1])
    return Given(
        path,
        column.digest,
        branched[same][order],
        within[order],
        tuple(f"{NAMED_BY}: {note}" for note in [*notes, *said]),
    )


def pool_of(given: Given, ends: Ends, scene: Scene, settings: Ingest) -> Pool:
    """Which of the given trajectories can be alternatives between the ends.

    Raises:
        StageError: see `Ends.room`.
    """
    anchor = ends.anchor
    far = np.zeros(len(given.waypoints), dtype=bool)
    for end, target in ((given.waypoints[:, 0], anchor.start), (given.waypoints[:, -1], anchor.goal)):
        far |= [is_far(apart, settings) for apart in distances(scene, end, target)]
    rows = np.flatnonzero(~far) if settings.far_ends == "reject" else np.arange(len(far))
    fates = np.where(given.within[rows], Fate.KEPT, Fate.OUTSIDE_LIMITS)
    inside = fates == Fate.KEPT
    if inside.any():
        fates[inside] = ends.room().judge(scene.limits.clamped(given.waypoints[rows[inside]]))
    counts = {
        "start or end elsewhere": len(far) - len(rows),
        "have a joint beyond its limits": int((fates == Fate.OUTSIDE_LIMITS).sum()),
        "go through the surface": int((fates == Fate.THROUGH_SURFACE).sum()),
        "touch something": int((fates == Fate.IN_COLLISION).sum()),
    }
    left_out = ", ".join(f"{count} {what}" for what, count in counts.items() if count)
    notes = (
        (f"{NAMED_BY}: of {len(far)} trajectories left out for anchor {ends.label!r}: {left_out}",) if left_out else ()
    )
    return Pool(rows, fates, notes)


def _shaped(column: ForeignArrays, waypoints: int, joints: tuple[str, ...]) -> FloatArray:
    """Values of the column as (P, T, J).

    Raises:
        StageError: they are not.
    """
    path, expected, flat = column.path, (waypoints, len(joints)), (waypoints * len(joints),)
    needed = (
        f"needed are {waypoints} waypoints of {len(joints)} joints ({', '.join(joints)}), as {waypoints} lists of "
        f"{len(joints)} numbers or {waypoints * len(joints)} numbers in a row, waypoint after waypoint"
    )
    found, nested = [], False
    for rows in column.rows():
        if rows.values is None:
            raise StageError(f"{path}: row {rows.first} has no regular lists of numbers; {needed}")
        shape = rows.values.shape[1:]
        if shape not in (expected, flat):
            turned = "; it has joint after joint: transpose it" if shape == expected[::-1] else ""
            said = " x ".join(str(length) for length in shape)
            raise StageError(f"{path}: row {rows.first} is {said}{turned}; {needed}")
        finite = np.isfinite(rows.values).reshape(len(rows.values), -1).all(axis=1)
        if not finite.all():
            number = rows.first + int(finite.argmin())
            raise StageError(f"{path}: row {number} has a number that is not finite; {needed}")
        nested |= shape == expected
        found.append(rows.values.reshape(-1, *expected))
    if not found:
        raise StageError(f"{path}: has no rows; {needed}")
    paths = np.concatenate(found)
    if not nested and _rough(_other_order(paths)) * _SMOOTHER < _rough(paths):
        raise StageError(
            f"{path}: its rows are smooth if they are read joint after joint, as {len(joints)} x {waypoints}, and not "
            f"waypoint after waypoint; {needed}"
        )
    return paths


def _other_order(paths: FloatArray) -> FloatArray:
    """(P, T, J) as they would be if the numbers of each row were J lists of T."""
    count, steps, joints = paths.shape
    return paths.reshape(count, joints, steps).transpose(0, 2, 1)


def _rough(paths: FloatArray) -> float:
    """The mean step from one waypoint to the next."""
    return float(np.abs(np.diff(paths, axis=1)).mean())


def _judged(path: Path, paths: FloatArray, scene: Scene) -> tuple[FloatArray, BoolArray, list[str]]:
    """The trajectories, with whole turns added to bring joints within limits; which are within; notes on the others."""
    limits = scene.limits
    odd = (limits.excess(paths) > 0).any(axis=(1, 2)) | (np.abs(np.diff(paths, axis=1)) > np.pi).any(axis=(1, 2))
    turned, within, first, moved = paths.copy(), np.ones(len(paths), dtype=bool), "", 0
    for row in np.flatnonzero(odd):
        judged = judge_positions(limits, paths[row])
        if judged.refusal is None:
            moved += bool((judged.positions != paths[row]).any())
            turned[row] = judged.positions
            continue
        within[row] = False
        first = first or f"row {row + 1}: {judged.refusal}"
    beyond = int((~within).sum())
    if beyond > _MANY * len(paths):
        raise StageError(
            f"{path}: {beyond} of {len(paths)} trajectories have a joint beyond its limits, such as {first}"
            f" Correct them, or the joint's range in {scene.path.name}."
        )
    notes = [f"{moved} trajectories have a joint a whole turn from its limits; they were turned back"] if moved else []
    return (
        turned,
        within,
        notes + ([f"{beyond} trajectories have a joint beyond its limits, such as {first}"] if beyond else []),
    )


def _first_alike(paths: FloatArray) -> tuple[IndexArray, int]:
    """(P,) for each trajectory the first that agrees with it, and how many agree with an earlier one."""
    flat = np.round(paths.reshape(len(paths), -1), _ALIKE) + 0.0
    first: dict[bytes, int] = {}
    same = np.array([first.setdefault(row.tobytes(), place) for place, row in enumerate(flat)], dtype=np.intp)
    return same, len(paths) - len(first)
