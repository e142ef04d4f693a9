"""Sends random and hostile messages to the control channel of a real run: nothing but answers, and the run goes on.

    python -m tests.studies.trust.control_fuzz --messages 100000 --seed 1
    python -m tests.studies.trust.control_fuzz --messages 100000 --seed 1 --osc

A finger taps meanwhile, five times a second. Each line must get one answer; at the end the run must have lost nothing
and answer an honest program. Prints what was sent, done and refused. With --osc datagrams of Open Sound Control are
sent in place of lines: nothing but answers and events may come back, and a message behind each few must be answered.
"""

import json
import random
import re
import signal
import socket
import time
from collections import Counter
from pathlib import Path

from tactable.control.client import connect
from tactable.control.osc_codec import decode_osc, encode_osc
from tests.studies.options import read_options
from tests.studies.trust.controlled_run import controlled_run
from tests.tactable.control.messages import HELLO, hostile_datagram, hostile_line
from tests.tactable.rig.strokes import Stroke, make_recording

PROGRAMS = 4
BATCH, OSC_BATCH = 50, 2
TAPS = 2_000


class Program:
    """One connection, which sends lines by the batch and counts the answers to each."""

    def __init__(self, path: Path) -> None:
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.connect(str(path))
        self._socket.settimeout(60.0)
        self._received = b""
        self.answers: Counter[str] = Counter()
        self.send([json.dumps(HELLO | {"lease": "60 s"}).encode()])

    def send(self, lines: list[bytes]) -> None:
        """Send lines and wait for one answer to each."""
        self._socket.sendall(b"\n".join(lines) + b"\n")
        missing = len(lines)
        while missing:
            data = self._socket.recv(1 << 20)
            assert data, "the run has hung up"
            *whole, self._received = (self._received + data).split(b"\n")
            for line in whole:
                document = json.loads(line)
                if "event" in document:
                    self.answers[f"event: {document['event']}"] += 1
                    continue
                missing -= 1
                self.answers["done" if document["ok"] else "refused"] += 1

    def close(self) -> None:
        self._socket.close()


class OscProgram:
    """One sender of datagrams, which counts what comes back."""

    def __init__(self, said: str) -> None:
        port = int(re.findall(r"osc://127.0.0.1:([0-9]+)", said)[0])
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.connect(("127.0.0.1", port))
        self._socket.settimeout(60.0)
        self.answers: Counter[str] = Counter()

    def send(self, datagrams: list[bytes]) -> None:
        """Send datagrams and a message whose answer is known, and wait for that."""
        for data in [*datagrams, encode_osc("/tactable/trigger", ["the last", 0])]:
            self._socket.send(data)
        while True:
            ((address, values),) = decode_osc(self._socket.recv(1 << 16))
            if address != "/tactable/answer":
                assert address in ("/tactable/touches", "/tactable/played", "/tactable/event"), address
                self.answers[f"event: {address}"] += 1
                continue
            self.answers["done" if values[1] else "refused"] += 1
            if "the last" in str(values[2]) or "wait for their answers" in str(values[2]):
                return

    def close(self) -> None:
        self._socket.close()


def fuzz(messages: int, seed: int, *, is_osc: bool = False) -> dict[str, object]:
    """Send the messages to a run of its own; what came back. Raises AssertionError."""
    random_ = random.Random(seed)
    strokes = [Stroke(0.2 * tap, 0.2 * tap + 0.1, 0.1 + 0.2 * (tap % 5), 0.1) for tap in range(TAPS)]
    with controlled_run(make_recording(strokes), *["--control-osc", "0"] * is_osc) as run:
        start_s = time.monotonic()
        programs: list[Program | OscProgram]
        programs = [OscProgram(run.said) if is_osc else Program(run.socket) for _ in range(PROGRAMS)]
        batch_of, hostile = (OSC_BATCH, hostile_datagram) if is_osc else (BATCH, hostile_line)
        for batch in range(messages // batch_of):
            programs[batch % PROGRAMS].send([hostile(random_) for _ in range(batch_of)])
        duration_s = time.monotonic() - start_s
        with connect(run.socket) as honest:
            honest.ping()
        for program in programs:
            program.close()
        run.process.send_signal(signal.SIGINT)
        summary = run.summary()
    assert summary["losses_of_the_port"] == 0 and summary["digitizer"]["lost_frames"] == 0
    assert summary["commands_mispredicted"] == 0
    answers = sum((program.answers for program in programs), Counter[str]())
    assert is_osc or answers["done"] + answers["refused"] == BATCH * (messages // BATCH) + PROGRAMS
    return {
        "seed": seed,
        "messages": messages,
        "seconds": round(duration_s, 1),
        **answers,
        "control_steps": summary["control_steps"],
        "reports": summary["reports"],
    }


def main() -> None:
    """Read the options, fuzz, and print the counts."""
    asked = read_options(__doc__, messages=100_000, seed=1, osc=False)
    print(json.dumps(fuzz(asked.messages, asked.seed, is_osc=asked.osc), indent=2))


if __name__ == "__main__":
    main()
