"""Clicks as commands: those of a table, encoded when they are first wanted, and those that were solved since."""

import numpy as np
from numpy.typing import NDArray

from base.arrays import Mask
from engine.render.chosen_basis import ChosenBasis
from engine.render.link_commands import SILENCE, PlayCommand, Rendered
from engine.table import ClickEntry, Clicks
from engine.table.click_entry import played_at
from engine.table.levels import LEVEL_TOLERANCE_DB
from engine.touch import Placement
from firmware_link.protocol.basis import encode_click
from firmware_link.protocol.messages import encode_amplitude

MOST_LEARNED = 256  # of fingers that rest while their effect clicks again
NOT_PLAYED = -1  # stands in place of an amplitude where the device lacks the click's set, or the level is refused


class RenderedClicks:
    """The clicks of one table of which the device holds the basis; silence for what is not achieved with `refuses`."""

    def __init__(self, clicks: Clicks, basis: ChosenBasis, refuses: bool) -> None:
        self.clicks, self.basis = clicks, basis
        self._refuses = refuses
        self._rendered: dict[tuple[int, float], Rendered | None] = {}
        self._learned: dict[Placement, ClickEntry] = {}

    @property
    def number(self) -> int:
        """Number of tabulated clicks that the device can play."""
        return int(np.isin(self.clicks.basis_set, list(self.basis.sets)).sum()) if self.clicks else 0

    @property
    def are_played(self) -> bool:
        """Whether the device plays clicks, and the rules have some."""
        return self.basis.basis is not None

    def is_unknown(self, placement: Placement) -> bool:
        """Whether the device plays clicks, and the click of these fingers is neither in the table nor learned."""
        row = self.clicks.row_of(self.clicks.places.key(placement))
        return self.are_played and row is None and placement not in self._learned

    def learn(self, click: ClickEntry) -> None:
        """Add a click that was solved for fingers; the earliest is forgotten beyond MOST_LEARNED.

        One that was solved in another basis, that of an earlier table, is dropped: its weights mean nothing here.
        """
        if self.clicks.basis is None or click.basis.hash != self.clicks.basis.hash:
            return
        if len(self._learned) == MOST_LEARNED:
            del self._learned[next(iter(self._learned))]
        self._learned[click.placement] = click

    def rendered(self, placement: Placement, level_db: float) -> Rendered | None:
        """The click of the nearest places, else the one solved for just these; None: the device can play neither."""
        if self.basis.basis is None:
            return None
        row = self.clicks.row_of(self.clicks.places.key(placement))
        if row is not None:
            if (row, level_db) not in self._rendered:
                self._rendered[row, level_db] = self._encode(self.clicks[row], level_db)
            return self._rendered[row, level_db]
        learned = self._learned.get(placement)
        return None if learned is None else self._encode(learned, level_db)

    def shortfall(self, level_db: float) -> int:
        """How many clicks of the table do not reach the level with quiet fingers kept quiet."""
        return int((~self._is_achieved(level_db)).sum())

    def amplitude_words(self, level_db: float) -> NDArray[np.int32]:
        """Amplitude (row,) of every click of the table as a PLAY carries it; NOT_PLAYED for one that is not played."""
        clicks = self.clicks
        is_played = np.isin(clicks.basis_set, list(self.basis.sets)) & (clicks.fraction_bits > self.basis.halvings)
        if self._refuses:
            is_played &= self._is_achieved(level_db)
        # Arithmetic of Python, as in `played_at`: powers of NumPy may differ in the last place.
        changes_db = (min(0.0, level_db - low_db) for low_db in clicks.felt_low_db.tolist())
        words = [encode_amplitude(10 ** (change_db / 20)) for change_db in changes_db]
        return np.where(is_played, np.array(words, np.int32), np.int32(NOT_PLAYED))

    def _is_achieved(self, level_db: float) -> Mask:
        low_db = self.clicks.felt_low_db
        return low_db >= level_db - LEVEL_TOLERANCE_DB if np.isfinite(level_db) else np.ones(len(low_db), np.bool_)

    def _encode(self, tabulated: ClickEntry, level_db: float) -> Rendered | None:
        number = self.basis.sets.get(tabulated.basis_set)
        fraction_bits = tabulated.fraction_bits - self.basis.halvings
        if number is None or fraction_bits < 1:
            return None
        click = played_at(tabulated, level_db)
        if self._refuses and not click.achieved:
            return Rendered(SILENCE, is_achieved=False)
        assert self.basis.basis is not None  # it has the click's set
        encoded = encode_click(self.basis.basis, number, click.weights.tolist(), fraction_bits, click.amplitude)
        return Rendered(PlayCommand(encoded), click.achieved)
