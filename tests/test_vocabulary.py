"""Every word has one home, and what is registered there works."""

import ast
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pipeline import vocabulary
from pipeline.choice.models import choice_model
from pipeline.errors import ArgumentError
from pipeline.vocabulary import INFERRED_MODELS, KINDS, MODELS, REGIMES, STUDIES, WORKING, model_name

ROOT = Path(__file__).parents[1]
HOME = Path(vocabulary.__file__)

ADDED = """
from typing import Any, ClassVar
import numpy as np
from pipeline import vocabulary
vocabulary.INFERRED_MODELS = {**vocabulary.INFERRED_MODELS, "first-only": "first only"}

from pathlib import Path
from pipeline import params
from pipeline.choice import infer
from pipeline.choice.models import ChoiceModel, WeightedSet, choice_model

class FirstOnly(ChoiceModel):
    __module__ = ChoiceModel.__module__  # as if it stood there
    name: ClassVar[str] = "first-only"
    def weigh(self, compared: Any) -> WeightedSet:
        weights = np.where(np.arange(len(compared)) == 0, 0.0, -50.0)
        return WeightedSet(weights, lambda row: (weights, 0.0))

document = params.load(Path("params.yaml")).model_dump(by_alias=True)
document["infer"]["models"] = ["boltzmann", "first-only"]
label = params.parse(document).infer.models[1]
print(infer(choice_model(label, 0.1), [[0.5]], [[0.0], [1.0]], [[-1.0], [1.0]]).marginal_theta.round(3))
"""


def test_no_other_module_spells_a_word_out() -> None:
    words = {*MODELS, *REGIMES, *KINDS, WORKING, STUDIES}
    found = [
        f"{path.relative_to(ROOT)}:{node.lineno}: {node.value!r}"
        for path in sorted((ROOT / "pipeline").rglob("*.py"))
        if path != HOME
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Constant) and node.value in words
    ]
    assert found == []


@pytest.mark.parametrize("name", INFERRED_MODELS)
def test_a_model_that_can_be_inferred_weighs_features_alone(name: str) -> None:
    model = choice_model(name, 0.3)
    assert model.name == name
    assert np.isfinite(model.weigh(np.array([[0.0, 1.0], [1.0, 0.0]])).log_w).all()


def test_the_bandwidth_reaches_the_model_that_has_one() -> None:
    assert vars(choice_model(vocabulary.LESS, 0.3)) == {"bandwidth": 0.3}
    with pytest.raises(
        ArgumentError, match="there is no model 'lss'; there are attribute-rule, boltzmann, less, path-size"
    ):
        choice_model("lss", 0.3)


def test_a_model_is_added_by_its_class_and_its_line_in_the_vocabulary() -> None:
    answer = subprocess.run(
        [sys.executable, "-c", ADDED], capture_output=True, text=True, check=True, cwd=ROOT, timeout=120
    )
    # Under this model only the first alternative (0) and the demonstration (0.5) can be chosen.
    ends = np.exp([-0.5, 0.5]) / (1 + np.exp([-0.5, 0.5]))
    assert answer.stdout.strip() == str((ends / ends.sum()).round(3))


def test_a_model_that_is_not_listed_goes_by_its_own_name() -> None:
    assert (model_name("less"), model_name("my-model")) == ("LESS", "my-model")
