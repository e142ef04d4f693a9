"""The process of a page that looks on at a run: ring and table of the command line, until standard input ends."""

import asyncio
import json
import os
import sys
from pathlib import Path
from typing import Any

import uvicorn

from engine.loop.ring import RingError, RingReader
from engine.table import TableError
from tactable.page.live_backend import LiveBackend
from tactable.page.opening import announcement, token_for
from tactable.page.server import listen_at, serve

_NICE = 5


def main() -> None:
    """Say where the page is, or why there is none, as a line of JSON; then serve it."""
    os.nice(_NICE)  # the engine comes first
    ring, table, resolution_hz, host, port = sys.argv[1:]
    try:
        with RingReader(Path(ring)) as reader:
            asyncio.run(_serve(LiveBackend(reader, Path(table), float(resolution_hz)), host, int(port)))
    except (OSError, RingError, TableError) as error:
        _say({"error": str(error)})
        raise SystemExit(1) from None


async def _serve(backend: LiveBackend, host: str, port: int) -> None:
    listening, access = listen_at(host, port, token_for(port))
    with listening:
        _say({"lines": announcement(access)})

        async def end_with_input(server: uvicorn.Server) -> None:
            def end() -> None:
                asyncio.get_running_loop().remove_reader(sys.stdin)
                server.should_exit = True

            asyncio.get_running_loop().add_reader(sys.stdin, end)

        await serve(backend, listening, access, end_with_input)


def _say(document: dict[str, Any]) -> None:
    sys.stdout.write(json.dumps(document) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
