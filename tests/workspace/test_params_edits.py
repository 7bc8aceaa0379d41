"""An entry put into params.yaml or taken out of it: every other byte stays."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.errors import ParameterError
from pipeline.workspace.params_edits import with_entry, without_entry
from pipeline.yaml_text import plain_yaml

TEXT = (Path(__file__).resolve().parents[2] / "params.yaml").read_text(encoding="utf-8")
ENTRY = {
    "scene": "my arm/scene: 1.xml", "end_effector": "null", "joints": ["j 1", "Ärmel", "yes"], "surface": None,
    "collisions": False, "joint_names": {"a/b": "c"}, "features": {"height": {"kind": "height", "radius_m": 0.4}},
}  # fmt: skip


@pytest.mark.parametrize(
    "text", [TEXT, TEXT.replace("\n\nsimulate", "\n# about people\nsimulate"), "tasks:\n a:\n  b: 1"]
)
def test_in_and_out_again(text: str) -> None:
    added = with_entry(text, "tasks", "pour", ENTRY, {"scene": "a file", "features": "what matters"})
    assert plain_yaml(added)["tasks"]["pour"] == ENTRY  # type: ignore[index]
    lines = added.splitlines()
    assert [line for line in text.splitlines() if line not in lines] == []
    assert without_entry(added, "tasks", "pour") == (text if text.endswith("\n") else f"{text}\n")


@pytest.mark.parametrize("name", ["table", "laptop", "human"])
def test_out_of_the_middle(name: str) -> None:
    before, after = TEXT.splitlines(), without_entry(TEXT, "tasks", name).splitlines()
    start = next(i for i, line in enumerate(before) if line.startswith(f"  {name}:"))
    gone = len(before) - len(after)
    assert before[:start] + before[start + gone :] == after
    assert without_entry(TEXT, "simulate.weights", name).count("\n") == len(before) - 1


def test_the_last_one_leaves_an_empty_section() -> None:
    text = "simulate:\n  weights:  # of people\n    a: {b: 1}\n  skill: 1\n"
    assert without_entry(text, "simulate.weights", "a") == "simulate:\n  weights: {}  # of people\n  skill: 1\n"


def test_what_is_not_there_cannot_go() -> None:
    assert without_entry(TEXT, "tasks", "pour") == TEXT


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("tasks: {a: {b: 1}}\n", "in braces or empty"),
        ("other: 1\n", "has no section 'tasks'"),
        ("tasks:\n", "in braces or empty"),
    ],
)
def test_what_cannot_be_edited_line_by_line(text: str, message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        with_entry(text, "tasks", "pour", ENTRY, {})
