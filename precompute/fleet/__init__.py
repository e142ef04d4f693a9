"""Calibrate, build and verify many devices, or many variations of one, here or on several machines.

How units are distributed changes nothing in a table, so the code fingerprint of tables leaves this package out.
"""
