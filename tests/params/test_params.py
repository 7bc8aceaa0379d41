"""params.yaml: what is shipped is valid, and what is wrong is named with its path."""

from copy import deepcopy
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from pipeline.errors import ParameterError
from pipeline.params import fingerprint, load, parse, value_at

SHIPPED = Path(__file__).resolve().parents[2] / "params.yaml"


@pytest.fixture
def document() -> dict[str, Any]:
    return deepcopy(YAML(typ="safe", pure=True).load(SHIPPED.read_text()))


def test_the_shipped_parameters_are_valid_and_frozen() -> None:
    params = load(SHIPPED)
    assert list(params.tasks) == ["table", "laptop", "human"]
    assert params.infer.betas == (0.01, 0.03, 0.1, 0.3, 1, 3, 10, 30, 100)
    with pytest.raises(ValueError, match="frozen"):
        params.seed = 1  # type: ignore[misc]
    with pytest.raises(TypeError):
        params.tasks["x"] = params.tasks["table"]  # type: ignore[index]


def put(document: dict[str, Any], path: str, value: Any) -> None:
    *folders, last = path.split(".")
    for folder in folders:
        document = document[folder]
    document[last] = value


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("infer.betas", [1, -1], r"infer\.betas\.1 is -1; it should be greater than 0"),
        ("infer.betas", [1, 1], "listed twice"),
        ("infer.beta", [1], r"no parameter 'infer\.beta'; did you mean 'betas'\?"),
        ("infra", {}, r"no parameter 'infra'; did you mean 'infer'\?"),
        ("tasks.table.scen", "x", r"no parameter 'tasks\.table\.scen'; did you mean 'scene'\?"),
        ("tasks.table.thetas", [[1, 2]], r"tasks\.table: thetas\[0\] has 2 numbers, needed is one for each of the 3"),
        ("tasks.table.thetas", [], "no weight vector"),
        ("tasks.table.thetas", {"speed": [1]}, r"thetas names 'speed', which is no feature of the task; there are"),
        ("tasks.table.thetas", {"table": [1, 0, 1]}, r"thetas\.table lists a value twice"),
        ("tasks.table.thetas", {"table": []}, r"tasks\.table\.thetas"),
        ("tasks.table.features", {}, r"tasks\.table\.features"),
        ("tasks.9x", {}, "9x"),
        (
            "density.bandwidth",
            "wide",
            r"density\.bandwidth is 'wide'; it should be 'leave-one-out', 'k-fold' or 'literal'",
        ),
        ("density.bandwidth", -1, r"density\.bandwidth is -1; it should be .* or greater than 0"),
        ("ingest.waypoints", 2, r"ingest\.waypoints is 2; it should be greater than or equal to 3"),
        ("simulate.weights.table", {"speed": 1}, r"simulate\.weights\.table names 'speed'; allowed are"),
        ("simulate.weights.nowhere", {"speed": 1}, r"names the task 'nowhere'; there are"),
        ("seed", "today", "seed is 'today'"),
        ("tasks.table.features.kind", {"kind": "height"}, "a feature cannot be called 'kind'"),
        (
            "tasks.table.features.Anchor",
            {"kind": "height"},
            "'Anchor', as 'anchor' is a column of the table 'features'",
        ),
        ("tasks.table.features.PARTICIPANT", {"kind": "height"}, "'participant' is a column of the table"),
        ("tasks.table.features.Task", {"kind": "height"}, "a feature cannot be called 'Task'"),
        ("tasks.table.features.Laptop", {"kind": "height"}, "'laptop' and 'Laptop' differ in case alone"),
        ("tasks.table.thetas", [[-1, 0, 0], [0, -1, 0], [-1, 0, 0]], r"thetas\[0\] and thetas\[2\] are the same"),
        ("tasks.table.thetas", [[-1, -2, 0], [-0.1, -0.2, 0]], r"thetas\[0\] and thetas\[1\] are the same direction"),
        ("tasks.table.thetas", [[0, 0, 0], [0, 0, 0]], "would count twice"),
        ("infer.betas", [], r"infer\.betas is empty; list at least 1"),
        ("studies.grid_world.objects", [[0, 10], [1, 1]], r"studies\.grid_world: objects is .* from 0 to 9"),
        ("tasks.table.anchor", 3, r"tasks\.table\.anchor is 3; it should be 'task' or 'demonstration'"),
        ("sample.sizes", [10, 10], r"sample\.sizes: the same value is listed twice"),
        ("sample.via-point.reach_rad", -1, r"sample\.via-point\.reach_rad is -1; it should be greater than 0"),
    ],
)
def test_a_wrong_field_is_named_with_what_is_allowed(
    document: dict[str, Any], path: str, value: Any, message: str
) -> None:
    put(document, path, value)
    with pytest.raises(ParameterError, match=message) as refused:
        parse(document)
    assert "\n" not in str(refused.value)


def test_a_missing_field_is_named(document: dict[str, Any]) -> None:
    del document["tasks"]["table"]["scene"]
    with pytest.raises(ParameterError, match=r"the parameter 'tasks\.table\.scene' is missing"):
        parse(document)


def test_a_task_that_is_not_there_lists_those_that_are() -> None:
    with pytest.raises(
        ParameterError, match=r"no task 'tabel' in params\.yaml \(did you mean 'table'\?\); there are human"
    ):
        load(SHIPPED).task("tabel")


@pytest.mark.parametrize("text", ["", "[1]", "a: [", "!!python/object/apply:os.system ['true']", "\x00"])
def test_what_is_not_plain_yaml_is_refused(tmp_path: Path, text: str) -> None:
    file = tmp_path / "params.yaml"
    file.write_text(text)
    with pytest.raises(ParameterError, match=r"params\.yaml"):
        load(file)


def test_a_fingerprint_sees_a_change_and_only_that(document: dict[str, Any]) -> None:
    first = parse(document)
    put(document, "infer.betas", [1, 2])
    second = parse(document)
    assert fingerprint(first, ["sample", "seed"]) == fingerprint(second, ["sample", "seed"])
    assert fingerprint(first, ["infer"]) != fingerprint(second, ["infer"])
    assert fingerprint(first, ["infer.betas"]) != fingerprint(second, ["infer.betas"])
    assert fingerprint(first, ["infer.models"]) == fingerprint(second, ["infer.models"])


def test_every_section_has_a_fingerprint_and_parameters_have_the_names_of_the_file(document: dict[str, Any]) -> None:
    put(document, "studies.human_choice.options", {"a": ["left", "right"]})
    put(document, "features.scale", {"table": 2.0})
    parsed = parse(document)
    assert len(fingerprint(parsed, document)) == 64
    assert value_at(parsed, "sample.via-point.reach_rad") == document["sample"]["via-point"]["reach_rad"]
    assert value_at(parsed, "tasks.table.features.laptop.radius_m") == 0.4
    with pytest.raises(KeyError, match="radius"):
        value_at(parsed, "tasks.table.radius")


def test_an_overlay_says_only_what_is_different(tmp_path: Path) -> None:
    overlay = tmp_path / "mine.yaml"
    overlay.write_text("infer: {betas: [1, 2]}\ntasks: {table: {anchor: demonstration}}\n")
    plain, changed = load(SHIPPED), load(SHIPPED, overlay)
    assert changed.infer.betas == (1, 2)
    assert changed.tasks["table"].anchor == "demonstration"
    assert changed.tasks["table"].scene == plain.tasks["table"].scene
    assert changed.sample.sizes == plain.sample.sizes
    assert changed.tasks["human"] == plain.tasks["human"]
    overlay.write_text("infer: {beta: 1}\n")
    with pytest.raises(ParameterError, match=r"params\.yaml with .*mine\.yaml: there is no parameter 'infer\.beta'"):
        load(SHIPPED, overlay)
    overlay.write_text("")
    with pytest.raises(ParameterError, match="holds no parameters"):
        load(SHIPPED, overlay)


def test_opposite_directions_are_two(document: dict[str, Any]) -> None:
    put(document, "tasks.table.thetas", [[-1, 2, 0], [1, -2, 0], [0, 0, 0], [-1, 2.001, 0]])
    assert len(parse(document).tasks["table"].thetas) == 4
