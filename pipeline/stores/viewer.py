"""One task as a recording for the Rerun viewer: the arm replaying, the paths, the densities, the posteriors, the numbers.

The recording is a picture of what the tables hold; Parquet stays the source of truth (Rerun promises to read a `.rrd`
only one version on). Written twice from the same inspection, `rerun rrd compare` finds the two files equal.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from pipeline.errors import ArgumentError, StageError

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from rerun import RecordingStream
    from rerun.blueprint import Blueprint

    from pipeline.replay.geometry import Geometry
    from pipeline.studies.inspection import DensityCurve, DensityMap

    Floats = NDArray[np.float64]

TIMELINE = "replay"
_UNREACHABLE = "http://127.0.0.1:9"


@dataclass(frozen=True)
class Replay:
    """The demonstrations played one after another.

    Attributes:
        geometry: the shapes of the arm and its scene.
        body_positions: (M, B, 3) m, world frame, bodies as in the geometry.
        body_quaternions: (M, B, 4) wxyz, world frame.
        time_s: (M,) strictly increasing.
        demonstration: (M,) row of the demonstration that each sample belongs to, 0..n-1, none skipped.
    """

    geometry: Geometry
    body_positions: Floats
    body_quaternions: Floats
    time_s: Floats
    demonstration: NDArray[np.int64]


@dataclass(frozen=True)
class Inspection:
    """Everything that the recording of one task shows; nothing in it is computed here.

    Attributes:
        task: its name.
        replay: the arm over time.
        demonstration_ids: (n,) in the order of the replay.
        demonstration_paths: (n, T, 3) m, of the end effector in the world's frame.
        alternative_paths: (A, T', 3) m, likewise, of as many alternatives as are to be drawn (300 are plenty).
        alternative_log_weights: (A,) LESS's log weight of each.
        curves: at least one; the first is shown first.
        map: the density over two features.
        theta_labels: (K,) the hypotheses in words.
        theta_meaning: what the numbers in the labels are.
        posteriors: by model, (n + 1, K): row k after the first k demonstrations, row 0 the prior; each sums to one.
        summary: Markdown: the task, the numbers and where they came from.
    """

    task: str
    replay: Replay
    demonstration_ids: tuple[str, ...]
    demonstration_paths: Floats
    alternative_paths: Floats
    alternative_log_weights: Floats
    curves: tuple[DensityCurve, ...]
    map: DensityMap
    theta_labels: tuple[str, ...]
    theta_meaning: str
    posteriors: Mapping[str, Floats]
    summary: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "posteriors", MappingProxyType(dict(self.posteriors)))
        n, k = len(self.demonstration_ids), len(self.theta_labels)
        replay, bodies = self.replay, len(self.replay.geometry.body_names)
        samples = len(replay.time_s)
        if not self.curves or not self.posteriors or n == 0:
            raise ArgumentError("an inspection needs at least one demonstration, one density curve and one model.")
        _check_shape("demonstration_paths", self.demonstration_paths, (n, None, 3))
        _check_shape("alternative_paths", self.alternative_paths, (len(self.alternative_log_weights), None, 3))
        _check_shape("replay.body_positions", replay.body_positions, (samples, bodies, 3))
        _check_shape("replay.body_quaternions", replay.body_quaternions, (samples, bodies, 4))
        for model, posterior in self.posteriors.items():
            _check_shape(f"posteriors[{model!r}]", posterior, (n + 1, k))
        if not (np.diff(replay.time_s) > 0).all():
            raise ArgumentError("replay.time_s must increase strictly; it does not.")
        if not np.array_equal(np.unique(replay.demonstration), np.arange(n)):
            raise ArgumentError(f"replay.demonstration must name each of the {n} demonstrations 0..{n - 1}.")

    @property
    def end_s(self) -> Floats:
        """(n,) when each demonstration has been played."""
        return np.array(
            [self.replay.time_s[self.replay.demonstration == i][-1] for i in range(len(self.demonstration_ids))]
        )

    @property
    def start_s(self) -> Floats:
        """(n,) when each demonstration begins to play."""
        return np.array(
            [self.replay.time_s[self.replay.demonstration == i][0] for i in range(len(self.demonstration_ids))]
        )


def write_inspection(path: Path, inspection: Inspection) -> None:
    """Write the recording with its layout inside, whole or not at all.

    Args:
        path: `datasets/<task>/inspect.rrd`.
        inspection: what to show.
    """
    import rerun as rr

    from pipeline.stores.blueprint import layout
    from pipeline.stores.viewer_charts import log_densities, log_summary
    from pipeline.stores.viewer_posteriors import log_posteriors
    from pipeline.stores.viewer_scene import log_scene

    with written_recording(path, inspection.task, layout(inspection)) as recording:
        recording.send_property("task", rr.AnyValues(name=inspection.task))
        log_scene(recording, inspection)
        log_densities(recording, inspection)
        log_posteriors(recording, inspection)
        log_summary(recording, inspection)


@contextmanager
def written_recording(path: Path, name: str, layout: Blueprint) -> Iterator[RecordingStream]:
    """A recording that takes the place of `path` only once it is complete; what cannot be shown is an error.

    Args:
        path: the `.rrd` file.
        name: of the recording, always the same for the same thing.
        layout: what opens with it.
    """
    import rerun as rr

    partial = path.with_name(f".{path.name}.partial")
    # one chunk per call, cut by nothing that depends on time or speed: equal inspections give equal contents
    whole = rr.ChunkBatcherConfig(flush_tick=1e6, flush_num_bytes=1 << 40, flush_num_rows=1 << 40)
    recording = rr.RecordingStream(f"lessbench {name}", recording_id=name, send_properties=False, batcher_config=whole)
    strict = rr.strict_mode()
    try:
        rr.set_strict_mode(True)  # otherwise data that cannot be shown is left out with a warning
        recording.set_log_time_enabled(False)
        recording.save(partial, default_blueprint=layout)
        yield recording
        recording.flush(timeout_sec=30)
        recording.disconnect()
        partial.replace(path)
    finally:
        rr.set_strict_mode(strict)
        recording.disconnect()
        partial.unlink(missing_ok=True)


def open_viewer(path: Path) -> None:
    """Show a recording in the Rerun viewer and wait until its window is closed.

    The viewer listens on the loopback address only, on a port of its own; analytics and the update check are off.

    Raises:
        StageError: there is no such recording, no display to show it on, or the viewer failed.
    """
    if not path.is_file():
        raise StageError(f"{path} does not exist; `dvc repro` or `lessbench inspect TASK` writes it.")
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise StageError(
            f"there is no display here (DISPLAY and WAYLAND_DISPLAY are not set); copy {path} to a machine that has one "
            f"and run `rerun {path.name}` there (pip install rerun-sdk)."
        )
    with subprocess.Popen([*viewer_command(), str(path)], env=quiet_environment()) as process:  # noqa: S603
        try:
            status = process.wait()
        except BaseException:
            process.terminate()
            raise
    if status != 0:
        raise StageError(f"the Rerun viewer ended with status {status}; its own message is above.")


def viewer_command() -> list[str]:
    """The viewer itself, not the Python script `rerun` in front of it, which leaves it behind when it is stopped."""
    binary = Path(str(files("rerun_cli"))) / ("rerun.exe" if sys.platform == "win32" else "rerun")
    return [str(binary), "--bind", "127.0.0.1", "--port", "auto", "--hide-welcome-screen"]


def quiet_environment() -> dict[str, str]:
    """The environment in which the viewer sends nothing anywhere: no analytics, no look for a newer version."""
    return os.environ | {"CI": "true", "HTTPS_PROXY": _UNREACHABLE}


def _check_shape(name: str, array: Floats, shape: tuple[int | None, ...]) -> None:
    got = np.shape(array)
    if len(got) != len(shape) or any(want not in (None, have) for want, have in zip(shape, got, strict=True)):
        wanted = ", ".join("any" if want is None else str(want) for want in shape)
        raise ArgumentError(f"{name} must have shape ({wanted}); got {got}.")
    if not np.isfinite(array).all():
        raise ArgumentError(f"{name} must be finite; it holds NaN or infinity.")
