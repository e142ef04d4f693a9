"""Laws of a device's values by name: all that the fingerprint counts, and no more."""

from dataclasses import replace

from engine.device.values import Change, compare_values, device_values
from tests.precompute.devices import shipped

DEVICE = shipped("reference-a")


def test_a_value_has_the_name_of_its_place_and_its_unit() -> None:
    values = device_values(DEVICE)
    assert values["actuator[1].stiffness_n_per_m"] == 18900.0
    assert values["actuator[2].band_hz[1]"] == 60.0
    assert values["bar.length_m"] == 0.2794
    assert values["zone[5].name"] == "V"
    assert values["touch_axis.active_length_m"] is None


def test_what_came_and_what_went_is_named_and_per_cent_is_told_of_numbers_only() -> None:
    changes = compare_values({"a": 1.0, "b": "x", "c": 2.0}, {"b": "y", "c": 2.0, "d": 0.5})
    assert changes == (Change("a", 1.0, None), Change("b", "x", "y"), Change("d", None, 0.5))
    assert Change("mass_kg", 2.0, 2.5).percent == 25.0
    for before, after in ((0.0, 1.0), ("x", "y"), (None, 1.0), (False, True)):
        assert Change("key", before, after).percent is None


def test_a_device_is_shown_short_in_a_line_and_as_a_table_in_a_notebook() -> None:
    assert repr(DEVICE).startswith("<Device reference-a: 279.4 mm, 2 actuators, 5 zones, ")
    shown = DEVICE._repr_html_()
    assert "<td>bar</td><td>279.4 mm by " in shown
    assert "<td>actuators</td><td>left at 44.7 mm, 60 to 300 Hz; right at 273 mm, 60 to 300 Hz</td>" in shown
    assert DEVICE.threshold.title in shown and "bar.width" in shown
    assert "<b>" not in replace(DEVICE, name="<b>")._repr_html_().removeprefix("<b>Device</b>")
