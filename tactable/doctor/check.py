"""One thing that the doctor looked at: how it is, and what to do about it."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Check:
    """One thing that was looked at; `remedy` is "" where it is well.

    What is not `needed` is only slower without: no reason for the exit status to be 1.
    """

    name: str
    finding: str
    remedy: str = ""
    needed: bool = True

    @property
    def passed(self) -> bool:
        """Whether it is well."""
        return not self.remedy
