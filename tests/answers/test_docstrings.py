from __future__ import annotations

import doctest
import importlib

import pytest

# How many functions and classes of each module have an example that runs.
EXAMPLES = {
    "answers.verdict": 1,
    "answers.words": 2,
    "choice.prediction": 1,
    "choice.weights.draws": 1,
    "choice.weights.importance": 1,
}


@pytest.mark.parametrize("module", EXAMPLES)
def test_examples_run(module: str) -> None:
    loaded = importlib.import_module(f"pipeline.{module}")
    assert sum(bool(test.examples) for test in doctest.DocTestFinder().find(loaded)) == EXAMPLES[module]
    assert doctest.testmod(loaded).failed == 0
