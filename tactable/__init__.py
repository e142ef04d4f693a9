"""The command `tactable`: the only place that knows everybody."""
