"""A recording served to Rerun viewers while it is being made: they may come, go and come back as they like."""

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
# of what was sent, for viewers that come later; a recording is below 20 MB
_MEMORY = "256MB"
_START_S = 10.0


@dataclass(frozen=True)
class Address:
    """Where viewers find a recording.

    Attributes:
        bind: an address of this machine.
        port: 1..65535.
    """

    bind: str
    port: int

    @property
    def uri(self) -> str:
        """What a viewer on this machine is to be given."""
        host = {"0.0.0.0": LOOPBACK, "::": "[::1]"}.get(self.bind, self.bind)  # noqa: S104
        return f"rerun+http://{f'[{host}]' if ':' in host.strip('[]') and host[0] != '[' else host}:{self.port}/proxy"

    @property
    def local(self) -> bool:
        """Whether only programs on this machine can connect."""
        return ipaddress.ip_address(self.bind).is_loopback


def claim(bind: str = LOOPBACK, port: int = PORT) -> Address:
    """An address at which nobody listens yet.

    Args:
        bind: an IP address of this machine, or `localhost`.
        port: 0 for any that is free.

    Raises:
        StageError: it is no address of this machine, or the port is in use.
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
    """The Rerun sink that listens there."""
    import rerun as rr

    return rr.GrpcServerSink(bind_ip=address.bind, port=address.port, server_memory_limit=_MEMORY)


def require_listening(address: Address) -> None:
    """Wait until viewers can connect.

    Raises:
        StageError: they cannot within ten seconds.
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
        name: of the recording.
        layout: what opens with it.
        address: where.

    Raises:
        StageError: the address cannot be served.
    """
    with recorded_to(name, layout, server(address)) as recording:
        require_listening(address)
        yield recording


def open_beside(address: Address) -> str | None:
    """Open a viewer of what is served, in a window of its own that stays when this program ends.

    Returns:
        Why there is none, or None if there is.
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
