"""Processor time of a demo's page from its start to its first picture, its first click and the table built here.

`python -m tests.studies.trust.first_minute [DEVICE] [--with-kernels]` runs `tactable demo` with empty caches, or with
the kernels that this checkout has compiled before. All processes of the demo count. The build begins once the page
plays, and counts too.
"""

import argparse
import asyncio
import contextlib
import json
import os
import subprocess
import tempfile
import time
from pathlib import Path
from urllib.parse import urlsplit

import websockets
from websockets.typing import Origin

from engine.touch.sources.pointer import Phase, PointerEvent
from tactable.page.page_messages import Drive, Kind
from tests.system.page import TACTABLE
from tests.tactable.page.browser import decode_picture, encode_touches
from tests.tools.stalls import descendants

_TAP, _UP_AT = 60, 20  # pictures
_TICK = os.sysconf("SC_CLK_TCK")


def processor_s(process: int) -> float:
    """Processor time of a process, its children that have ended, and all that it started and that run."""
    total_s = 0.0
    for each in {process, *descendants(process)}:
        with contextlib.suppress(OSError):  # it has ended
            fields = Path(f"/proc/{each}/stat").read_text().rpartition(")")[2].split()
            total_s += sum(map(int, fields[11:15])) / _TICK
    return total_s


async def _watch(address: str, demo: int) -> None:
    where = urlsplit(address)
    url, origin = f"ws://{where.netloc}{where.path}socket", Origin(f"http://{where.netloc}")
    start_s, told, pictures = time.monotonic(), set[str](), 0

    def tell(what: str) -> None:
        if what not in told:
            told.add(what)
            took = f"{processor_s(demo):6.1f} s of processor time, {time.monotonic() - start_s:6.1f} s"
            print(f"{took}  {what}", flush=True)

    async with websockets.connect(url, origin=origin) as socket:
        plays = False
        while True:
            message = await socket.recv()
            assert isinstance(message, bytes)
            if message[1] == Kind.SCENE:
                scene = json.loads(message[2:])
                plays = scene["plays"] is not None
                if scene.get("has_kernels"):
                    tell("plays with compiled kernels")
                if scene.get("building"):
                    tell(scene["building"]["step"].partition(",")[0])
                if scene.get("compared"):
                    tell(f"own table: {scene['compared']['text']}")
                    return
                has_table = scene["clicks"] and not scene["is_shipped"] and not scene.get("solved")
                if has_table:
                    tell("table with clicks of one finger")
                if has_table and "first click" in told:
                    return
            elif message[1] == Kind.PICTURE and plays:
                tell("first picture")
                picture, _ = decode_picture(message)
                if picture["command"]:
                    tell("first click" if picture["drive"] == Drive.CLICK else "first steady drive")
                # A finger taps: down for a third of every second.
                phase = {0: Phase.DOWN, _UP_AT: Phase.UP}.get(pictures % _TAP, Phase.MOVE)
                if pictures % _TAP <= _UP_AT:
                    await socket.send(encode_touches([PointerEvent(1 + pictures // _TAP, 0.1, 0.5, phase)]))
                pictures += 1


def main(device: str, *, with_kernels: bool) -> None:
    """Run the demo and print what came when."""
    with tempfile.TemporaryDirectory() as folder:
        caches = {"XDG_CACHE_HOME": folder}
        if not with_kernels:
            caches["NUMBA_CACHE_DIR"] = f"{folder}/kernels"
        with subprocess.Popen(
            [TACTABLE, "demo", device, "--no-open"], env={**os.environ, **caches}, stderr=subprocess.PIPE, text=True
        ) as demo:
            assert demo.stderr is not None
            url = next(word for word in demo.stderr.readline().split() if word.startswith("http"))
            print(f"{processor_s(demo.pid):6.1f} s of processor time           address")
            try:
                asyncio.run(_watch(url, demo.pid))
            finally:
                demo.terminate()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("device", nargs="?", default="reference-a")
    parser.add_argument("--with-kernels", action="store_true")
    asked = parser.parse_args()
    main(asked.device, with_kernels=asked.with_kernels)
