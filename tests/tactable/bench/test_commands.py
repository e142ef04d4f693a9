"""The benchmark of commands: PLAY is compared with SET over the same touches."""

from tactable.bench.commands import run_commands_bench


def test_every_tap_is_a_command_of_both_kinds() -> None:
    result = run_commands_bench(taps=6, rounds=2)
    drive, play = result["commands"]
    assert (drive["command"], play["command"]) == ("SET", "PLAY")
    assert drive["count"] == play["count"] == 12
    assert play["ratio"] == play["median_us"] / drive["median_us"] > 0
