"""A command that serves, clients of it, and the real viewer without a screen: what tests of recordings need."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from PIL import Image
from rerun.chunk import RrdReader

from pipeline.views.rerun.recording import quiet_environment, viewer_command
from pipeline.workspace.project import Project

ROOT = Path(__file__).resolve().parents[2]
WITHOUT_DISPLAY = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}


@contextmanager
def lessbench(project: Project, *words: str) -> Iterator[subprocess.Popen[str]]:
    """The command in a process of its own, without a display; it is stopped on the way out."""
    environment = WITHOUT_DISPLAY | {"PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": "1"}
    process = subprocess.Popen(
        [sys.executable, "-m", "pipeline", *words],
        cwd=project.root,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()


def received(uri: str, path: Path, entity: str) -> set[str]:
    """Connect as a viewer would, keep what comes, and give the entities that came; ends once `entity` is among them."""
    command = [viewer_command()[0], "--bind", "127.0.0.1", "--port", "0", "--save", str(path), uri]
    client = subprocess.Popen(
        command, env=quiet_environment(), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, text=True
    )
    try:
        for _ in range(240):
            time.sleep(0.25)
            found = entities(path)
            if entity in found:
                return found
    finally:
        client.kill()
        client.wait()
    return entities(path)


def entities(path: Path) -> set[str]:
    """What is in a recording, also in one that is still being written."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a file that is still being written has no footer yet
            return {chunk.entity_path for chunk in RrdReader(path).stream()}
    except (OSError, RuntimeError, ValueError):
        return set()


def listening(port: int) -> set[str]:
    """The addresses at which this machine listens on a port, as the kernel writes them."""
    found = set()
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        for line in Path(table).read_text().splitlines()[1:]:
            address, state = line.split()[1], line.split()[3]
            if state == "0A" and int(address.rpartition(":")[2], 16) == port:
                found.add(address.rpartition(":")[0])
    return found


def pictures() -> ModuleType:
    """docs/take_pictures.py; the test is skipped where nothing can be drawn without a screen."""
    if not any(Path("/usr/share/vulkan/icd.d").glob("lvp_icd*.json")):
        pytest.skip("no software Vulkan here (apt-get install mesa-vulkan-drivers), so no picture without a screen")
    spec = importlib.util.spec_from_file_location("take_pictures", ROOT / "docs" / "take_pictures.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def not_blank(path: Path) -> np.ndarray:
    """A screenshot as (H, W, 3), after a check that each quarter of it shows something."""
    with Image.open(path) as shown:
        pixels = np.asarray(shown.convert("RGB"))
    height, width = pixels.shape[0] // 2, pixels.shape[1] // 2
    for quarter in (pixels[:height, :width], pixels[:height, width:], pixels[height:, :width], pixels[height:, width:]):
        assert len(np.unique(quarter.reshape(-1, 3), axis=0)) > 50, path
    return pixels
