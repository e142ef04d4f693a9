"""A small device for examples: reference-a with three zones, one level and a coarse sweep."""

from tactable.shipped import find_device

_CHANGES = {
    'name = "reference-a"': 'name = "my-bar"',
    "count = 5": "count = 3",
    'step = "1 Hz"': 'step = "4 Hz"',
    '"10 dB", "20 dB", "30 dB"': '"20 dB"',
}


def small_text() -> str:
    """Its description."""
    text = find_device("reference-a").text
    for old, new in _CHANGES.items():
        assert old in text
        text = text.replace(old, new)
    return text
