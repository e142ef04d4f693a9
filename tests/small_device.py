"""A small device for examples: reference-a with three zones, one level and a coarse sweep."""

from tests.precompute.devices import reference_text

_CHANGES = {"count = 5": "count = 3", 'step = "1 Hz"': 'step = "4 Hz"', '"10 dB", "20 dB", "30 dB"': '"20 dB"'}


def small_text(name: str = "my-bar") -> str:
    """Its description."""
    return reference_text({**_CHANGES, 'name = "reference-a"': f'name = "{name}"'})
