"""Calibration as the command line runs it: fit to a folder, application to a table, and the pages about both."""
