"""The command as `python -m tactable`."""

from tactable.cli.start import main

main()
