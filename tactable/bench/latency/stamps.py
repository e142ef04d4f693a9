"""Raw times of a segment - of reports, commands, arrivals, the firmware - to one row of stamps a command."""

import numpy as np

from base.arrays import Array, Integers
from engine.loop.observer import Stage
from firmware_link.emulator.emulator_process import RunningEmulator
from tactable.bench.ends import Arrivals
from tactable.bench.latency.load_generator import Schedule
from tactable.bench.latency.stages import Point, Stamps

Times = Integers

# A command comes within a fraction of a lease, or a stall of the line; its sequence comes again after 256 frames.
_LONGEST_WAY_NS = 200_000_000
_CUT_NS = 1_000  # device time is cut to whole microseconds


def _empty(count: int) -> Stamps:
    stamps = np.full((count, len(Point)), np.nan)
    stamps[:, Point.DUE] = 0.0
    return stamps


def stamps_of_commands(samples: dict[str, Times], arrivals: Arrivals, schedule: Schedule) -> tuple[Stamps, Times]:
    """Stamps and due times of the commands that a report caused and that were written."""
    ours, sent_ns = samples["stamps_ns"], samples["sent_ns"]
    due_ns = ours[:, Stage.AVAILABLE]
    reports = np.rint((due_ns - schedule.start_ns) * schedule.rate_hz / 1e9).astype(np.int64)
    stamps = _empty(len(ours))
    stamps[:, Point.SENT] = sent_ns[reports] - due_ns
    stamps[:, Point.READ : Point.WRITTEN + 1] = ours[:, Stage.READ :] - due_ns[:, None]
    received_ns = first_with_sequence(
        np.array(arrivals.time_ns, np.int64),
        np.array(arrivals.sequence, np.int64),
        ours[:, Stage.COMMAND] - _CUT_NS,
        samples["sequence"],
    )
    stamps[:, Point.RECEIVED] = received_ns - due_ns
    stamps[:, Point.APPLIED] = _applied(samples, ours[:, Stage.COMMAND]) - due_ns
    stamps[:, Point.AT_FINGER] = np.fmax(stamps[:, Point.APPLIED], stamps[:, Point.RECEIVED]) + samples["prediction_ns"]
    return stamps, due_ns


def stamps_of_echoes(samples: Times, received_ns: Times) -> Stamps:
    """Stamps of the answers of the C echo engine, from when each was due, sent, read and written, and received, ns."""
    stamps = _empty(len(samples))
    stamps[:, [Point.DUE, Point.SENT, Point.READ, Point.WRITTEN]] = samples - samples[:, :1]
    stamps[: len(received_ns), Point.RECEIVED] = received_ns[: len(samples)] - samples[: len(received_ns), 0]
    return stamps


def stamps_of_replaced(samples: dict[str, Times], schedule: Schedule) -> tuple[Stamps, Times]:
    """Stamps and due times of changes whose command a newer one replaced unsent.

    Each counts as answered when the next command was written. Without them a stall would show only in the few commands
    that were sent after it, which are not late.
    """
    ours = samples["stamps_ns"]
    by_reports = samples["change_report"] >= 0
    reports, changes_ns = samples["change_report"][by_reports], samples["change_ns"][by_reports]
    is_sent = np.isin(changes_ns, ours[:, Stage.STATE])
    reports, changes_ns = reports[~is_sent], changes_ns[~is_sent]
    due_ns = np.array([schedule.time_of_ns(int(report)) for report in reports], np.int64)
    # The next command that was written after a change answers it; NaN: none was.
    written_ns = np.append(ours[:, Stage.WRITTEN].astype(np.float64), np.nan)
    answered_ns = written_ns[np.searchsorted(ours[:, Stage.WRITTEN], changes_ns)]
    stamps = _empty(len(reports))
    stamps[:, Point.SENT] = samples["sent_ns"][reports] - due_ns
    stamps[:, Point.READ] = samples["read_ns"][reports] - due_ns
    stamps[:, Point.STATE] = changes_ns - due_ns
    stamps[:, Point.WRITTEN] = answered_ns - due_ns
    return stamps, due_ns


def first_with_sequence(
    times_ns: Times, sequences: Times, since_ns: Times, wanted: Times, longest_ns: int = _LONGEST_WAY_NS
) -> Array:
    """For each wanted sequence the first time, at or after its own `since_ns`, that has it; NaN within `longest_ns`.

    `times_ns` rise. Shapes (arrival,) twice, (sample,) twice; the result (sample,).
    """
    found = np.full(len(wanted), np.nan)
    for sequence in np.unique(wanted):
        rows, times = np.nonzero(wanted == sequence)[0], times_ns[sequences == sequence]
        place = np.searchsorted(times, since_ns[rows])
        is_there = place < len(times)
        rows, times = rows[is_there], times[place[is_there]]
        is_near = times - since_ns[rows] <= longest_ns
        found[rows[is_near]] = times[is_near]
    return found


def _applied(samples: dict[str, Times], since_ns: Times) -> Array:
    """When the firmware says it applied a command, on the host's clock by the middle of its bounds, ns."""
    times_ns, sequences = samples["applied_ns"], samples["applied_sequence"]
    order = np.argsort(times_ns, kind="stable")
    # The bounds of the clock may put it before it was sent.
    slack_ns = max(_CUT_NS, int(samples["bounds_half_width_ns"]))
    return first_with_sequence(times_ns[order], sequences[order], since_ns - slack_ns, samples["sequence"])


def arrivals_at(emulator: RunningEmulator) -> Arrivals:
    """When each command reached the emulated firmware, by its own clock, which is the host's."""
    arrivals, log = Arrivals(), emulator.log()
    for frame in log.received:
        if frame.message in ("SET", "PLAY"):
            arrivals.time_ns.append(log.host_ns_at_device_zero + 1_000 * frame.device_time_us)
            arrivals.sequence.append(frame.sequence)
    return arrivals


def count_stale(samples: dict[str, Times]) -> int:
    """Number of commands that were written although a newer state was known by then."""
    changes_ns, ours = np.sort(samples["change_ns"]), samples["stamps_ns"]
    following = np.searchsorted(changes_ns, ours[:, Stage.STATE], side="right")
    next_ns = np.append(changes_ns, np.iinfo(np.int64).max)[following]
    return int((next_ns < ours[:, Stage.WRITTEN]).sum())
