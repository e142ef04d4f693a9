"""Sessions of seconds with harsh faults, and one without."""

from tests.studies.trust.soak import COMMANDS_PER_S, Soak, check_that_counters_reconcile

HARSH = (
    "bit_errors=1e-4,drop=0.02,duplicate=0.02,insert=0.005,lose=0.005,burst=0.005,delay=300us,jitter=1ms,"
    "drift=-90ppm,stall=0.05s/1.1s,stall=0.3s/2.9s,half_open=1.5s/6s,hang_up=0.3s@9s,reboot=0.1s/4.1s,at_noise"
)


def test_nothing_stale_is_applied_and_every_counter_reconciles() -> None:
    figures = Soak(HARSH, 1).run(12.0)
    check_that_counters_reconcile(figures)
    assert figures.applied_commands > 2.5 * COMMANDS_PER_S
    assert figures.applied_plays > 0.05 * figures.applied_commands
    assert figures.received["KEEPALIVE accepted"] > 0
    assert figures.ended_plays > 0
    assert figures.faults["reboots"] == 3
    assert figures.faults["hang_ups"] == 1
    assert figures.device["stale"] > 0
    assert figures.sessions > 4


def test_without_faults_every_command_is_applied() -> None:
    figures = Soak("", 1).run(3.0)
    check_that_counters_reconcile(figures)
    assert figures.applied_commands == figures.host["sent"]
    assert figures.commands - figures.applied_commands <= 1
    assert figures.device["stale"] == figures.device["refused"] == 0
    assert figures.ended_plays > 0
    # The end of the run is the end of the host.
    assert figures.device["trips"] == 1
