from __future__ import annotations

import dataclasses
import itertools
import os
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import polars as pl
import pytest
import rerun as rr
from PIL import Image
from rerun.chunk import RrdReader

from pipeline.errors import ArgumentError, StageError
from pipeline.replay import load_scene
from pipeline.replay.geometry import body_poses, extract_geometry
from pipeline.views import palette
from pipeline.views.feature_axis import FeatureAxis
from pipeline.views.rerun.density import ticks
from pipeline.views.rerun.labels import drawable
from pipeline.views.rerun.layout import camera, hidden
from pipeline.views.rerun.posterior import bounds_of_any, page
from pipeline.views.rerun.recording import open_viewer, quiet_environment, viewer_command, write_inspection
from pipeline.views.rerun.records import (
    AlternativeSet,
    FeatureSpace,
    Inspection,
    Motions,
    Predicted,
    Replay,
    Weights,
)
from pipeline.views.rerun.robustness import decades
from pipeline.views.rerun.timelines import DEMONSTRATIONS, TIMELINE
from pipeline.views.task_summary import density_curve, density_map, replay_samples, theta_labels, theta_meaning
from tests.support.live_viewer import not_blank, pictures

ROOT = Path(__file__).resolve().parents[3]
RERUN = viewer_command()[0]
ARM = """
<mujoco>
  <compiler angle="radian"/>
  <asset><mesh name="wedge" vertex="0 0 0  0.1 0 0  0 0.1 0  0 0 0.1"/></asset>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 0.1"/>
    <body name="table" pos="0.5 0 0.1"><geom name="board" type="box" size="0.3 0.3 0.02"/></body>
    <body name="base" pos="0 0 0.1">
      <geom name="foot" type="cylinder" size="0.05 0.1"/>
      <body name="upper" pos="0 0 0.1">
        <joint name="shoulder" axis="0 0 1"/>
        <geom name="tube" type="capsule" fromto="0 0 0 0.3 0 0" size="0.03"/>
        <body name="fore" pos="0.3 0 0">
          <joint name="elbow" axis="0 1 0"/>
          <geom name="egg" type="ellipsoid" pos="0.1 0 0" size="0.1 0.02 0.03"/>
          <geom name="ball" type="sphere" pos="0.2 0 0" size="0.03"/>
          <geom name="wedge" type="mesh" mesh="wedge"/>
          <site name="tip" pos="0.25 0 0"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.fixture(autouse=True)
def _strict(monkeypatch):
    monkeypatch.setenv("RERUN_STRICT", "1")
    rr.set_strict_mode(True)
    yield
    rr.set_strict_mode(False)


@pytest.fixture(scope="module")
def inspection(tmp_path_factory) -> Inspection:
    path = tmp_path_factory.mktemp("scene") / "arm.xml"
    path.write_text(ARM)
    scene = load_scene(path, end_effector="tip")
    rng = np.random.default_rng(5)
    demonstrations = np.cumsum(rng.normal(0, 0.1, (3, 11, 2)), axis=1)
    configurations, time_s, which = replay_samples(demonstrations, np.array([2.0, 1.0, 3.0]))
    positions, quaternions = body_poses(scene, configurations)
    features = rng.normal(size=(200, 2)) * [1.0, 5.0]
    mine, log_weights = features[:3] + 0.1, rng.normal(size=200)
    curves = tuple(
        density_curve(name, unit, features[:, i], mine[:, i], 0.3, log_weights)
        for i, (name, unit) in enumerate([("effort", "rad²"), ("height", "m")])
    )
    thetas = -np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]) / np.array([[1.0], [1.0], [np.sqrt(2)]])
    return Inspection(
        task="reach",
        replay=Replay(extract_geometry(scene.model), positions, quaternions, time_s, which),
        demonstration_ids=("ann 1", "ann 2", "bob 漢"),
        demonstration_paths=rng.normal(0, 0.3, (3, 11, 3)),
        motions=Motions(
            ("shoulder", "elbow"),
            ("rad", "rad"),
            (FeatureAxis("effort", "rad²"), FeatureAxis("height", "m", "mean per waypoint", 10.0)),
            demonstrations,
            np.stack([np.full((3, 11), np.nan), rng.normal(size=(3, 11))], axis=2),
            mine,
        ),
        alternatives=(
            AlternativeSet(
                ("working",), ("wide", "near") * 20, rng.normal(0, 0.3, (40, 11, 3)), log_weights[:40], True
            ),
            AlternativeSet(("sets of 3", "set 漢"), ("wide",) * 3, rng.normal(0, 0.3, (3, 11, 3)), log_weights[:3]),
        ),
        curves=curves,
        map=density_map(("effort", "height"), ("rad²", "m"), features, mine, np.array([0.3, 1.5])),
        space=FeatureSpace(
            ("effort (rad²)", "height (m, mean per waypoint)", "reach (m, greatest)"),
            rng.normal(size=(200, 3)),
            log_weights,
            rng.normal(size=(3, 3)),
            {"less": np.array([-1.0, 0.0, 0.0])},
            np.array([0.0, -1.0, 0.0]),
        ),
        theta_labels=theta_labels(thetas, ["effort", "height"]),
        theta_meaning=theta_meaning(thetas),
        posteriors={
            "boltzmann": np.array([[1 / 3] * 3, [0.5, 0.3, 0.2], [0.6, 0.3, 0.1], [0.7, 0.2, 0.1]]),
            "less": np.array([[1 / 3] * 3, [0.2, 0.6, 0.2], [0.1, 0.8, 0.1], [0.05, 0.9, 0.05]]),
        },
        robustness=pl.DataFrame(
            {
                "regime": ["independent"] * 4 + ["sampler-shift"] * 2,
                "model": ["boltzmann", "boltzmann", "less", "less", "boltzmann", "less"],
                "set_size": [10, 100, 10, 100, 10, 10],
                "value": [10.0, 1.0, 9.0, 0.5, 30.0, 20.0],
                "low": [8.0, None, 7.0, 0.4, 28.0, 18.0],
                "high": [12.0, None, 11.0, 0.6, 32.0, 22.0],
            }
        ),
        weights=Weights(
            ("effort", "height"),
            pl.DataFrame(
                {
                    "model": ["less", "less"],
                    "feature": ["height", "effort"],
                    "low": [-0.9, -0.6],
                    "median": [-0.8, -0.2],
                    "high": [-0.7, 0.3],
                }
            ),
            np.array([-0.6, -0.8]),
        ),
        nearest_truth=1,
        predicted={
            model: Predicted(*np.sort(rng.normal(0, 0.3, (3, 11, 3)), axis=0), likely=rng.normal(0, 0.3, (2, 11, 3)))
            for model in ("boltzmann", "less")
        },
        summary="# reach\nThree demonstrations, 200 alternatives. ≈ 漢字 █",
    )


@pytest.fixture(scope="module")
def recording(inspection, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("recording") / "inspect.rrd"
    write_inspection(path, inspection)
    return path


@pytest.fixture(scope="module")
def chunks(recording) -> dict:
    """Entity path -> the record batches logged there."""
    found: dict = {}
    for chunk in RrdReader(recording).stream():
        found.setdefault(chunk.entity_path, []).append(chunk)
    return found


def cli(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [RERUN, *map(str, arguments)]
    return subprocess.run(command, env=quiet_environment(), capture_output=True, text=True, timeout=60, check=False)


def column(chunk, component: str) -> list:
    batch = chunk.to_record_batch()
    name = next(name for name in batch.schema.names if name.endswith(f":{component}"))
    return batch.column(name).to_pylist()


def logged(chunk, component: str) -> list:
    """The rows in which a component has a value; none where the chunk has no such component."""
    batch = chunk.to_record_batch()
    found = [name for name in batch.schema.names if name.endswith(f":{component}")]
    return [row for name in found for row in batch.column(name).to_pylist() if row is not None]


def lines(chunk) -> list:
    return logged(chunk, "strips")


def names(chunk) -> list:
    return logged(chunk, "labels")


def test_shapes_and_paths_and_charts_are_all_there(chunks, inspection):
    expected = {
        "/scene/bodies/world/floor": "Boxes3D:half_sizes",
        "/scene/bodies/table/board": "Boxes3D:half_sizes",
        "/scene/bodies/base/foot": "Cylinders3D:lengths",
        "/scene/bodies/upper/tube": "Capsules3D:lengths",
        "/scene/bodies/fore/egg": "Ellipsoids3D:half_sizes",
        "/scene/bodies/fore/ball": "Ellipsoids3D:half_sizes",
        "/scene/bodies/fore/wedge": "Mesh3D:vertex_positions",
        "/scene/alternatives/working/wide": "LineStrips3D:strips",
        "/scene/alternatives/working/near": "LineStrips3D:strips",
        "/scene/alternatives/sets\\ of\\ 3/set\\ \\?/wide": "LineStrips3D:strips",
        "/scene/demonstrations": "LineStrips3D:strips",
        "/scene/predicted/less/median": "LineStrips3D:strips",
        "/scene/predicted/boltzmann/interval": "Boxes3D:half_sizes",
        "/scene/predicted/less/likely": "LineStrips3D:strips",
        "/density/effort/alternatives": "LineStrips2D:strips",
        "/density/height/weighted_by_less": "LineStrips2D:strips",
        "/map/density": "Image:buffer",
        "/map/demonstrations": "Points2D:positions",
        "/posterior/boltzmann/final": "LineStrips2D:strips",
        "/posterior/names": "Points2D:labels",
        "/space/alternatives": "Points3D:positions",
        "/space/demonstrations": "Points3D:positions",
        "/robustness/one\\ sampler/less/intervals": "LineStrips2D:strips",
        "/robustness/different\\ samplers/boltzmann": "LineStrips2D:strips",
        "/weights/less/median": "Points2D:positions",
        "/summary": "TextDocument:text",
    }
    for entity, component in expected.items():
        (chunk,) = chunks[entity]
        assert chunk.is_static, entity
        assert component in chunk.to_record_batch().schema.names, (entity, chunk.to_record_batch().schema.names)
    assert len(column(chunks["/scene/alternatives/working/wide"][0], "strips")[0]) == 20
    assert len(column(chunks["/scene/demonstrations"][0], "strips")[0]) == 3
    # a box at every fourth of 11 waypoints
    boxes = np.array(column(chunks["/scene/predicted/less/interval"][0], "half_sizes")[0])
    predicted = inspection.predicted["less"]
    np.testing.assert_allclose(boxes, (predicted.high - predicted.low)[::4] / 2, atol=1e-6)


def test_a_body_moves_as_replayed_and_what_rests_is_logged_once(chunks, inspection):
    (chunk,) = chunks["/scene/bodies/fore"]
    assert chunk.num_rows == len(inspection.replay.time_s) == 3 * 51
    body = inspection.replay.geometry.body_names.index("fore")
    logged = np.array(column(chunk, "translation"))[:, 0]
    np.testing.assert_allclose(logged, inspection.replay.body_positions[:, body], atol=1e-7)
    xyzw = np.array(column(chunk, "quaternion"))[:, 0]
    np.testing.assert_allclose(xyzw[:, [3, 0, 1, 2]], inspection.replay.body_quaternions[:, body], atol=1e-7)
    seconds = chunk.to_record_batch().column(TIMELINE).cast("int64").to_numpy() / 1e9
    np.testing.assert_allclose(seconds, inspection.replay.time_s, atol=1e-9)
    assert chunks["/scene/bodies/table"][0].is_static


def test_a_capsule_starts_at_its_lower_cap(chunks):
    (chunk,) = chunks["/scene/bodies/upper/tube"]
    # along x from the body's origin: Rerun puts the start of the axis at the translation
    assert column(chunk, "lengths")[0] == pytest.approx([0.3])
    foot = np.array(column(chunk, "translations")[0][0])
    x, y, z, w = column(chunk, "quaternions")[0][0]
    axis = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
    np.testing.assert_allclose(sorted([foot[0], (foot + 0.3 * axis)[0]]), [0.0, 0.3], atol=1e-6)


def test_bars_are_as_long_as_their_probabilities(chunks, inspection):
    layout = page(inspection)
    chart, order = layout.chart, layout.rows.order
    assert chart.full == 1.0
    assert [inspection.theta_labels[k] for k in order] == ["height", "effort", "effort + height"]
    assert names(chunks["/posterior/names"][0])[0][:3] == ["true: height", "effort", "effort + height"]
    (chunk,) = chunks["/posterior/less/bars"]
    assert chunk.num_rows == 4
    for step, (strips, radii) in enumerate(zip(column(chunk, "strips"), column(chunk, "radii"), strict=True)):
        ends = np.array(strips)[:, :, 0]
        lengths = ends[:, 1] - ends[:, 0] + 2 * np.array(radii)
        np.testing.assert_allclose(lengths / chart.full_length, inspection.posteriors["less"][step][order], atol=1e-5)
        np.testing.assert_allclose(ends[:, 0] - np.array(radii), chart.left(1), atol=1e-3)
    seconds = chunk.to_record_batch().column(TIMELINE).cast("int64").to_numpy() / 1e9
    np.testing.assert_allclose(seconds, [0.0, 2.0, 3.5, 7.0])


def test_a_long_list_of_hypotheses_ends_with_the_rest_together(inspection):
    posterior = np.full((4, 50), 0.01)
    posterior[:, :2] = 0.3, 0.22
    many = dataclasses.replace(
        inspection, theta_labels=tuple(f"theta {k}" for k in range(50)), posteriors={"less": posterior}
    )
    layout = page(many)
    values = layout.rows.values(posterior[-1])
    assert (len(layout.rows.order), layout.rows.others, values.size) == (10, 40, 11)
    assert values[-1] == pytest.approx(0.40)
    assert layout.rows.names(many.theta_labels)[-1] == "the other 40 together"
    assert layout.chart.full == 0.5


def test_the_sum_of_what_is_left_out_is_said_however_small(inspection, tmp_path):
    posterior = np.array([[1 / 3] * 3] * 3 + [[0.9999, 0.00009, 0.00001]])
    sure = dataclasses.replace(inspection, posteriors={"less": posterior}, nearest_truth=None)
    write_inspection(tmp_path / "sure.rrd", sure)
    found = list(RrdReader(tmp_path / "sure.rrd").stream())
    rows = [name for chunk in found if chunk.entity_path == "/posterior/names" for name in names(chunk)]
    assert rows[0][:2] == ["effort", "the other 2 together"]
    said = [name for chunk in found if chunk.entity_path == "/posterior/less/values" for name in names(chunk)]
    assert said == [["0.33", "0.67"]] * 3 + [["1.00", "<0.01"]]


def test_the_path_draws_with_the_hand_of_the_demonstration_that_plays(chunks, inspection):
    strips = next(chunk for chunk in chunks["/scene/playing"] if lines(chunk))
    drawn = [np.array(rows[0]) for chunk in chunks["/scene/playing"] for rows in lines(chunk)]
    assert [len(line) for line in drawn] == [2, *range(2, 12)] * 3
    for demonstration, path in enumerate(inspection.demonstration_paths):
        np.testing.assert_allclose(drawn[11 * demonstration + 10], path, atol=1e-6)
    seconds = strips.to_record_batch().column(TIMELINE).cast("int64").to_numpy() / 1e9
    np.testing.assert_allclose(seconds[:11], np.linspace(0.0, 2.0, 11), atol=1e-9)


def test_the_name_is_above_the_hand_and_not_on_what_it_holds(chunks):
    hand, name = (
        np.concatenate(
            [
                np.array(logged(chunk, "positions"))[:, 0]
                for chunk in chunks[f"/scene/playing/{one}"]
                if logged(chunk, "positions")
            ]
        )
        for one in ("hand", "name")
    )
    np.testing.assert_allclose(hand[:, :2], name[:, :2], atol=1e-6)
    assert (name[:, 2] - hand[:, 2] > 0.1).all()


def steps_of(chunk) -> list:
    return chunk.to_record_batch().column(DEMONSTRATIONS).to_pylist()


def test_each_step_of_the_other_timeline_is_one_demonstration(chunks):
    assert steps_of(chunks["/scene/bodies/fore"][0]) == [0] + [1] * 50 + [2] * 51 + [3] * 51
    assert steps_of(chunks["/posterior/less/bars"][0]) == [0, 1, 2, 3]
    assert [step for chunk in chunks["/scene/playing"] if lines(chunk) for step in steps_of(chunk)] == (
        [1] * 11 + [2] * 11 + [3] * 11
    )


def scalars(found, timeline) -> dict:
    """Time on a timeline -> value, of all chunks that have it."""
    values = {}
    for chunk in found:
        if not chunk.is_static and timeline in chunk.timeline_names:
            times = chunk.to_record_batch().column(timeline).cast("int64").to_pylist()
            values |= {time: row[0] if row else None for time, row in zip(times, column(chunk, "scalars"), strict=True)}
    return values


def test_the_belief_is_plotted_against_the_demonstrations_and_the_clock(chunks, inspection):
    for model, steps in inspection.posteriors.items():
        for k in range(3):
            found = chunks[f"/series/belief/{model}/{k}"]
            assert list(scalars(found, DEMONSTRATIONS)) == [0, 1, 2, 3]
            np.testing.assert_allclose(list(scalars(found, DEMONSTRATIONS).values()), steps[:, k])
            np.testing.assert_allclose(np.array(list(scalars(found, TIMELINE))) / 1e9, [0.0, 2.0, 3.5, 7.0])
        left = list(scalars(chunks[f"/series/belief/plausible/{model}"], DEMONSTRATIONS).values())
        np.testing.assert_allclose(left, np.exp(-(steps * np.log(steps)).sum(axis=1)))
    (name,) = [row for chunk in chunks["/series/belief/less/1"] for row in logged(chunk, "names") if chunk.is_static][
        :1
    ]
    assert name == ["true: height"]


def test_joints_and_features_are_plotted_along_each_demonstration(chunks, inspection):
    motions = inspection.motions
    elbow = scalars(chunks["/series/joints/elbow"], TIMELINE)
    rows = np.array(list(elbow.values()), dtype=object).reshape(3, 12)
    np.testing.assert_allclose(rows[:, :11].astype(float), motions.waypoints[:, :, 1])
    assert (rows[:, 11] == None).all()  # noqa: E711  # so that no line leads from one demonstration to the next
    along = scalars(chunks["/series/features/height/ann\\ 2"], TIMELINE)
    np.testing.assert_allclose(list(along.values()), motions.along[1, :, 1])
    np.testing.assert_allclose(np.array(list(along)) / 1e9, np.linspace(2.5, 3.5, 11))
    each = scalars(chunks["/series/features/height/each\\ demonstration"], DEMONSTRATIONS)
    assert each == pytest.approx({step + 1: motions.raw[step, 1] / 10 for step in range(3)})
    assert not scalars(chunks["/series/features/effort/ann\\ 2"], TIMELINE)  # it has no value at a waypoint


def test_the_truth_is_marked_in_the_weights_and_among_the_features(chunks, inspection):
    low, high = (chunks["/weights/less/interval"][0], chunks["/weights/truth"][0])
    ends = np.array(lines(low)[0])[:, :, 0]  # (F, 2), in the order of the features and not of the table
    truth = np.array(lines(high)[0])[:, 0, 0]
    across = np.interp(np.concatenate([ends.ravel(), truth]), [130.0, 550.0], [-1.0, 1.0])
    np.testing.assert_allclose(across, [-0.6, 0.3, -0.9, -0.7, -0.6, -0.8], atol=1e-5)
    arrows = {
        name: np.array(logged(chunks[f"/space/wanted/{name}"][0], "vectors"))[0, 0] for name in ("LESS", "the\\ truth")
    }
    assert arrows["LESS"] == pytest.approx([-0.4, 0.0, 0.0])
    assert arrows["the\\ truth"] == pytest.approx([0.0, -0.4, 0.0])


def test_where_nobody_knows_the_truth_nothing_is_marked(inspection, tmp_path):
    space = dataclasses.replace(inspection.space, truth=None)
    weights = dataclasses.replace(inspection.weights, truth=None)
    blind = dataclasses.replace(inspection, nearest_truth=None, space=space, weights=weights)
    write_inspection(tmp_path / "blind.rrd", blind)
    found = list(RrdReader(tmp_path / "blind.rrd").stream())
    assert not {"/weights/truth", "/space/wanted/the\\ truth"} & {chunk.entity_path for chunk in found}
    said = [name for chunk in found for kind in ("labels", "names") for name in logged(chunk, kind)]
    assert said
    assert not [text for row in said for text in row if "tru" in text]


def test_the_camera_turns_aside_where_the_arm_would_point_at_it():
    base, viewpoint = np.zeros(3), np.array([2.0, 0.0, 1.0])
    box = np.array([[-0.5, -0.5, 0.0], [0.5, 0.5, 1.0]])
    ahead = np.array([[1.0, y, 0.3] for y in np.linspace(-0.2, 0.2, 20)])
    for hands, least in ((ahead, 50.0), (ahead @ np.diag([-1.0, 1.0, 1.0]), 0.0), (None, 0.0)):
        position, target = camera(box, base, viewpoint, hands)
        turned = abs(np.degrees(np.arctan2(*(position - target)[1::-1])))
        assert least - 1e-9 <= turned <= least + 15.0
        assert (position - target)[2] > 0


def test_a_set_of_alternatives_that_does_not_fit_is_refused():
    with pytest.raises(ArgumentError, match="working must be finite"):
        AlternativeSet(("working",), ("wide",), np.full((1, 2, 3), np.nan), np.zeros(1))
    with pytest.raises(ArgumentError, match="working needs a name and 1 samplers; got 2"):
        AlternativeSet(("working",), ("wide", "near"), np.zeros((1, 2, 3)), np.zeros(1))
    with pytest.raises(ArgumentError, match=r"alternatives of the feature space must have shape \(4, 3\)"):
        FeatureSpace(("a", "b", "c"), np.zeros((3, 3)), np.zeros(4), np.zeros((1, 3)))


def test_sets_that_are_not_shown_wait_in_the_tree(inspection):
    assert hidden(inspection.alternatives) == ["scene/alternatives/sets\\ of\\ 3/set\\ \\?"]


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [
        (0.5, 30.0, [0.3, 1, 3, 10, 30]),
        (1.0, 1.0, [1, 3]),
        (20.0, 25.0, [10, 30]),
        (0.02, 300.0, [0.01, 0.1, 1, 10, 100, 1000]),
    ],
)
def test_logarithmic_axes_end_on_round_numbers(low, high, expected):
    assert decades(low, high).tolist() == pytest.approx(expected)


def test_text_has_the_numbers_and_only_characters_that_can_be_drawn(chunks):
    text = column(chunks["/summary"][0], "text")[0][0]
    assert text.startswith("# reach\nThree demonstrations, 200 alternatives. ≈ ?? ?")
    assert "| true: height | 0.200 | 0.900 |" in text
    labels = [name for chunk in chunks["/scene/playing/name"] for name in names(chunk)]
    assert labels == [["ann 1"], ["ann 2"], ["bob ?"]]


def test_two_writes_are_equal_and_whole(recording, inspection, tmp_path):
    again = tmp_path / "inspect.rrd"
    again.write_text("an older one")
    write_inspection(again, inspection)
    compared = cli("rrd", "compare", recording, again)
    assert compared.returncode == 0, compared.stderr
    verified = cli("rrd", "verify", again)
    assert verified.returncode == 0, verified.stderr
    assert list(tmp_path.iterdir()) == [again]
    assert again.stat().st_size < 2_000_000


def test_another_inspection_is_told_apart(recording, inspection, tmp_path):
    other = {**inspection.posteriors, "less": np.roll(inspection.posteriors["less"], 1, axis=1)}
    write_inspection(tmp_path / "other.rrd", dataclasses.replace(inspection, posteriors=other))
    assert cli("rrd", "compare", recording, tmp_path / "other.rrd").returncode != 0


def test_nothing_inside_says_when_it_was_written(chunks):
    # `rerun rrd compare` does not look at properties
    assert [entity for entity in chunks if entity.startswith("/__properties")] == ["/__properties/task"]
    timelines = {name for found in chunks.values() for chunk in found for name in chunk.timeline_names}
    assert timelines == {TIMELINE, DEMONSTRATIONS}


def test_the_layout_is_inside(recording):
    reader = RrdReader(recording)
    assert [(store.application_id, store.recording_id) for store in reader.recordings()] == [
        ("lessbench reach", "reach")
    ]
    (blueprint,) = reader.blueprints()
    assert blueprint.application_id == "lessbench reach"


def test_an_interrupted_write_leaves_the_old_file(inspection, tmp_path, monkeypatch):
    path = tmp_path / "inspect.rrd"
    path.write_text("an older one")

    def stop(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("pipeline.views.rerun.posterior.log_posteriors", stop)
    with pytest.raises(KeyboardInterrupt):
        write_inspection(path, inspection)
    assert path.read_text() == "an older one"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"demonstration_paths": np.zeros((2, 11, 3))}, r"demonstration_paths must have shape \(3, any, 3\)"),
        ({"posteriors": {"less": np.zeros((3, 3))}}, r"posteriors\['less'\] must have shape \(4, 3\); got \(3, 3\)"),
        ({"alternatives": ()}, "one set of alternatives"),
        ({"curves": ()}, "at least one"),
    ],
)
def test_an_inspection_that_does_not_fit_together_is_refused(inspection, change, match):
    with pytest.raises(ArgumentError, match=match):
        dataclasses.replace(inspection, **change)


def test_no_recording_and_no_display_are_said_plainly(recording, tmp_path, monkeypatch):
    with pytest.raises(StageError, match="does not exist; `dvc repro`"):
        open_viewer(tmp_path / "inspect.rrd")
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(StageError, match=r"no display here.*run `rerun inspect.rrd` there"):
        open_viewer(recording)


def test_the_viewer_is_local_and_quiet_and_gone_afterwards(recording, tmp_path, monkeypatch):
    seen = tmp_path / "seen"
    fake = tmp_path / "viewer"
    fake.write_text(f'#!/bin/sh\necho "$$ $CI $HTTPS_PROXY $@" > {seen}\nexit 3\n')
    fake.chmod(0o755)
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr("pipeline.views.rerun.recording.viewer_command", lambda: [str(fake), *viewer_command()[1:]])
    with pytest.raises(StageError, match="status 3"):
        open_viewer(recording)
    pid, said = seen.read_text().split(" ", 1)
    assert said.split() == [
        "true", "http://127.0.0.1:9", "--bind", "127.0.0.1", "--port", "auto", "--hide-welcome-screen", str(recording),
    ]  # fmt: skip
    with pytest.raises(ProcessLookupError):
        os.kill(int(pid), 0)


def test_no_view_reports_an_error_at_any_time(recording, inspection, tmp_path):
    with pictures().headless_viewer(recording) as viewer:
        shots = []
        for place, time_s in enumerate((0.0, 3.0, float(inspection.end_s[-1]))):
            viewer.set_time(timeline=TIMELINE, duration=time_s, play_state="paused")
            time.sleep(1.0)
            state = viewer.get_state()
            assert len(state.views) == 16
            assert [view.reports for view in state.views if view.reports] == []
            viewer.save_screenshot(str(tmp_path / f"{place}.png"))
            shots.append(not_blank(tmp_path / f"{place}.png"))
    # the arm and the bars are elsewhere at another time
    width = shots[0].shape[1] // 2
    for earlier, later in itertools.pairwise(shots):
        assert (earlier[:, :width] != later[:, :width]).any()
        assert (earlier[:, width:] != later[:, width:]).any()


@pytest.mark.parametrize("size", ["1280x720", "1600x900", "1920x1080"])
def test_it_is_readable_with_all_panels_open(recording, inspection, tmp_path, size):
    with pictures().headless_viewer(recording, size) as viewer:
        for panel in ("ui.toggle_blueprint_panel", "ui.toggle_selection_panel", "recording.toggle_time_panel"):
            viewer.run_command(panel)
        pictures().show_moment(viewer, 3.0)
        time.sleep(2.0)
        views = viewer.get_state().views
        assert [view.reports for view in views if view.reports] == []
        seen = {}
        for view in views:
            if view.name.startswith(("Posterior", "P(theta), LESS", "effort", "Demonstrations", "Numbers")):
                viewer.save_screenshot(str(tmp_path / "view.png"), view_id=view.view_id)
                with Image.open(tmp_path / "view.png") as shown:
                    seen[view.name.split()[0].rstrip(",:")] = shown.size
        viewer.save_screenshot(str(tmp_path / "all.png"))
    not_blank(tmp_path / "all.png")
    assert set(seen) == {"Posterior", "P(theta)", "effort", "Demonstrations", "Numbers"}
    for name, (width, height) in seen.items():
        assert width >= 230, (name, width)
        assert height >= 130, (name, height)
    # the rows of a full chart are further apart than its letters are high, and its names have room
    (left, right), (top, bottom) = bounds_of_any(tuple(inspection.posteriors), 100)
    scale = min(seen["Posterior"][0] / (right - left), seen["Posterior"][1] / (bottom - top))
    chart = page(inspection).chart
    assert scale * chart.row >= 16
    assert scale * chart.names_width >= 210


def test_every_model_has_its_own_color():
    names = (*palette.MODELS, "other", "another")
    colors = [palette.model_color(name, names) for name in names]
    assert len(set(colors)) == len(names)
    assert palette.DEMONSTRATION not in colors
    assert not set(palette.SETS.values()) & set(palette.MODELS.values())


def test_the_scales_run_from_dark_to_light():
    for scale in (palette.sequential, palette.path_colors):
        luma = scale(np.linspace(-1, 1, 50), -1.0, 1.0) @ np.array([0.2126, 0.7152, 0.0722])
        assert (np.diff(luma) > 0).all()
        assert scale(np.array([2.0]), -1.0, 1.0).tolist() == scale(np.array([1.0]), -1.0, 1.0).tolist()
        assert len(np.unique(scale(np.zeros(3), 0.0, 0.0), axis=0)) == 1


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [(0.0, 1.0, [0, 0.25, 0.5, 0.75, 1]), (-0.7, 7.1, [0, 2, 4, 6]), (-3.0, 33.0, [0, 10, 20, 30])],
)
def test_ticks_are_round_numbers(low, high, expected):
    assert ticks(low, high).tolist() == expected
    assert not re.search("-0$", f"{ticks(low, high)[0]:g}")


def test_greek_and_fractions_are_drawn_and_the_unknown_is_marked():
    assert drawable("θ = ½ rad², Zoë\n") == "θ = ½ rad², Zoë\n"
    assert drawable("漢\t█") == "???"
