"""Records of a ring, written as a loop writes them."""

from engine.loop.observer import CommandRecord, Fate, LoopCounters
from engine.loop.ring import Record, RingWriter


def observe(writer: RingWriter, record: Record) -> None:
    """As a loop does."""
    values = record._asdict() | {"frame": None, "fate": Fate.NONE}
    record_values = {name: values[name] for name in CommandRecord._fields}
    writer.observe(CommandRecord(**record_values), LoopCounters(**record.counters._asdict()))
