"""One thread from report to command: the pure pipeline, the loop around it, and what observes them."""

from engine.loop.awaited_clicks import ClickSolving
from engine.loop.control import ControlSlot
from engine.loop.dispatcher import Dispatcher
from engine.loop.latency import LatencyRecorder, Stage
from engine.loop.loop import Clock, Loop, StopRequest, SystemClock, connect
from engine.loop.observer import CommandRecord, Fate, LoopCounters, Observer, Observers, Timing, Trace
from engine.loop.pipeline import Pipeline, open_pipeline
from engine.loop.reconnect import Reopening
from engine.loop.ring import Record, RingError, RingReader, RingWriter
from engine.loop.table_swap import Updates

__all__ = [
    "ClickSolving",
    "Clock",
    "CommandRecord",
    "ControlSlot",
    "Dispatcher",
    "Fate",
    "LatencyRecorder",
    "Loop",
    "LoopCounters",
    "Observer",
    "Observers",
    "Pipeline",
    "Record",
    "Reopening",
    "RingError",
    "RingReader",
    "RingWriter",
    "Stage",
    "StopRequest",
    "SystemClock",
    "Timing",
    "Trace",
    "Updates",
    "connect",
    "open_pipeline",
]
