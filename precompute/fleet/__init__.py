"""Many devices, or many variations of one: calibrate, build and verify each, here or on many machines.

Not among the sources that a table's code fingerprint counts: how units are handed out changes nothing in a table.
"""
