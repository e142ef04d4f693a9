"""Choice of a touch surface: the descriptor of an interface to the digitizer of the chosen or the best surface."""

from engine.touch.descriptor import DescriptorError, Surface, SurfaceKind, read_surfaces
from engine.touch.digitizer import Digitizer, DigitizerError
from engine.touch.quirks import vendor_with_own_driver

_KIND_PREFERENCE = (SurfaceKind.TOUCH_SCREEN, SurfaceKind.MULTI_POINT, SurfaceKind.TOUCH_PAD)


def open_digitizer(
    descriptor: bytes, vendor_id: int = 0, product_id: int = 0, report_id: int | None = None
) -> Digitizer:
    """Open the digitizer of an interface: the surface with `report_id`, or the best one until another surface reports.

    Fingers come before a stylus, a touch screen before a touch pad. Raises `DescriptorError` when the descriptor is
    broken, `DigitizerError` when it holds no such surface.
    """
    number = f"{vendor_id:04x}:{product_id:04x}"
    vendor = vendor_with_own_driver(vendor_id)
    if vendor is not None:
        raise DigitizerError(
            f"{vendor} device {number}: only its own driver decodes its reports; choose the /dev/input/event node of "
            "that driver, which `tactable list` shows where it is touched by fingers"
        )
    refused: list[DescriptorError] = []
    surfaces = sorted(read_surfaces(descriptor, refused), key=_rank)
    if not surfaces:
        raise DigitizerError(f"device {number} has no touch screen or touch pad")
    if report_id is not None:
        known = ", ".join(surface.name(vendor_id, product_id) for surface in surfaces)
        surfaces.sort(key=lambda surface: surface.report_id != report_id)
        if surfaces[0].report_id != report_id:
            raise DigitizerError(f"device {number} has no touch surface with report {report_id:02x}: choose {known}")
    digitizer = Digitizer(surfaces, vendor_id, product_id, is_chosen=report_id is not None)
    digitizer.refused = refused
    return digitizer


def _rank(surface: Surface) -> tuple[bool, int, bool, int]:
    """Sort key of a surface; the smallest is the best."""
    preference = _KIND_PREFERENCE.index(surface.kind)
    return surface.is_stylus, preference, not surface.has_contact_ids, -surface.contacts_per_report
