"""Rules of effects that runs of tests play, as a file has them."""

HELD = """
[[effect]]
name = "held"
envelope = [["held", "20 dB"]]
[[rule]]
on = "touch"
effect = "held"
"""
