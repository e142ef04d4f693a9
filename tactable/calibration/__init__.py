"""A calibration as the command line runs it: job, files, application."""
