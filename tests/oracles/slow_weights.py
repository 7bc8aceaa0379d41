"""Posteriors over continuous weights by brute force: a fine tensor grid, close together near zero and wide outside."""

from __future__ import annotations

import math

import numpy as np


def log_likelihood(
    omega: np.ndarray, features: np.ndarray, log_w: np.ndarray, chosen: np.ndarray, chosen_log_w: float, joins: bool
) -> np.ndarray:
    """(G,) of one demonstration at (G, F) points, its choice set written out."""
    terms = omega @ features.T + log_w
    own = omega @ chosen + chosen_log_w
    if joins:
        terms = np.concatenate([terms, own[:, None]], axis=1)
    peak = terms.max(axis=1)
    return own - peak - np.log(np.exp(terms - peak[:, None]).sum(axis=1))


def mixture_log_density(omega: np.ndarray, scales: tuple[float, ...]) -> np.ndarray:
    size = omega.shape[1]
    parts = [np.exp(-(omega**2).sum(axis=1) / (2 * tau**2)) / (2 * math.pi * tau**2) ** (size / 2) for tau in scales]
    return np.log(np.mean(parts, axis=0))


class Grid:
    """Points omega = sinh(u) with u on an even tensor grid, and the log volume of each cell."""

    def __init__(self, size: int, points: int, reach: float) -> None:
        u = np.linspace(-math.asinh(reach), math.asinh(reach), points)
        self.axis = np.sinh(u)
        mesh = np.stack(np.meshgrid(*[u] * size, indexing="ij"), axis=-1).reshape(-1, size)
        self.omega = np.sinh(mesh)
        self.log_volume = np.log(np.cosh(mesh)).sum(axis=1) + size * math.log(u[1] - u[0])

    def posterior(self, log_joint: np.ndarray) -> tuple[np.ndarray, float]:
        """(G,) probabilities of the cells, and the log integral."""
        total = log_joint + self.log_volume
        peak = total.max()
        p = np.exp(total - peak)
        return p / p.sum(), float(peak + math.log(p.sum()))
