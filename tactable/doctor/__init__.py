"""The doctor: checks of machine, ports, tables and digitizers, each with its remedy."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Check:
    """A finding; its `remedy` is "" where all is well. One that is not `needed` leaves the exit status 0."""

    name: str
    finding: str
    remedy: str = ""
    needed: bool = True

    @property
    def passed(self) -> bool:
        """Whether all is well."""
        return not self.remedy
