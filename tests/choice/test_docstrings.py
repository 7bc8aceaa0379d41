from __future__ import annotations

import doctest
import importlib

import pytest

# How many functions and classes of each module have an example that runs.
EXAMPLES = {
    "kernel.density": 2, "kernel.bandwidth": 1, "models": 4, "likelihood": 1, "inference": 2, "held_out": 1,
    "metrics": 3,
    "hypotheses": 1, "log_sum_exp": 1,
}  # fmt: skip


@pytest.mark.parametrize("module", EXAMPLES)
def test_examples_run(module: str) -> None:
    loaded = importlib.import_module(f"pipeline.choice.{module}")
    assert sum(bool(test.examples) for test in doctest.DocTestFinder().find(loaded)) == EXAMPLES[module]
    assert doctest.testmod(loaded).failed == 0
