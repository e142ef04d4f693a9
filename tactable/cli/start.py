"""Entry point of the command: Ctrl-C while the program is still being imported ends it without a traceback."""

import sys


def main() -> None:
    """Import and run the command line; exit status 130 for Ctrl-C, wherever it comes."""
    try:
        from tactable.cli.main import main as run

        run()
    except KeyboardInterrupt:
        sys.exit(130)  # by convention 128 plus the number of SIGINT


if __name__ == "__main__":
    main()
