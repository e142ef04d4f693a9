"""One finding of the doctor, with its remedy."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Check:
    """A finding; `remedy` is "" where all is well.

    A check that fails but is not `needed` only makes things slower, and leaves the exit status 0.
    """

    name: str
    finding: str
    remedy: str = ""
    needed: bool = True

    @property
    def passed(self) -> bool:
        """Whether all is well."""
        return not self.remedy
