"""Every field of params.yaml, one after another, with what it may not be; and YAML that means harm."""

from __future__ import annotations

import math
from collections.abc import Iterator
from copy import deepcopy
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from pipeline.errors import ParameterError
from pipeline.params import load, parse

ROOT = Path(__file__).resolve().parents[2]
DOCUMENT: dict[str, Any] = YAML(typ="safe", pure=True).load((ROOT / "params.yaml").read_text())
# sections whose keys are names that the user chooses
FREE = ("tasks", "features", "preferences", "weights", "samplers", "options", "scale")


def leaves(node: Any, path: tuple[str | int, ...] = ()) -> Iterator[tuple[tuple[str | int, ...], Any]]:
    if isinstance(node, dict):
        for key, value in node.items():
            yield from leaves(value, (*path, key))
    elif isinstance(node, list) and node and not isinstance(node[0], list):
        yield path, node
        yield from leaves(node[0], (*path, 0))
    else:
        yield path, node


def sections(node: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    if isinstance(node, dict):
        # what describes a feature is checked where the feature is bound to the scene
        if not (path and path[-1] in FREE) and not any(
            part in ("features", "preferences", "weights") for part in path[1:]
        ):
            yield path
        for key, value in node.items():
            yield from sections(value, (*path, key))


LEAVES = [(path, value) for path, value in leaves(DOCUMENT) if not {"features", "preferences"} & set(path[2:4])]
SECTIONS = list(sections(DOCUMENT))


def changed(path: tuple[str | int, ...], value: object) -> dict[str, Any]:
    document = deepcopy(DOCUMENT)
    node: Any = document
    for part in path[:-1]:
        node = node[part]
    node[path[-1]] = value
    return document


def refusal(document: object) -> str:
    with pytest.raises(ParameterError) as caught:
        parse(document)
    message = str(caught.value)
    assert "\n" not in message
    return message


def said(path: tuple[str | int, ...]) -> str:
    return ".".join(str(part) for part in path)


@pytest.mark.parametrize(("path", "value"), LEAVES, ids=[said(path) for path, _ in LEAVES])
def test_a_value_of_another_kind_is_refused_with_its_path(path: tuple[str | int, ...], value: object) -> None:
    parse(changed(path, value))
    wrong: list[object] = [{"surprise": 1}]
    if isinstance(value, bool):
        wrong += ["yes", 1, 0.0]
    elif isinstance(value, int | float):
        wrong += ["7", "many", True, math.nan, math.inf, -math.inf, -1e300, [1]]
    elif isinstance(value, str):
        wrong += [1, True, 2.5]
    for bad in wrong:
        if path[-1] == "bandwidth" and isinstance(bad, float | int) and not isinstance(bad, bool):
            continue  # a number is allowed there
        if path[-1] == "scale" and isinstance(bad, dict):
            continue  # and here numbers by feature
        message = refusal(changed(path, bad))
        assert said(path).removesuffix(".0") in message, message
        if not isinstance(bad, dict):
            assert repr(bad) in message or "given is" in message, message


@pytest.mark.parametrize("path", SECTIONS, ids=[said(path) or "the whole" for path in SECTIONS])
def test_an_unknown_key_is_refused_with_the_nearest_name(path: tuple[str, ...]) -> None:
    node: Any = DOCUMENT
    for part in path:
        node = node[part]
    known = max(node, key=len)
    message = refusal(changed((*path, f"{known}z"), 1))
    assert f"there is no parameter '{said((*path, f'{known}z'))}'" in message
    assert f"did you mean '{known}'" in message
    assert "allowed are" in refusal(changed((*path, "qqqqqqqq"), 1))


@pytest.mark.parametrize("name", ["studies", "robots", "scenes"])
def test_a_task_cannot_take_the_name_of_another_folder(name: str) -> None:
    assert f"tasks.{name}" in refusal(changed(("tasks", name), DOCUMENT["tasks"]["table"]))


BOMB = "a: &a [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{here}: &{here} [{', '.join([f'*{before}'] * 10)}]\n" for before, here in zip("abcdefgh", "bcdefghi", strict=True)
)
HARMFUL = {
    "a Python object": "seed: !!python/object/apply:os.system ['true']\n",
    "a tag of its own": "seed: !mine 3\n",
    "a key twice": "seed: 1\nseed: 2\n",
    "aliases that multiply": BOMB,
    "merges that multiply": "a0: &a0 {x: 1, y: 2}\n"
    + "".join(f"a{n}: &a{n} {{<<: [{', '.join([f'*a{n - 1}'] * 9)}]}}\n" for n in range(1, 12)),
    "an alias of itself": "seed: &a [*a]\n",
    "nesting without end": "seed: " + "[" * 20_000 + "\n",
    "more than a megabyte": "seed: 1 # " + "x" * 1_100_000 + "\n",
    "no text": b"\xff\xfe\x00seed",
    "a number of ten thousand digits": "seed: " + "9" * 10_000 + "\n",
    "no mapping": "- 1\n",
    "nothing": "",
    "two documents": "seed: 1\n---\nseed: 2\n",
    "keys that are no text": "1: 2\n",
}


@pytest.mark.parametrize("case", HARMFUL)
def test_yaml_that_means_harm_ends_in_one_sentence(tmp_path: Path, case: str) -> None:
    content = HARMFUL[case]
    path = tmp_path / "params.yaml"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(ParameterError) as caught:
        load(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("key", ["$(id)", "`", "", " ", "a\nb", "\x1b[2J", "☃", "a.b", "-"])
def test_a_key_that_is_no_word_is_named_as_it_is(key: str) -> None:
    assert f"there is no parameter {key!r}" in refusal(DOCUMENT | {key: 1})
    assert f"there is no parameter {'infer.' + key!r}" in refusal(DOCUMENT | {"infer": DOCUMENT["infer"] | {key: 1}})
