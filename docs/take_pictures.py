"""Take a picture of a recording as the Rerun viewer shows it, without a screen.

    python docs/take_pictures.py datasets/table/inspect.rrd docs/table.png --time-s 44

Needs a Vulkan driver that draws in software: `apt-get install mesa-vulkan-drivers` on Debian.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from PIL import Image
from rerun.experimental import ViewerClient

from pipeline.views.rerun.recording import quiet_environment, viewer_command
from pipeline.views.rerun.timelines import TIMELINE

_START_S = 30.0
# the viewer greets a software renderer with notices that stay for a few seconds
_NOTICES_S = 6.0


def main() -> None:
    """Read the command line and take one picture."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("recording", type=Path, help="an inspect.rrd")
    parser.add_argument("picture", type=Path, help="the PNG to write")
    parser.add_argument("--time-s", type=float, help="seconds into the replay (default: where it opens)")
    parser.add_argument("--size", default="1600x1000", help="of the window, in points (default: %(default)s)")
    given = parser.parse_args()
    try:
        take_picture(given.recording, given.picture, given.time_s, given.size)
    except RuntimeError as error:
        sys.exit(f"take_pictures: {error}")


def take_picture(recording: Path, picture: Path, time_s: float | None, size: str = "1600x1000") -> None:
    """Write what the viewer shows of `recording` at `time_s` of its replay.

    Raises:
        RuntimeError: the viewer did not start, or one of its views reports an error.
    """
    with headless_viewer(recording, size) as viewer:
        viewer.run_command("ui.toggle_top_panel")
        if time_s is not None:
            show_moment(viewer, time_s)
        time.sleep(_NOTICES_S)
        problems = [str(report) for view in viewer.get_state().views for report in view.reports]
        if problems:
            raise RuntimeError(f"{recording}: {'; '.join(problems)}")
        for _ in range(2):  # a still recording is drawn anew only when asked, and the notices are gone only then
            viewer.save_screenshot(str(picture.resolve()))
            time.sleep(1.0)
    with Image.open(picture) as shown:
        shown.convert("RGB").quantize(256, dither=Image.Dither.NONE).save(picture, optimize=True)


@contextmanager
def headless_viewer(recording: Path | str, size: str = "1600x1000") -> Iterator[ViewerClient]:
    """A viewer without a window that shows `recording`, a file or an address; it is stopped on the way out.

    Raises:
        RuntimeError: it did not start; the message ends with what it said.
    """
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "log"
        command = [*viewer_command(), "--headless", "--window-size", size, str(recording)]
        with log.open("wb") as out:
            environment = quiet_environment() | {"XDG_RUNTIME_DIR": folder}
            process = subprocess.Popen(command, env=environment, stdout=out, stderr=out)
        try:
            yield _connect(process, log)
        finally:
            process.terminate()
            process.wait()


def show_moment(viewer: ViewerClient, time_s: float) -> None:
    """Stop the replay at `time_s`, once the viewer has received enough of the recording to know the clock.

    Raises:
        RuntimeError: that does not happen.
    """
    deadline = time.monotonic() + _START_S
    while True:
        try:
            viewer.set_time(timeline=TIMELINE, duration=time_s, play_state="paused")
            return
        except ConnectionError as error:  # the layout comes before the first data
            if time.monotonic() > deadline:
                raise RuntimeError(f"the viewer does not go to {time_s} s: {error}") from error
            time.sleep(0.2)


def _connect(process: subprocess.Popen[bytes], log: Path) -> ViewerClient:
    deadline = time.monotonic() + _START_S
    while time.monotonic() < deadline and process.poll() is None:
        said = re.search(r"rerun\+http://127\.0\.0\.1:\d+/proxy", log.read_text(errors="replace"))
        if said:
            try:
                viewer = ViewerClient.connect(said.group())
                if viewer.get_state().views:
                    return viewer
            except (ConnectionError, RuntimeError):
                pass  # it listens before it can answer
        time.sleep(0.2)
    end = log.read_text(errors="replace")[-600:]
    raise RuntimeError(f"the viewer did not start (is mesa-vulkan-drivers installed?); its last words: {end}")


if __name__ == "__main__":
    main()
