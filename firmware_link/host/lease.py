"""Lease of what sounds, on the host: how soon the next command may go out, and by when the last must be renewed.

The device lets a drive live for one lease after the last fresh frame and orders frames by a sequence of one byte
(firmware/core/lease.c). Hence two bounds for the host:

- *Often enough.* A drive is renewed RENEWALS_PER_LEASE times a lease, so that two lost frames in a row do not end it.
  Silence and waveforms need no renewal for themselves, but the device latches 250 ms after the last fresh frame.
- *Not too often.* A sequence tells newer from older up to 127 frames ahead, so no more may go out within a lease.
"""

NS_PER_MS = 1_000_000
US_PER_MS = 1_000
# A sequence says its age up to here: with more frames within a lease, old ones could not be told from new ones.
LONGEST_SEQUENCE_LEAD = 127
RENEWALS_PER_LEASE = 3  # each costs a frame a lease; see above
SILENT_RENEWAL_NS = 80 * NS_PER_MS  # the device disarms 250 ms after the last fresh frame: two in a row may be lost


class Lease:
    """Times of the lease that was agreed with the device, in host nanoseconds where not named otherwise."""

    def __init__(self, duration_ms: int) -> None:
        self.duration_ms = duration_ms
        self.duration_us = duration_ms * US_PER_MS
        self.renewal_ns = duration_ms * NS_PER_MS // RENEWALS_PER_LEASE  # between two frames that hold a drive
        self.spacing_ns = -(-duration_ms * NS_PER_MS // LONGEST_SEQUENCE_LEAD)  # between two commands, at least
        self.free_ns = 0  # time from which another command may go out
        self.renewal_due_ns = 0  # time by which what sounds must be renewed
