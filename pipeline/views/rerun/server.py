"""Serving a recording to Rerun viewers while it is being made; they may connect and disconnect at any time."""

from __future__ import annotations

import ipaddress
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.errors import StageError
from pipeline.views.rerun.recording import has_display, quiet_environment, recorded_to, viewer_command

if TYPE_CHECKING:
    from rerun import RecordingStream
    from rerun.blueprint import Blueprint

LOOPBACK, PORT = "127.0.0.1", 9876
_MEMORY = "256MB"  # of sent data that are kept for viewers that connect later; a recording is below 20 MB
_START_S = 10.0  # how long a server may take to start


@dataclass(frozen=True)
class Address:
    """The address at which a recording is served.

    Attributes:
        bind: an IP address of this machine.
        port: 1 to 65535.
    """

    bind: str
    port: int

    @property
    def uri(self) -> str:
        """The address in the form that a viewer on this machine takes."""
        host = {"0.0.0.0": LOOPBACK, "::": "[::1]"}.get(self.bind, self.bind)  # noqa: S104
        return f"rerun+http://{f'[{host}]' if ':' in host.strip('[]') and host[0] != '[' else host}:{self.port}/proxy"

    @property
    def local(self) -> bool:
        """Whether only programs on this machine can connect."""
        return ipaddress.ip_address(self.bind).is_loopback


def claim(bind: str = LOOPBACK, port: int = PORT) -> Address:
    """Check that the address is free, and choose a port if none is given.

    Args:
        bind: an IP address of this machine, or `localhost`.
        port: 1 to 65535, or 0 for any that is free.

    Raises:
        StageError: `bind` is not an address of this machine, or the port is in use.
    """
    bind = LOOPBACK if bind == "localhost" else bind
    try:
        family = socket.AF_INET6 if ipaddress.ip_address(bind).version == 6 else socket.AF_INET
    except ValueError:
        raise StageError(f"--bind is {bind!r}; it must be an IP address of this machine such as {LOOPBACK}") from None
    if not 0 <= port <= 65535:
        raise StageError(f"--port is {port}; it must be 1..65535, or 0 for any that is free")
    with socket.socket(family) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((bind, port))
        except OSError as error:
            reason = (error.strerror or str(error)).lower()
            raise StageError(
                f"port {port} of {bind} cannot be served ({reason}); choose another with --port, or --port 0 for any "
                "that is free"
            ) from None
        return Address(bind, probe.getsockname()[1])


def server(address: Address) -> Any:
    """The Rerun sink that serves at this address."""
    import rerun as rr

    return rr.GrpcServerSink(bind_ip=address.bind, port=address.port, server_memory_limit=_MEMORY)


def require_listening(address: Address) -> None:
    """Wait until viewers can connect.

    Raises:
        StageError: viewers cannot connect after ten seconds.
    """
    uri_host = address.uri.removeprefix("rerun+http://").rpartition(":")[0].strip("[]")
    deadline = time.monotonic() + _START_S
    while time.monotonic() < deadline:
        try:
            with socket.create_connection((uri_host, address.port), timeout=1.0):
                return
        except OSError:
            time.sleep(0.05)
    raise StageError(f"{address.uri} does not answer; another program may have taken the port: choose one with --port")


@contextmanager
def served(name: str, layout: Blueprint, address: Address) -> Iterator[RecordingStream]:
    """A recording that is served until the block is left.

    Args:
        name: name of the recording.
        layout: the layout with which it opens.
        address: the address at which it is served.

    Raises:
        StageError: the address cannot be served.
    """
    with recorded_to(name, layout, server(address)) as recording:
        require_listening(address)
        yield recording


def open_beside(address: Address) -> str | None:
    """Open a viewer of the served recording; its window stays open when this program ends.

    Returns:
        None if a viewer was opened, else the reason why not.
    """
    if not has_display():
        return "there is no display here (DISPLAY and WAYLAND_DISPLAY are not set)"
    try:
        command = viewer_command()
    except ModuleNotFoundError:
        command = []
    if not command or not Path(command[0]).is_file():
        return "the Rerun viewer is not installed here (pip install rerun-sdk)"
    subprocess.Popen(  # noqa: S603
        [*command, address.uri],
        env=quiet_environment(),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    return None
