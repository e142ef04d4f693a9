"""Latency from report to command, stage by stage."""
