"""The command line of a study to its options."""

import argparse
from typing import Any


def read_options(about: str | None, **kinds: object) -> Any:
    """Options by name: a type is a word that must be given, `(default,)` one that need not, False a switch."""
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, kind in kinds.items():
        if isinstance(kind, type):
            parser.add_argument(name, type=kind)
        elif isinstance(kind, tuple):
            parser.add_argument(name, type=type(kind[0]), nargs="?", default=kind[0])
        elif kind is False:
            parser.add_argument(f"--{name}", action="store_true")
        else:
            parser.add_argument(f"--{name}", type=type(kind), default=kind)
    return parser.parse_args()
