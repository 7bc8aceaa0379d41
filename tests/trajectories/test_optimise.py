import numpy as np
import pytest

from pipeline.arrays import FloatArray
from pipeline.errors import ArgumentError, StageError
from pipeline.trajectories.optimise import Optimised, Search, optimise_paths, random_weights
from pipeline.trajectories.paths import sine_basis, straight_path
from pipeline.trajectories.random_streams import child_rng
from pipeline.trajectories.samplers import Anchor

T, J = 41, 3
ANCHOR = Anchor(np.array([0.3, 0.9, -0.4]), np.array([1.7, 0.2, 0.6]))
FREE = np.full(J, np.inf)
TARGET = np.array([1.6, 0.2, 0.5])  # where the middle waypoint would like to be
WEIGHTS = np.array([[1.0, 0.0], [1.0, 1.0], [0.2, 1.0]])


def costs(waypoints: FloatArray) -> FloatArray:
    """Squared steps, and the squared distance of the middle waypoint from TARGET."""
    steps = (np.diff(waypoints, axis=1) ** 2).sum(axis=(1, 2))
    return np.stack([steps, ((waypoints[:, T // 2] - TARGET) ** 2).sum(axis=1)], axis=1)


def anything(waypoints: FloatArray) -> FloatArray:
    return np.full(len(waypoints), True)


def optimise(rows: list[int], **options: object) -> Optimised:
    arguments: dict[str, object] = {
        "lower": -FREE, "upper": FREE, "n_waypoints": T, "search": Search(iterations=150),
    }  # fmt: skip
    admissible = options.pop("admissible", anything)
    rngs = [child_rng(0, "optimise", row) for row in rows]
    return optimise_paths(
        rngs, ANCHOR, WEIGHTS[rows], lambda w: (costs(w), admissible(w)), **(arguments | options)  # type: ignore[arg-type, operator]
    )  # fmt: skip


def closed_form(weights: FloatArray, modes: int) -> float:
    """Least cost over paths of `modes` half waves: a linear least squares problem, the same for each joint."""
    basis, line = sine_basis(T, modes, 1.0), straight_path(ANCHOR, T)
    design = np.vstack([np.sqrt(weights[0]) * np.diff(basis, axis=1).T, np.sqrt(weights[1]) * basis[:, [T // 2]].T])
    wanted = np.vstack([-np.sqrt(weights[0]) * np.diff(line, axis=0), np.sqrt(weights[1]) * (TARGET - line[T // 2])])
    z = np.linalg.lstsq(design, wanted)[0]
    return float(((design @ z - wanted) ** 2).sum())


def test_it_finds_the_known_optimum() -> None:
    found = optimise([0, 1, 2])
    best = [closed_form(weights, Search().modes) for weights in WEIGHTS]
    straight = (WEIGHTS * costs(straight_path(ANCHOR, T)[None])).sum(axis=1)
    assert best[0] == pytest.approx(straight[0])  # squared steps alone: the straight path
    assert (found.costs >= np.array(best) * (1 - 1e-12)).all()
    assert (found.costs - best < 0.005 * straight).all()
    assert (found.costs[1:] < 0.5 * straight[1:]).all()
    assert np.allclose((WEIGHTS * costs(found.waypoints)).sum(axis=1), found.costs, rtol=1e-12)
    assert found.inadmissible == 0


def test_ends_limits_and_scene_hold() -> None:
    lower, upper = np.full(J, -0.5), np.array([1.75, 0.95, 0.65])
    found = optimise([1, 2], lower=lower, upper=upper, admissible=lambda w: w[:, T // 2, 0] < 1.4)
    assert (found.waypoints[:, 0] == ANCHOR.start).all()
    assert (found.waypoints[:, -1] == ANCHOR.goal).all()
    assert (found.waypoints >= lower).all()
    assert (found.waypoints <= upper).all()
    middle = found.waypoints[:, T // 2]
    assert (middle[:, 0] < 1.4).all()
    assert (middle[:, 0] > 1.35).all()  # drawn to 1.6, it stops close before what the scene forbids
    assert 0 < found.inadmissible < 1


def test_a_further_weighting_changes_no_other() -> None:
    together = optimise([0, 1, 2])
    assert optimise([1]).waypoints.tobytes() == together.waypoints[1].tobytes()
    assert optimise([2, 0]).waypoints.tobytes() == together.waypoints[[2, 0]].tobytes()


def test_a_scene_without_a_way_is_an_error() -> None:
    with pytest.raises(StageError, match=r"no admissible path was found for weights \[1.0, 1.0\]"):
        optimise([1], admissible=lambda w: np.full(len(w), False), search=Search(iterations=2))


def test_random_weights_are_evenly_spread_directions() -> None:
    weights = random_weights(child_rng(1), 9000, 3)
    assert (weights >= 0).all()
    assert np.allclose((weights**2).sum(axis=1), 1)
    # by Archimedes each coordinate of a uniform point on the sphere is uniform
    counts = np.apply_along_axis(lambda w: np.histogram(w, bins=10, range=(0, 1))[0], 0, weights)
    assert (((counts - 900) ** 2 / 900).sum(axis=0) < 30.8).all()  # 9 degrees of freedom, p = 0.0003 each


def test_arguments_are_checked() -> None:
    with pytest.raises(ArgumentError, match="2 rngs"):
        optimise_paths(
            [child_rng(0), child_rng(1)], ANCHOR, WEIGHTS, lambda w: (costs(w), anything(w)),
            lower=-FREE, upper=FREE, n_waypoints=T,
        )  # fmt: skip
    with pytest.raises(ArgumentError, match=r"anchor.start has joint 2"):
        optimise([0], upper=np.array([2.0, 0.5, 2.0]))
    with pytest.raises(ArgumentError, match="population 3"):
        Search(population=3)
    with pytest.raises(ArgumentError, match="step_rad"):
        Search(step_rad=0)
