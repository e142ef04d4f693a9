"""A steady drive that is solved for fingers, and what they feel of it, as pictures take them."""

from dataclasses import dataclass

import numpy as np

from engine.device import Device
from engine.steady import SteadyDrive
from engine.touch import Placement, ZoneState
from precompute.model.assembly import assemble
from precompute.model.steady import compute_steady_state
from precompute.predict.at_positions import PlacementFigures, SteadyDesigner


@dataclass(frozen=True)
class PlayedFinger:
    """Level under a standard finger; range_db: least and greatest level of the sampled ones."""

    position_m: complex
    is_felt: bool
    acceleration_m_per_s2: float
    level_db: float
    range_db: tuple[float, float]


@dataclass(frozen=True)
class PlayedDrive:
    """A steady drive with the fingers that it is for.

    worst_contrast_db: over the sampled fingers, None where nothing is quiet.
    """

    device: Device
    placement: Placement
    figures: PlacementFigures
    threshold_m_per_s2: float
    worst_contrast_db: float | None
    localized_factor: float
    fingers: tuple[PlayedFinger, ...]

    @property
    def drive(self) -> SteadyDrive:
        """The drive, of one frequency."""
        return self.figures.drive


def solved_drive(designer: SteadyDesigner, placement: Placement, level_db: float) -> PlayedDrive:
    """The drive that a run solves for these positions, its sampled fingers within a millimetre of them."""
    device = designer.plant.device
    figures = designer.solve(placement.position_m, placement.is_felt, level_db)
    drive = figures.drive
    threshold_m_per_s2 = float(device.threshold.peak_m_per_s2(np.array([drive.frequency_hz]))[0])
    ends_db = np.stack([figures.sampled_level_db.min(axis=0), figures.sampled_level_db.max(axis=0)], axis=1)
    loaded = assemble(device).with_fingers(placement.position_m, device.finger)
    share = compute_steady_state(loaded, np.array(drive.frequencies_hz), drive.complex_amplitudes).share
    felt_zones = [zone for zone, state in enumerate(placement.zone_states(device)) if state is ZoneState.FELT]
    weakest = figures.sampled_level_db[:, placement.felt].min(axis=1)
    strongest = figures.sampled_level_db[:, placement.quiet].max(axis=1, initial=-np.inf)
    return PlayedDrive(
        device=device,
        placement=placement,
        figures=figures,
        threshold_m_per_s2=threshold_m_per_s2,
        worst_contrast_db=float((weakest - strongest).min()) if placement.quiet else None,
        localized_factor=float(share[felt_zones].sum()),
        fingers=tuple(
            PlayedFinger(at_m, is_felt, threshold_m_per_s2 * 10 ** (level / 20), level, (low, high))
            for at_m, is_felt, level, (low, high) in zip(
                placement.position_m, placement.is_felt, figures.level_db.tolist(), ends_db.tolist(), strict=True
            )
        ),
    )
