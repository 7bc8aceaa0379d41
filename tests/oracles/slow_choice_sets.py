"""Choice among grid-world paths with every model's weights summed term by term."""

from __future__ import annotations

from math import exp, log

from tests.oracles.slow_grid_world import Path, mean_distance, path_size

Vector = list[float]


def features(paths: list[Path], objects: list[tuple[int, int]]) -> list[Vector]:
    """Mean distance to each object, over its range."""
    return _over_range([[mean_distance(path, centre) for centre in objects] for path in paths])


def features_and_position(paths: list[Path], objects: list[tuple[int, int]]) -> list[Vector]:
    """The same, and mean x and mean y over their ranges."""
    means = [[sum(cell[axis] for cell in path) / len(path) for axis in (0, 1)] for path in paths]
    return [a + b for a, b in zip(features(paths, objects), _over_range(means), strict=True)]


def density(phi: list[Vector], sigma: float) -> Vector:
    """Kernel sums over all paths, the path itself included."""
    return [sum(exp(-sum((a - b) ** 2 for a, b in zip(x, y, strict=True)) / (2 * sigma**2)) for y in phi) for x in phi]


def weights(model: str, paths: list[Path], objects: list[tuple[int, int]], sigma: float) -> Vector:
    """What each model multiplies exp(reward) by."""
    phi = features(paths, objects)
    if model == "boltzmann":
        return [1.0] * len(paths)
    if model == "less":
        return [1 / d for d in density(phi, sigma)]
    if model.startswith("less-hidden"):
        return [1 / d for d in density(features_and_position(paths, objects), sigma)]
    if model == "attribute-rule":
        alike = [[all(abs(a - b) < 1e-9 for a, b in zip(x, y, strict=True)) for y in phi] for x in phi]
        return [1 / sum(row) for row in alike]
    if model == "path-size":
        return [path_size(paths, i) for i in range(len(paths))]
    raise KeyError(model)


def probabilities(w: Vector, phi: list[Vector], theta: tuple[float, float], beta: float) -> Vector:
    """p(path | theta, beta)."""
    terms = [exp(beta * (theta[0] * x[0] + theta[1] * x[1])) * v for x, v in zip(phi, w, strict=True)]
    return [term / sum(terms) for term in terms]


def posterior(likelihoods: list[Vector], drawn: list[int]) -> Vector:
    """P(theta | demonstrations) from likelihoods[theta][path], the prior being uniform."""
    joint = [exp(sum(log(row[i]) for i in drawn)) for row in likelihoods]
    return [p / sum(joint) for p in joint]


def _over_range(columns: list[Vector]) -> list[Vector]:
    ranges = [max(values) - min(values) for values in zip(*columns, strict=True)]
    return [[value / span for value, span in zip(row, ranges, strict=True)] for row in columns]
