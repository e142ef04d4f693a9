"""Child process that serves the page of a live run, from its ring and table, until the run ends."""

import asyncio
import os
from pathlib import Path
from typing import Any

import uvicorn
from threadpoolctl import threadpool_limits

from base.child import Parent
from engine.loop.ring import RingReader
from tactable.page.live_backend import LiveBackend
from tactable.page.opening import announcement, token_for
from tactable.page.page_server import listen_at, serve

_NICE = 5  # a third of the share of a busy engine: 1.25 for each step, sched(7)


def main(parent: Parent, arguments: dict[str, Any]) -> None:
    """Say the address of the page, then serve it until the run ends."""
    os.nice(_NICE)  # the engine comes first
    with RingReader(Path(arguments["ring"])) as reader:
        board = arguments["frequency_resolution_hz"], arguments["full_scales_m"]
        backend = LiveBackend(reader, Path(arguments["table"]), *board)
        with threadpool_limits(1, "blas"):  # its threads spin on a busy machine
            asyncio.run(_serve(backend, arguments["host"], arguments["port"], parent))


async def _serve(backend: LiveBackend, host: str, port: int, parent: Parent) -> None:
    listening, access = listen_at(host, port, token_for(port))
    with listening:
        parent.say({"lines": announcement(access)})

        async def end_with_run(server: uvicorn.Server) -> None:
            loop = asyncio.get_running_loop()

            def end() -> None:
                loop.remove_reader(parent.fileno())
                server.should_exit = True

            loop.add_reader(parent.fileno(), end)  # the run says nothing but its end

        await serve(backend, listening, access, end_with_run)
