"""The decoders of C and Python over the same damaged frames.

`python -m tests.firmware_link.firmware.compare_decoders COUNT` compares COUNT of them.
"""

import argparse
import json
import random
import sys
import time
from collections import Counter
from ctypes import CDLL

from firmware_link.protocol.framing import FrameDecoder
from tests.firmware_link.corrupt import ACTUATORS, BATCH, DAMAGES, count_outcomes, make_batch
from tests.firmware_link.firmware.compiled_core import core_library
from tests.firmware_link.firmware.compiled_decoder import CompiledDecoder


def compare(library: CDLL, count: int, seed: int) -> dict[str, Counter[str]]:
    """Outcomes by kind of damage, `count` frames in all; raises AssertionError where the decoders differ."""
    chance = random.Random(seed)
    outcomes: dict[str, Counter[str]] = {}
    for damage in DAMAGES:
        total = outcomes[damage.__name__] = Counter()
        python, compiled = FrameDecoder(ACTUATORS), CompiledDecoder(library, ACTUATORS)
        left = -(-count // len(DAMAGES))
        while left:
            batch = make_batch(damage, min(BATCH, left), chance)
            received = compiled.receive(batch.stream)
            assert received == python.receive(batch.stream)
            total += count_outcomes(batch, received)
            left -= len(batch.whole)
        assert compiled.counters == python.counters
        compiled.close()
    return outcomes


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", type=int)
    parser.add_argument("seed", type=int, nargs="?", default=1)
    arguments = parser.parse_args()
    started_s = time.monotonic()
    outcomes = compare(core_library(), arguments.count, arguments.seed)
    total = sum(sum(counts.values()) for counts in outcomes.values())
    document = {"frames": total, "seconds": round(time.monotonic() - started_s, 1), "outcomes": outcomes}
    json.dump(document, sys.stdout, indent=2)
    sys.stdout.write("\n")


if __name__ == "__main__":
    main()
