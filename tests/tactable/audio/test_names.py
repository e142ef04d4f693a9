"""The text of a sound card: what it declares, and how a text without a declaration is refused."""

from collections.abc import Callable

import pytest

from tactable.audio.names import AudioError, AudioInput, parse_input, parse_output

ACTUATORS = ("left", "right")


def test_an_output_declares_its_full_scale_and_its_greatest_sample() -> None:
    output = parse_output("audio:USB Audio: - (hw:1,0), full_scale=0.6um, most=50 %, channels=3+4, rate=44.1 kHz")
    assert output.name == "USB Audio: - (hw:1,0)"
    assert output.full_scales_m == pytest.approx((0.6e-6, 0.6e-6))
    assert output.most == 0.5
    assert (output.channels, output.rate_hz, output.block) == ((2, 3), 44_100, 220)


def test_an_input_declares_its_channels_and_what_a_sample_is() -> None:
    one = parse_input("audio:card,acceleration=2,scale=98.1 m/s^2,loopback=1", ACTUATORS)
    assert (one.acceleration, one.loopbacks) == (1, (0,))
    assert one.scale_m_per_s2 == pytest.approx(98.1)
    assert parse_input("audio:card,scale=5 m/s^2,loopback=2+3", ACTUATORS).loopbacks == (1, 2)


def parse_as_input(text: str) -> AudioInput:
    return parse_input(text, ACTUATORS)


@pytest.mark.parametrize(
    ("parse", "words", "error"),
    [
        (parse_output, "card,most=50 %", "full_scale is missing; declare the base displacement"),
        (parse_output, "card,full_scale=1 um", "most is missing; declare the greatest sample"),
        (parse_output, "card,full_scale=1 um,most=120 %", "no sample above 100 %"),
        (parse_output, "card,full_scale=1 um,most=0 %", "expected more than 0"),
        (parse_output, "card,full_scale=1 V,most=50 %", "full_scale: '1 V' has a unit that is not known"),
        (parse_output, "card,full_scale=1 um+2 um+3 um,most=50 %", "3 for 2 channels"),
        (parse_output, "card,full_scale=1 um,most=50 %,channels=1+1", "expected different channels"),
        (parse_output, "card,full_scale=1 um,most=50 %,volume=3", "'volume=3': expected each once of full_scale"),
        (parse_output, "card,full_scale=1 um,most=50 %,block=1 s", "expected 1 ms to 20 ms"),
        (parse_output, ",full_scale=1 um,most=50 %", "names no sound card"),
        (parse_as_input, "card,acceleration=1", "scale is missing; declare the acceleration"),
        (parse_as_input, "card,acceleration=1+2,scale=1 m/s^2", "expected one channel"),
        (parse_as_input, "card,scale=1 m/s^2,loopback=1", "channel 1 is both"),
        (parse_as_input, "card,scale=1 m/s^2,loopback=2+3+4", "one for each of left, right"),
    ],
)
def test_a_text_that_leaves_something_open_is_refused(parse: Callable[[str], object], words: str, error: str) -> None:
    with pytest.raises(AudioError, match=error):
        parse(f"audio:{words}")
