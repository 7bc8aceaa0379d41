"""One task as a recording for the Rerun viewer: the replay of the arm, paths, densities, posteriors and numbers.

The recording is a picture of the tables, which remain the source of truth: Rerun promises to read a `.rrd` file in the
next version only. Two files that are written from the same inspection are equal by `rerun rrd compare`.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.errors import StageError
from pipeline.formats.files.atomic import path_written_whole, require_space

if TYPE_CHECKING:
    from rerun import RecordingStream
    from rerun.blueprint import Blueprint

    from pipeline.views.rerun.records import Inspection

_UNREACHABLE = "http://127.0.0.1:9"  # a proxy address at which nothing listens
SPACE = 40_000_000  # bytes that must be free for a recording, which is smaller than half of that


def write_inspection(path: Path, inspection: Inspection) -> None:
    """Write the recording with its layout, whole or not at all.

    Args:
        path: `datasets/<task>/inspect.rrd`.
        inspection: what the recording shows.
    """
    from pipeline.views.rerun.layout import layout

    with written_recording(path, inspection.task, layout(inspection)) as recording:
        log_inspection(recording, inspection)


def log_inspection(recording: RecordingStream, inspection: Inspection) -> None:
    """Log all of an inspection except its layout."""
    import rerun as rr

    from pipeline.views.rerun.density import log_densities, log_summary
    from pipeline.views.rerun.feature_space import log_space
    from pipeline.views.rerun.posterior import log_posteriors
    from pipeline.views.rerun.robustness import log_spread
    from pipeline.views.rerun.scene import log_scene
    from pipeline.views.rerun.series import log_series
    from pipeline.views.rerun.weights import log_weights

    recording.send_property("task", rr.AnyValues(name=inspection.task))
    log_scene(recording, inspection)
    log_densities(recording, inspection)
    log_posteriors(recording, inspection)
    log_series(recording, inspection)
    if inspection.weights is not None:
        log_weights(recording, inspection.weights)
    if inspection.space is not None:
        log_space(recording, inspection.space)
    if inspection.robustness is not None:
        log_spread(recording, inspection.robustness)
    log_summary(recording, inspection)


@contextmanager
def written_recording(path: Path, name: str, layout: Blueprint, *others: Any) -> Iterator[RecordingStream]:
    """A recording that replaces the file `path` when it is complete. Data that cannot be shown are an error.

    Args:
        path: the `.rrd` file.
        name: name of the recording, which identifies what it shows.
        layout: the layout with which it opens.
        others: further Rerun sinks for the same recording.
    """
    import rerun as rr

    with path_written_whole(path) as partial:
        partial.touch()
        require_space(path, SPACE)  # if the disk is full, Rerun waits forever
        with recorded_to(name, layout, rr.FileSink(partial), *others) as recording:
            yield recording


@contextmanager
def recorded_to(name: str, layout: Blueprint, *sinks: Any) -> Iterator[RecordingStream]:
    """A recording that is sent to Rerun sinks; arguments as in `written_recording`."""
    import rerun as rr

    # one chunk per call, because chunks that depend on time would make the contents of equal inspections differ
    whole = rr.ChunkBatcherConfig(flush_tick=1e6, flush_num_bytes=1 << 40, flush_num_rows=1 << 40)
    recording = rr.RecordingStream(f"lessbench {name}", recording_id=name, send_properties=False, batcher_config=whole)
    strict = rr.strict_mode()
    try:
        rr.set_strict_mode(True)  # otherwise data that cannot be shown are left out with a warning
        recording.set_log_time_enabled(False)
        recording.set_sinks(*sinks, default_blueprint=layout)
        yield recording
        recording.flush(timeout_sec=30)
    finally:
        rr.set_strict_mode(strict)
        recording.disconnect()


def open_viewer(path: Path) -> None:
    """Show a recording in the Rerun viewer and wait until its window is closed.

    The viewer listens on the loopback address only, on any free port. Its analytics and update check are off.

    Raises:
        StageError: there is no such recording, no display to show it on, or the viewer failed.
    """
    if not path.is_file():
        raise StageError(f"{path} does not exist; `dvc repro` or `lessbench inspect TASK` writes it.")
    if not has_display():
        raise StageError(
            f"there is no display here (DISPLAY and WAYLAND_DISPLAY are not set); copy {path} to a machine that has "
            f"one and run `rerun {path.name}` there (pip install rerun-sdk)."
        )
    with subprocess.Popen([*viewer_command(), str(path)], env=quiet_environment()) as process:  # noqa: S603
        try:
            status = process.wait()
        except BaseException:
            process.terminate()
            raise
    if status != 0:
        raise StageError(f"the Rerun viewer ended with status {status}; its own message is above.")


def has_display() -> bool:
    """Whether a window could be opened here."""
    display = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    return bool(display) or not sys.platform.startswith("linux")


def viewer_command() -> list[str]:
    """The command that starts the viewer.

    It is the binary itself, because the Python script `rerun` leaves the viewer running when it is stopped.
    """
    binary = Path(str(files("rerun_cli"))) / ("rerun.exe" if sys.platform == "win32" else "rerun")
    return [str(binary), "--bind", "127.0.0.1", "--port", "auto", "--hide-welcome-screen"]


def quiet_environment() -> dict[str, str]:
    """The environment in which the viewer sends nothing: no analytics, no check for a newer version."""
    return os.environ | {"CI": "true", "HTTPS_PROXY": _UNREACHABLE}
