"""Running the service until it is stopped."""

from __future__ import annotations

import socket
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import uvicorn

from datagen.errors import InputError

from .answer import Predictor, load_model
from .app import Settings, create_app

GRACE = 3
"""s.  How long requests may still take at the end; their jobs go on next time."""


def run(
    settings: Settings,
    host: str = "127.0.0.1",
    port: int = 8000,
    load_model: Callable[[Path | None], Predictor] = load_model,
) -> None:
    """Serve until Ctrl-C or a termination signal.

    Parameters
    ----------
    settings : Settings
    host, port
        Where to listen; port 0 takes any free one.
    load_model : callable
        As in `create_app`.

    Raises
    ------
    InputError, FileError
        When the port is taken, or the model or the state folder cannot be used.
    """
    listener = _listen(host, port)
    try:
        model = load_model(settings.model)  # first: a store is open until it is closed
        app = create_app(settings, lambda _folder: model, settings.open_store())
        config = uvicorn.Config(
            app,
            log_level="warning",
            timeout_graceful_shutdown=GRACE,
        )
        where = "127.0.0.1" if host in ("0.0.0.0", "") else host
        print(
            f"pba serves http://{where}:{listener.getsockname()[1]} "
            f"(jobs in {settings.kept}; Ctrl-C stops)",
            flush=True,
        )
        with suppress(KeyboardInterrupt):  # raised again after an orderly end
            uvicorn.Server(config).run(sockets=[listener])
    finally:
        listener.close()


def _listen(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    # The protocol is named for asyncio, which sends without delay only then.
    listener = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((host, port))
        listener.listen(128)
    except OSError as error:
        listener.close()
        reason = error.strerror or str(error)
        raise InputError("--port", port, f"a free port on {host} ({reason})") from error
    return listener
